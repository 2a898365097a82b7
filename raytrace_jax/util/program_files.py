"""Compiled programs in files, so that the next process neither traces nor compiles them.

JAX keeps compiled programs by itself, but by what tracing gave: a process has to trace each program to find it, which
takes longer than to run it. Here a program is found by what it was traced from: the function, its static arguments, the
kinds of its arrays, and the text of this package.
"""

import contextlib
import functools
import hashlib
import os
import pickle
import secrets
import sys
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from jax.experimental import serialize_executable

from raytrace_jax.util.files import atomic_write

PACKAGE = __name__.partition(".")[0]

MOST_BYTES = 1_000_000_000
"""How much room programs may take, a few megabytes each: of more, those go that were not used for longest."""

_folder: Path | None = None


def keep_programs(folder: Path | None) -> None:
    """Keep programs in a folder that can be written, from now on; in none if it is None."""
    global _folder
    _folder = folder


class Program(NamedTuple):
    """A compiled program, called with a list of arrays.

    Args:
        compiled: from that list to the list of the results' arrays.
        structure: the tree of the results.
    """

    compiled: jax.stages.Compiled
    structure: Any

    def __call__(self, leaves: list[Any]) -> Any:
        """The results for these arrays."""
        return jax.tree.unflatten(self.structure, self.compiled(leaves))


def load_program(function: Callable, kind: Hashable) -> Program | None:
    """The program that was kept for this function and this kind of arguments, if there is one that can be used."""
    path = _path(function, kind)
    if path is None or not path.exists():
        return None
    try:
        stored, example, count, uses_lapack = pickle.loads(path.read_bytes())
        if uses_lapack:
            _start_lapack()
        compiled = serialize_executable.deserialize_and_load(*stored, execution_devices=jax.devices()[:count])
        os.utime(path)
        return Program(compiled, jax.tree.structure(example))
    except Exception:  # Whatever may be wrong with a file of a cache: it can be made anew.
        return None


def save_program(function: Callable, kind: Hashable, program: Program) -> None:
    """Keep a program, where it can be kept."""
    path = _path(function, kind)
    if path is None:
        return
    # A program that cannot be stored, or a disk that is full, costs the next process time and nothing else.
    with contextlib.suppress(Exception):
        # A structure cannot be stored, what has it can.
        example = jax.tree.unflatten(program.structure, range(program.structure.num_leaves))
        count = max(len(sharding.device_set) for sharding in jax.tree.leaves(program.compiled.output_shardings))
        uses_lapack = "lapack" in str(program.compiled.as_text())
        content = pickle.dumps((serialize_executable.serialize(program.compiled), example, count, uses_lapack))
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        _make_room(path.parents[1])


def program_name(function: Callable, kind: Hashable) -> str:
    """The name under which a program is compiled: where it is kept, one that no program ever had.

    JAX keeps programs too, and finds them by what tracing gave and by their name. One that it has read from a file, as
    that of an earlier version of this package or of a process beside this one, runs, but lacks its machine code when it
    is written again.
    """
    is_kept = _path(function, kind) is not None
    return f"{function.__name__}_{secrets.token_hex(8)}" if is_kept else function.__name__


def _make_room(folder: Path) -> None:
    files = [(file.stat().st_mtime, file.stat().st_size, file) for file in folder.rglob("*") if file.is_file()]
    total = sum(size for _, size, _ in files)
    for _, size, file in sorted(files):
        if total <= MOST_BYTES:
            break
        file.unlink(missing_ok=True)
        total -= size


@functools.cache
def _start_lapack() -> None:
    """Let JAX find LAPACK, as it does when it lowers a program that calls it; one that was lowered before crashes."""
    jax.jit(jax.lax.linalg.cholesky).lower(jax.ShapeDtypeStruct((1, 1), "float32"))


def _path(function: Callable, kind: Hashable) -> Path | None:
    """The file of a program; None where none is kept.

    Functions within functions depend on what they enclose, others' functions on what we do not see: not kept.
    """
    name = f"{function.__module__}.{function.__qualname__}"
    if _folder is None or not name.startswith(f"{PACKAGE}.") or "<" in name:
        return None
    key = hashlib.sha256(repr((name, kind)).encode()).hexdigest()
    return _folder / _fingerprint() / f"{function.__name__}-{key[:32]}"


@functools.cache
def _fingerprint() -> str:
    """All that a program depends on besides its function and arguments: our text, the libraries, the machine."""
    found = hashlib.sha256()
    root = Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        found.update(str(file.relative_to(root)).encode() + file.read_bytes())
    libraries = [version(name) for name in ("jax", "jaxlib", "equinox", "numpy")]
    device = jax.devices()[0]
    machine = [device.platform, device.device_kind, device.client.platform_version]
    features = np.show_config(mode="dicts")["SIMD Extensions"]
    flags = [os.environ.get(name, "") for name in ("XLA_FLAGS", "JAX_ENABLE_X64", "JAX_DEBUG_NANS")]
    found.update(repr((libraries, sys.version, machine, features, flags)).encode())
    return found.hexdigest()[:16]
