"""RayRecord programs in files, so that the next process need not trace them.

JAX keeps compiled programs by itself, but by what tracing gave: a process has to trace each program to find it, which
takes longer than to run it. Here what tracing gave is found by what it was traced from: the function, its static
arguments, the kinds of its arrays, and the text of this package.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import sys
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.export import Exported, deserialize

from raytrace_jax.util.files import atomic_write

PACKAGE = __name__.partition(".")[0]

MOST_BYTES = 1_000_000_000
"""How much room programs may take, ours and JAX's, up to a megabyte each: of more, the oldest go."""

FOLDER = "programs"

_folder: Path | None = None


def keep_programs(folder: Path | None) -> None:
    """Keep programs in a folder that can be written, JAX's own, from now on; in none if it is None."""
    global _folder
    _folder = folder


class TracedProgram(NamedTuple):
    """What tracing and lowering gave.

    Args:
        exported: from a list of arrays to the list of the results' arrays.
        structure: the tree of the results.
    """

    exported: Exported
    structure: Any


def load_program(function: Callable, kind: Hashable) -> TracedProgram | None:
    """The program that was kept for this function and this kind of arguments, if there is one that can be used."""
    path = _path(function, kind)
    if path is None or not path.exists():
        return None
    try:
        stored, example = pickle.loads(path.read_bytes())
        exported = deserialize(bytearray(stored))
        os.utime(path)
        return TracedProgram(exported, jax.tree.structure(example))
    except Exception:  # Whatever may be wrong with a file of a cache: it can be made anew.
        return None


def save_program(function: Callable, kind: Hashable, program: TracedProgram) -> None:
    """Keep a program, where it can be kept."""
    path = _path(function, kind)
    if path is None:
        return
    # A program that cannot be stored, or a disk that is full, costs the next process time and nothing else.
    with contextlib.suppress(Exception):
        # A structure cannot be stored, what has it can.
        example = jax.tree.unflatten(program.structure, range(program.structure.num_leaves))
        content = pickle.dumps((bytes(program.exported.serialize()), example))
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        _make_room(path.parents[2])


def is_kept(function: Callable, kind: Hashable) -> bool:
    """Whether the next process finds what `save_program` is given of this function."""
    return _path(function, kind) is not None


def _make_room(folder: Path) -> None:
    ours_and_jax_s = [*folder.glob(f"{FOLDER}/*/*"), *folder.glob("jit_*-cache")]
    files = [(file.stat().st_mtime, file.stat().st_size, file) for file in ours_and_jax_s]
    total = sum(size for _, size, _ in files)
    for _, size, file in sorted(files):
        if total <= MOST_BYTES:
            break
        file.unlink(missing_ok=True)
        total -= size


def _path(function: Callable, kind: Hashable) -> Path | None:
    """The file of a program; None where none is kept.

    Functions within functions depend on what they enclose, others' functions on what we do not see: not kept.
    """
    name = f"{function.__module__}.{function.__qualname__}"
    if _folder is None or not name.startswith(f"{PACKAGE}.") or "<" in name:
        return None
    key = hashlib.sha256(repr((name, kind)).encode()).hexdigest()
    return _folder / FOLDER / _fingerprint() / f"{function.__name__}-{key[:32]}"


@functools.cache
def _fingerprint() -> str:
    """All that tracing depends on besides the function and its arguments: our text, the libraries, the platform."""
    found = hashlib.sha256()
    root = Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        found.update(str(file.relative_to(root)).encode() + file.read_bytes())
    libraries = [version(name) for name in ("jax", "jaxlib", "equinox", "numpy")]
    found.update(repr((libraries, sys.version, jax.default_backend())).encode())
    return found.hexdigest()[:16]
