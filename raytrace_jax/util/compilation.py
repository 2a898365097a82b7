"""Programs are compiled by `jit` with the options that were measured to help on the CPU, and kept for later processes.

A program is compiled once for each kind of arguments, by the thread that asks first: `Jitted.prepare` in one thread
lets another find it ready. JAX keeps compiled programs by itself, but by what tracing gave: a process has to trace each
program to find it, which takes longer than to run it. Here what tracing gave is found by what it was traced from: the
function, its static arguments, the kinds of its arrays, and the text of this package.
"""

import contextlib
import functools
import hashlib
import inspect
import os
import pickle
import sys
import threading
import weakref
from collections.abc import Callable, Hashable
from concurrent.futures import Future
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import jax
from jax.core import Tracer
from jax.export import Exported, deserialize, export

from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.numerics import with_lower_ranks

PACKAGE = __name__.partition(".")[0]

MOST_BYTES = 1_000_000_000
"""Room that programs may take, ours and JAX's, up to a megabyte each: of more, the oldest go."""

EXPORTED = "_exported"
"""End of the name of a program that is compiled from what was kept."""

_folder: Path | None = None


def keep_programs(folder: Path | None) -> None:
    """Keep programs in a folder that can be written, JAX's own, from now on; in none if it is None."""
    global _folder
    _folder = folder


class TracedProgram(NamedTuple):
    """A traced and lowered program, from a list of arrays to that of the results, with the results' tree."""

    exported: Exported
    structure: Any


def load_program(path: Path | None) -> TracedProgram | None:
    """The program that was kept in a file, if there is one that can be used."""
    if path is None or not path.exists():
        return None
    try:
        stored, example = pickle.loads(path.read_bytes())
        exported = deserialize(bytearray(stored))
        os.utime(path)
        return TracedProgram(exported, jax.tree.structure(example))
    except Exception:  # Whatever may be wrong with a file of a cache: it can be made anew.
        return None


def save_program(path: Path, program: TracedProgram) -> None:
    """Keep a program, if it can be kept."""
    # A program that cannot be stored, or a disk that is full, costs the next process time and nothing else.
    with contextlib.suppress(Exception):
        # A structure cannot be stored, what has it can.
        example = jax.tree.unflatten(program.structure, range(program.structure.num_leaves))
        content = pickle.dumps((bytes(program.exported.serialize()), example))
        with atomic_write(path) as temporary:
            temporary.write_bytes(content)
        _make_room(path.parents[2])


def _make_room(folder: Path) -> None:
    ours_and_jax_s = [*folder.glob("programs/*/*"), *folder.glob("jit_*-cache")]
    files = [(file.stat().st_mtime, file.stat().st_size, file) for file in ours_and_jax_s]
    total = sum(size for _, size, _ in files)
    for _, size, file in sorted(files):
        if total <= MOST_BYTES:
            break
        file.unlink(missing_ok=True)
        total -= size


def _program_path(function: Callable, key: Hashable) -> Path | None:
    """The file of a program; None where none is kept.

    Functions within functions depend on what they enclose, others' functions on what we do not see: not kept.
    """
    name = f"{function.__module__}.{function.__qualname__}"
    if _folder is None or not name.startswith(f"{PACKAGE}.") or "<" in name:
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
    return {name: value for name, value in CPU_OPTIONS.items() if _is_known(name, value)}


def _is_known(name: str, value: bool | int | str) -> bool:
    try:
        jax.jit(lambda x: x, compiler_options={name: value}).lower(jax.ShapeDtypeStruct((), "float32")).compile()
    except jax.errors.JaxRuntimeError:
        return False
    return True


class Program(NamedTuple):
    """A compiled program, called with a list of arrays, and the tree of its results."""

    compiled: jax.stages.Compiled
    structure: Any

    def __call__(self, leaves: list[Any]) -> Any:
        """The results for these arrays."""
        return jax.tree.unflatten(self.structure, self.compiled(leaves))


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
        self.programs: dict[Hashable, Future] = {}
        self.lock = threading.Lock()
        self.within = jax.jit(function, static_argnames=tuple(self.static))
        ALL_JITTED.add(self)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """The function's results for these arguments."""
        call = self._bind(args, kwargs)
        if any(isinstance(leaf, Tracer) for leaf in call.leaves):
            return self.within(*args, **kwargs)
        return self._program(call)(call.leaves)

    def prepare(self, *args: Any, **kwargs: Any) -> None:
        """Compile the program for such arguments if there is none, and run nothing."""
        self._program(self._bind(args, kwargs))

    def _bind(self, args: tuple, kwargs: dict[str, Any]) -> "_Call":
        bound = self.signature.bind(*args, **kwargs)
        bound.apply_defaults()
        static = {name: value for name, value in bound.arguments.items() if name in self.static}
        arrays = {name: value for name, value in bound.arguments.items() if name not in self.static}
        return _Call(static, *jax.tree.flatten(arrays))

    def _program(self, call: "_Call") -> Program:
        # Settings that a program depends on besides its arguments.
        names = ("jax_enable_x64", "jax_default_matmul_precision", "jax_default_device")
        surroundings = *(getattr(jax.config, name) for name in names), jax.device_count()
        key = tuple(call.static.items()), call.structure, tuple(map(_leaf_key, call.leaves)), surroundings
        with self.lock:
            place = self.programs.get(key)
            is_new = place is None
            if place is None:
                place = self.programs[key] = Future()
        if is_new:
            try:
                UNDER_WAY.append(key)
                place.set_result(self._load_or_compile(call, key))
            except BaseException as error:
                # Whoever waits is told, whoever comes later tries again.
                self.programs.pop(key, None)
                place.set_exception(error)
                raise
            finally:
                UNDER_WAY.remove(key)
        return place.result()

    def _load_or_compile(self, call: "_Call", key: Hashable) -> Program:
        path = _program_path(self.function, key)
        traced = load_program(path)
        if traced is None:
            structure = None

            @functools.wraps(self.function)
            def function(leaves):
                nonlocal structure
                given = {**jax.tree.unflatten(call.structure, leaves), **call.static}
                # In the order of the signature, by place what can be: JAX's transformations ask for that.
                bound = inspect.BoundArguments(
                    self.signature, {name: given[name] for name in self.signature.parameters if name in given}
                )
                result = self.function(*bound.args, **bound.kwargs)
                leaves, structure = jax.tree.flatten(result)
                return leaves

            jitted = jax.jit(function, compiler_options=compiler_options())
            if path is None:
                return Program(jitted.lower(call.leaves).compile(), structure)
            exported = export(jitted)(call.leaves)
            traced = TracedProgram(exported, structure)
            save_program(path, traced)
        return Program(_compiled(traced.exported, call.leaves), traced.structure)


class _Call(NamedTuple):
    """Arguments by name: those that are static; and the arrays, flattened, with their tree's structure."""

    static: dict[str, Any]
    leaves: list[Any]
    structure: Any


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


UNDER_WAY: list[Hashable] = []
"""The keys of the programs that are being traced and compiled."""


def is_compiling() -> bool:
    """Whether a program is being compiled."""
    return bool(UNDER_WAY)


def forget_programs() -> None:
    """Give back the memory of all compiled programs."""
    for jitted in ALL_JITTED:
        jitted.programs.clear()
    jax.clear_caches()


def _leaf_key(leaf: Any) -> Hashable:
    """All of an array that a program depends on: all but its values."""
    value = jax.typeof(leaf)
    where = leaf.sharding if isinstance(leaf, jax.Array) and leaf.committed else None
    return value.shape, str(value.dtype), getattr(value, "weak_type", False), where


def jit(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`Jitted`, also as a decorator."""
    return functools.partial(Jitted, **options) if function is None else Jitted(function, **options)
