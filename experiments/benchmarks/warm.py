"""Warm times: `warm.py CACHE ROUNDS NAME:BITS ... [native64=PATH] [native32=PATH]` prints milliseconds as JSON.

All programs, native ones too, take turns, so that whatever else the machine does disturbs them alike.
"""

import contextlib
import json
import os
import subprocess
import sys

import jax
from programs import build, seconds, set_up

CALLS = 3
"""Runs in a turn; the first one of each finds the caches filled by another program and does not count."""


def native_milliseconds(path: str) -> list[float]:
    """Times of a native program for Schlick's approximation and 5 bounces, on as many threads as it has cores."""
    environment = {"OMP_NUM_THREADS": str(os.cpu_count() or 1), **os.environ}
    done = subprocess.run([path, "1", "5", str(CALLS)], env=environment, capture_output=True, text=True, check=True)
    return [float(line.split()[0]) for line in done.stdout.splitlines()][1:]


def main() -> None:
    cache, rounds, *wanted = sys.argv[1:]
    natives = dict(entry.split("=", 1) for entry in wanted if "=" in entry)
    set_up(cache)
    programs = {}
    for key in (entry for entry in wanted if "=" not in entry):
        name, bits = key.split(":")
        with precision(bits):
            programs[key] = build(name)
            programs[key]()

    times: dict[str, list[float]] = {key: [] for key in (*natives, *programs)}
    for _ in range(int(rounds)):
        for name, path in natives.items():
            times[name] += native_milliseconds(path)
        for key, program in programs.items():
            with precision(key.split(":")[1]):
                times[key] += [1e3 * seconds(program) for _ in range(CALLS)][1:]
    device = jax.devices()[0]
    print(json.dumps({"device": f"{jax.device_count()} x {device.device_kind}", "milliseconds": times}))


def precision(bits: str) -> contextlib.AbstractContextManager:
    """Run JAX with 32 or 64 bits."""
    return jax.enable_x64(bits == "64")


if __name__ == "__main__":
    main()
