"""One program in a process of its own: `fresh.py NAME BITS CACHE` prints its compile time and peak memory as JSON."""

import json
import resource
import sys

import jax
from programs import build, seconds, set_up


def peak_megabytes() -> float:
    """The most memory that this process has held so far."""
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6


def main() -> None:
    name, bits, cache = sys.argv[1:]
    set_up(cache)
    with jax.enable_x64(bits == "64"):
        program = build(name)
        before = peak_megabytes()
        first = seconds(program)
        again = seconds(program)
    on_device = jax.devices()[0].memory_stats() or {}
    found = {
        "compile_s": first - again,
        "before_mb": before,
        "peak_mb": peak_megabytes(),
        "device_peak_mb": on_device.get("peak_bytes_in_use", 0) / 1e6,
    }
    print(json.dumps(found))


if __name__ == "__main__":
    main()
