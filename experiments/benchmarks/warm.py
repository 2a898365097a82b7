"""Warm times: `warm.py CACHE ROUNDS ENTRY ...` prints milliseconds as JSON; an entry is NAME:BITS or NATIVE=PATH.

All programs, native ones too, take turns in the order given, so that whatever else the machine does disturbs neighbours
alike.
"""

import contextlib
import json
import os
import subprocess
import sys
from collections.abc import Callable

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
    set_up(cache)
    measures = {entry.split("=")[0]: measure_of(entry) for entry in wanted}
    turns = [{key: measure() for key, measure in measures.items()} for _ in range(int(rounds))]
    device = jax.devices()[0]
    print(json.dumps({"device": f"{jax.device_count()} x {device.device_kind}", "turns": turns}))


def measure_of(entry: str) -> Callable[[], list[float]]:
    """What measures an entry of the command line, in milliseconds; our own programs are compiled at once."""
    if "=" in entry:
        path = entry.split("=", 1)[1]
        return lambda: native_milliseconds(path)
    name, bits = entry.split(":")
    with precision(bits):
        program = build(name)
        program()

    def measure() -> list[float]:
        with precision(bits):
            return [1e3 * seconds(program) for _ in range(CALLS)][1:]

    return measure


def precision(bits: str) -> contextlib.AbstractContextManager:
    """Run JAX with 32 or 64 bits."""
    return jax.enable_x64(bits == "64")


if __name__ == "__main__":
    main()
