"""Vary the package's tuning numbers one at a time and print what they do on scenes that are not alike.

python experiments/tuning/tuning.py pictures [--scenes assignment "bubble in glass"] [--size 64 48]
python experiments/tuning/tuning.py search box point stored judge [--count 4]
"""

import argparse
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

import jax
import judging
import pictures
import refining
import search
from bench import CASES


class Part(NamedTuple):
    """One table: its head, the scenes it can be made for, and the rows of a scene."""

    head: tuple[str, ...]
    scenes: Iterable[str]
    rows: Callable[[str, argparse.Namespace], Iterator[list[str]]]


PARTS = {
    "pictures": Part(pictures.HEAD, pictures.CASES, lambda scene, how: pictures.rows(scene, tuple(how.size))),
    "search": Part(search.HEAD, CASES, lambda scene, how: search.rows(scene, how.count)),
    "box": Part(refining.BOX_HEAD, CASES, lambda scene, how: refining.box_rows(scene, how.count)),
    "point": Part(refining.POINT_HEAD, CASES, lambda scene, how: refining.point_rows(scene, how.count)),
    "stored": Part(refining.STORED_HEAD, CASES, lambda scene, how: refining.stored_rows(scene, how.count)),
    "judge": Part(judging.HEAD, CASES, lambda scene, how: judging.rows(scene)),
}
"""What can be measured."""


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=PARTS)
    parser.add_argument("--scenes", nargs="+", help="default: all that the part has")
    parser.add_argument("--size", nargs=2, type=int, default=[64, 48], help="of the tracer's pictures")
    parser.add_argument("--count", type=int, default=4, help="how many starts or targets there are of each scene")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for name in arguments.parts:
        part = PARTS[name]
        print("\n| " + " | ".join(part.head) + " |\n|" + "---|" * len(part.head))
        for scene in arguments.scenes or part.scenes:
            for row in part.rows(scene, arguments):
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
