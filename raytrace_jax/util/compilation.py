"""The compilation of programs with the options that were measured to help on the CPU.

A program is compiled once for each kind of arguments, and its trace is kept in a file for later processes. JAX keeps
compiled programs by itself, but by what tracing gave: a process has to trace each program to find it, which takes
longer than to run it. Here what tracing gave is found by what it was traced from: the function, its static arguments,
the kinds of its arrays, and the text of this package.
"""

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import sys
import threading
import time
import weakref
from collections.abc import Callable, Hashable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer
from jax.export import Exported, deserialize, export

from ..errors import RaytraceError
from .cache_folder import program_files
from .files import atomic_write
from .numerics import with_lower_ranks

Program = Callable[[list[Any]], Any]
"""A compiled program, from arrays to a function's results."""

EXPORTED = "_exported"
"""End of the name of a program that is compiled from what was kept."""

CPU_OPTIONS = {
    # The older loop emitters compile in half the time and run this kind of code twice as fast.
    "xla_cpu_use_fusion_emitters": False,
    # Use the whole width of the vector units where there are 512 bits: a seventh faster.
    "xla_cpu_prefer_vector_width": 512,
    # See that the branches of a condition may share their operands' memory: a quarter fewer copies and less time.
    "xla_cpu_copy_insertion_use_region_analysis": True,
    # Leave sums over components to the fusions around them: as calls of YNN they take a third longer in derivatives.
    "xla_cpu_experimental_ynn_fusion_type": "",
}


@functools.cache
def compiler_options() -> dict[str, bool | int | str]:
    """The options by which the package compiles its own programs: `jax.jit(f, compiler_options=compiler_options())`.

    Returns:
        XLA's options for the default backend; those that this version of XLA does not know are left out.
    """
    if jax.default_backend() != "cpu":
        return {}
    if _are_known(CPU_OPTIONS):
        return CPU_OPTIONS
    return {name: value for name, value in CPU_OPTIONS.items() if _are_known({name: value})}


def _are_known(options: dict[str, bool | int | str]) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options=options).lower(jax.ShapeDtypeStruct((), "float32")).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


@functools.cache
def first_process() -> int:
    """The process that was the first to use JAX here; one that is forked from it inherits the answer."""
    return os.getpid()


def refuse_fork() -> None:
    """Raise RaytraceError in a process that was forked from one that had used JAX: its programs never end there."""
    if os.getpid() != first_process():
        raise RaytraceError(
            "this process was forked from one that had used JAX, whose threads a forked process lacks: a program "
            "would wait for them for ever. Start it with the method 'spawn', or fork before the first scene."
        )


class Jitted:
    """A pure function, compiled with `compiler_options` for each kind of arguments.

    Within a transformation it is `jax.jit` of the function: one program also where nothing around it is jitted, and
    not one for each of its operations. Such a program has no options, which are for outermost ones.

    Args:
        function: of pytrees of arrays, and of static values.
        static_argnames: its arguments that are not arrays: hashable, and told apart by their `repr`.
    """

    def __init__(self, function: Callable[..., Any], static_argnames: str | tuple[str, ...] = ()):
        functools.update_wrapper(self, function)
        function = self.function = with_lower_ranks(function)
        self.static = {static_argnames} if isinstance(static_argnames, str) else set(static_argnames)
        self.signature = inspect.signature(function)
        self.programs: dict[Hashable, Program] = {}
        self.lock = threading.RLock()
        self.within = jax.jit(function, static_argnames=tuple(self.static))
        ALL_JITTED.add(self)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        refuse_fork()
        static, leaves, structure = self._bind(args, kwargs)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self.within(*args, **kwargs)
        # What `jax.disable_jit` asks for, one operation after the other, is no program.
        with jax.disable_jit(False):
            return self._program(static, leaves, structure)(leaves)

    def _bind(self, args: tuple, kwargs: dict[str, Any]) -> tuple[dict[str, Any], list[Any], Any]:
        """Arguments by name: those that are static; and the arrays, flattened, with their tree's structure."""
        bound = self.signature.bind(*args, **kwargs)
        bound.apply_defaults()
        static = {name: value for name, value in bound.arguments.items() if name in self.static}
        arrays = {name: value for name, value in bound.arguments.items() if name not in self.static}
        leaves, structure = jax.tree.flatten(arrays)
        return static, [_anywhere(leaf) for leaf in leaves], structure

    def _program(self, static: dict[str, Any], leaves: list[Any], structure: Any) -> Program:
        """The compiled program for such arguments: from their arrays to the function's results."""
        # Settings that a program depends on besides its arguments.
        names = ("jax_enable_x64", "jax_default_matmul_precision", "jax_default_device")
        surroundings = *(getattr(jax.config, name) for name in names), jax.device_count()
        key = tuple(static.items()), structure, tuple(map(_leaf_key, leaves)), surroundings
        # Of several threads one compiles.
        with self.lock:
            if key not in self.programs:
                began = time.perf_counter()
                COMPILED_NOW.add(key)
                try:
                    self.programs[key] = self._load_or_compile(static, leaves, structure, key)
                finally:
                    COMPILED_NOW.discard(key)
                    SECONDS_COMPILING.append(time.perf_counter() - began)
            return self.programs[key]

    def _load_or_compile(self, static: dict[str, Any], arrays: list[Any], arrays_tree: Any, key: Hashable) -> Program:
        path = program_path(self.function, key)
        if path and (traced := load_program(path)):
            exported, structure = traced
            return _unflattened(_compiled(exported, arrays), structure)
        structure = None

        @functools.wraps(self.function)
        def function(leaves):
            nonlocal structure
            # By place what can be: JAX's transformations ask for that.
            bound = self.signature.bind(**jax.tree.unflatten(arrays_tree, leaves), **static)
            leaves, structure = jax.tree.flatten(self.function(*bound.args, **bound.kwargs))
            return leaves

        jitted = jax.jit(function, compiler_options=compiler_options())
        if path is None:
            return _unflattened(jitted.lower(arrays).compile(), structure)
        exported = export(jitted)(arrays)
        save_program(path, exported, structure)
        return _unflattened(_compiled(exported, arrays), structure)


def _unflattened(compiled: jax.stages.Compiled, structure: Any) -> Program:
    return lambda leaves: jax.tree.unflatten(structure, compiled(leaves))


def _compiled(exported: Exported, leaves: list[Any]) -> jax.stages.Compiled:
    """The compiled program, from JAX's own files if it was compiled before."""

    def call(leaves):
        return exported.call(leaves)

    call.__name__ = exported.fun_name + EXPORTED
    shardings: dict[str, Any] = {}
    if exported.nr_devices > 1:
        # A program for several devices runs only where its arguments are on all of them.
        mesh = jax.sharding.Mesh(jax.devices()[: exported.nr_devices], "device")
        everywhere = jax.sharding.NamedSharding(mesh, jax.sharding.PartitionSpec())
        shardings = {"in_shardings": ([everywhere] * len(exported.in_avals),)}
    return jax.jit(call, compiler_options=compiler_options(), **shardings).lower(leaves).compile()


ALL_JITTED: weakref.WeakSet[Jitted] = weakref.WeakSet()
"""Every function that was jitted, so that all can forget what they compiled."""


COMPILED_NOW: set[Hashable] = set()


SECONDS_COMPILING: list[float] = []
"""How long each program of this process took to trace and compile, or to read from its file."""


def is_compiling() -> bool:
    """Whether a program is being compiled in any thread."""
    return bool(COMPILED_NOW)


def forget_programs() -> None:
    for jitted in ALL_JITTED:
        jitted.programs.clear()
    jax.clear_caches()


def _anywhere(leaf: Any) -> Any:
    """The array itself; its numbers, if it was put on some of the devices: programs share their work among all."""
    if not isinstance(leaf, jax.Array) or isinstance(leaf, Tracer) or not leaf.committed:
        return leaf
    return leaf if len(leaf.sharding.device_set) == jax.device_count() else np.asarray(leaf)


def _leaf_key(leaf: Any) -> Hashable:
    """All of an array that a program depends on: all but its values."""
    value = jax.typeof(leaf)
    where = leaf.sharding if isinstance(leaf, jax.Array) and leaf.committed else None
    return value.shape, str(value.dtype), getattr(value, "weak_type", False), where


def jit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`Jitted`, also as a decorator."""
    return functools.partial(Jitted, **options) if function is None else Jitted(function, **options)


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
    digest = hashlib.sha256()
    root = Path(__file__).parents[1]
    for file in sorted(root.rglob("*.py")):
        digest.update(str(file.relative_to(root)).encode() + file.read_bytes())
    libraries = [version(name) for name in ("jax", "jaxlib", "equinox", "numpy")]
    digest.update(repr((libraries, sys.version, jax.default_backend())).encode())
    return digest.hexdigest()[:16]


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
