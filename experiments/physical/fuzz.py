"""Renders hundreds of awkward physical scenes with derivatives in both modes: is any number not finite?

    python experiments/physical/fuzz.py [--first 0] [--scenes 300] [--size 24 18] [--rays 32] [--only WHAT ...]

The scenes are those of `tests/awkward_physical.py`: one to three balls, nested, touching, overlapping, tinted and
dispersive, the camera within or upon glass, an index of 1, a board, a lamp. Prints what is wrong, and how many were
right.
"""

import argparse
import sys
import time
from pathlib import Path

import jax

sys.path.insert(0, str(Path(__file__).parents[2] / "tests"))
jax.config.update("jax_enable_x64", True)
from awkward_physical import AWKWARD, SIZE, both_modes, faults  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--size", type=int, nargs=2, default=SIZE, metavar=("W", "H"))
    parser.add_argument("--rays", type=int, default=32, help="room for so many rays a pixel; fewer do at larger sizes")
    parser.add_argument("--only", nargs="+", default=AWKWARD, choices=AWKWARD, metavar="WHAT")
    parser.add_argument("--edges", nargs="+", default=["aware", "point"], choices=["aware", "point"])
    given = parser.parse_args()
    size = tuple(given.size)
    for edges in given.edges:
        program, begun, wrong = both_modes(edges, size, given.rays), time.monotonic(), 0
        for seed in range(given.first, given.first + given.scenes):
            what = given.only[seed % len(given.only)]
            found = faults(program, seed, what, size)
            wrong += bool(found)
            if found:
                print(f"{edges}, seed {seed}, {what}: {'; '.join(found)}", flush=True)
            done = seed + 1 - given.first
            if done % 50 == 0 or done == given.scenes:
                right = f"{done - wrong} of {done} right, {time.monotonic() - begun:.0f} s"
                print(f"{edges}, seeds from {given.first}: {right}", flush=True)


if __name__ == "__main__":
    main()
