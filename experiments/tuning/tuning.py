"""Vary the package's tuning numbers one at a time and print what they do on scenes that are not alike.

python experiments/tuning/tuning.py pictures [--scenes assignment "bubble in glass"]
python experiments/tuning/tuning.py search box point judge [--count 4] [--size 48 36]
python experiments/tuning/tuning.py limits curvature bounds corners [--count 3] [--rows 2]
"""

import argparse
import itertools
import sys
from collections.abc import Callable, Collection, Iterator
from typing import NamedTuple

import jax
import judging
import limits
import pictures
import refining
import robust
import search
from bench import CASES


class Part(NamedTuple):
    """One table: its head, the scenes it can be made for, the size of its pictures, and the rows of a scene.

    The rows are those of a scene's name, a size, and how many starts or targets there are.
    """

    head: tuple[str, ...]
    scenes: Collection[str]
    size: tuple[int, int]
    rows: Callable[[str, tuple[int, int], int], Iterator[list[str]]]


SMALL = (48, 36)
PARTS = {
    "pictures": Part(pictures.HEAD, pictures.CASES, (64, 48), lambda scene, size, _: pictures.rows(scene, size)),
    "search": Part(search.HEAD, CASES, SMALL, search.rows),
    "box": Part(refining.BOX_HEAD, CASES, SMALL, refining.box_rows),
    "point": Part(refining.POINT_HEAD, CASES, SMALL, refining.point_rows),
    "limits": Part(limits.HEAD, CASES, SMALL, lambda scene, size, _: limits.rows(scene, size)),
    "curvature": Part(robust.CURVATURE_HEAD, CASES, SMALL, lambda scene, size, _: robust.curvature_rows(scene, size)),
    "bounds": Part(robust.BOUNDS_HEAD, CASES, SMALL, lambda scene, size, _: robust.bounds_rows(scene, size)),
    "corners": Part(judging.HEAD, CASES, SMALL, lambda scene, size, _: judging.small_rows(scene, size)),
    "judge": Part(judging.HEAD, CASES, SMALL, lambda scene, size, _: judging.rows(scene, size)),
}
"""What can be measured."""


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("parts", nargs="+", choices=PARTS)
    parser.add_argument("--scenes", nargs="+", help="default: all that the part has")
    parser.add_argument("--size", nargs=2, type=int, help="of the pictures; default: the part's own")
    parser.add_argument("--rows", type=int, help="only the first so many of each scene")
    parser.add_argument("--count", type=int, default=4, help="how many starts or targets there are of each scene")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    for name in arguments.parts:
        part = PARTS[name]
        size = (arguments.size[0], arguments.size[1]) if arguments.size else part.size
        print("\n| " + " | ".join(part.head) + " |\n|" + "---|" * len(part.head))
        for scene in arguments.scenes or part.scenes:
            if scene not in part.scenes:
                parser.error(f"{name} has no scene {scene!r}; it has {', '.join(part.scenes)}")
            for row in itertools.islice(part.rows(scene, size, arguments.count), arguments.rows):
                print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    sys.exit(main())
