"""The page on the architecture: what it names exists, and its picture has the floors that the imports keep to."""

import re
from itertools import pairwise

from test_imports import FLOORS, ROOT

PAGE = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
PICTURE = PAGE.partition("```mermaid")[2].partition("```")[0]


def test_every_file_and_folder_that_it_names_exists():
    named = [name for name in re.findall(r"`([^`\s]+)`", PAGE) if "/" in name or re.search(r"\.\w+$", name)]
    named = [name for name in named if name not in ("model.txt",)]
    missing = [name for name in named if not any((folder / name).exists() for folder in (ROOT, ROOT / "raytrace_jax"))]
    assert len(named) > 50 and not missing


def test_the_picture_has_every_room_and_arrows_from_each_floor_to_the_next():
    rooms = set(re.findall(r"^ +(\w+)\[", PICTURE, re.MULTILINE))
    assert rooms == {room for rooms in FLOORS for room in rooms.split()}
    arrows = {arrow for line in PICTURE.splitlines() if "-->" in line for arrow in pairwise(re.findall(r"\w+", line))}
    assert arrows == {
        (upper, lower) for above, below in pairwise(FLOORS) for upper in above.split() for lower in below.split()
    }


def test_every_package_is_named():
    packages = [path.parent for path in (ROOT / "raytrace_jax").rglob("__init__.py")][1:]
    for package in packages:
        name = package.relative_to(ROOT / "raytrace_jax").as_posix()
        assert name in PAGE, name
