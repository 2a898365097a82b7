"""The files in which traced programs are kept for later processes.

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
from typing import Any

import jax
from jax.export import Exported, deserialize

from .cache_folder import program_files
from .files import atomic_write

MOST_BYTES = 1_000_000_000  # For programs, ours and JAX's, up to a megabyte each: of more, the oldest go.

_folder: Path | None = None


def keep_programs(folder: Path | None) -> None:
    """Keep programs in a folder that can be written, JAX's own, from now on; in none if it is None."""
    global _folder
    _folder = folder


def program_path(function: Callable, key: Hashable) -> Path | None:
    """The file of a program; None for functions within functions and of others, which depend on what we do not see."""
    name = f"{function.__module__}.{function.__qualname__}"
    if _folder is None or not name.startswith("raytrace_jax.") or "<" in name:
        return None
    digest = hashlib.sha256(repr((name, key)).encode()).hexdigest()
    return _folder / "programs" / _fingerprint() / f"{function.__name__}-{digest[:32]}"


@functools.cache
def _fingerprint() -> str:
    """Digest of all else that tracing depends on: our text, the libraries, the platform."""
    found = hashlib.sha256()
    root = Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        found.update(str(file.relative_to(root)).encode() + file.read_bytes())
    libraries = [version(name) for name in ("jax", "jaxlib", "equinox", "numpy")]
    found.update(repr((libraries, sys.version, jax.default_backend())).encode())
    return found.hexdigest()[:16]


def load_program(path: Path) -> tuple[Exported, Any] | None:
    """A traced program, from a list of arrays to that of the results, and the results' tree; None without a file."""
    try:
        stored, example = pickle.loads(path.read_bytes())
        exported = deserialize(bytearray(stored))
        os.utime(path)
        return exported, jax.tree.structure(example)
    except Exception:  # Whatever may be wrong with a file of a cache: it can be made anew.
        return None


def save_program(path: Path, exported: Exported, structure: Any) -> None:
    # A program that cannot be stored, or a disk that is full, costs the next process time and nothing else.
    with contextlib.suppress(Exception):
        # A structure cannot be stored, what has it can.
        example = jax.tree.unflatten(structure, range(structure.num_leaves))
        content = pickle.dumps((bytes(exported.serialize()), example))
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        _make_room(path.parents[2])


def _make_room(folder: Path) -> None:
    """Remove the files that were not used for longest, beyond `MOST_BYTES`."""
    left = MOST_BYTES
    for file in sorted(program_files(folder), key=lambda file: file.stat().st_mtime, reverse=True):
        left -= file.stat().st_size
        if left < 0:
            file.unlink(missing_ok=True)
