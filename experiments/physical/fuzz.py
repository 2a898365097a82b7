"""Renders hundreds of awkward physical scenes with derivatives in both modes: is any number not finite?

    python experiments/physical/fuzz.py [--first 0] [--scenes 300] [--edges aware point]

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
from awkward_physical import AWKWARD, both_modes, faults  # noqa: E402


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--first", type=int, default=0, help="seed of the first scene")
    parser.add_argument("--scenes", type=int, default=300)
    parser.add_argument("--edges", nargs="+", default=["aware", "point"], choices=["aware", "point"])
    given = parser.parse_args()
    for edges in given.edges:
        program, begun, wrong = both_modes(edges), time.monotonic(), 0
        for seed in range(given.first, given.first + given.scenes):
            what = AWKWARD[seed % len(AWKWARD)]
            found = faults(program, seed, what)
            wrong += bool(found)
            if found:
                print(f"{edges}, seed {seed}, {what}: {'; '.join(found)}", flush=True)
        right = f"{given.scenes - wrong} of {given.scenes} right, {time.monotonic() - begun:.0f} s"
        print(f"{edges}, seeds from {given.first}: {right}", flush=True)


if __name__ == "__main__":
    main()
