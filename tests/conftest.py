"""The whole suite runs under strict flags, in double precision; in CI with shapes checked, on two CPU devices."""

import collections
import contextlib
import ctypes
import functools
import gc
import os
from pathlib import Path

import hypothesis
import jax
import jaxtyping
import numpy as np
import psutil
import pytest
from xdist.scheduler import LoadFileScheduling

# Most of the suite's time is XLA's. Its older code generator takes half as long for the small programs of which tests
# are full, and nothing is gained by compiling one of them in 32 parts. JAX 0.12 has no other one, and refuses the flag.
if jax.__version_info__ < (0, 11):
    flags = "--xla_cpu_use_fusion_emitters=false --xla_cpu_parallel_codegen_split_count=1"
    os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {flags}"

jax.config.update("jax_enable_x64", True)
# CI shares batches out over two devices, whatever the machine, and checks shapes and types of the core. Either takes a
# twelfth of the suite's time more.
IN_CI = bool(os.environ.get("CI"))
jax.config.update("jax_num_cpu_devices", 2 if IN_CI else 1)
jax.config.update("jax_debug_nans", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
# Rank promotion stays allowed: a scalar a ray times a vector a ray, "rays" times "3 rays", is the package's convention.

# In the numerical core every annotation of a shape or a type is checked at run time. Its modules at the edges answer
# bad input with errors of their own instead. This must come before the package is imported.
PACKAGE = Path(__file__).parents[1] / "raytrace_jax"
EDGES = ("__init__", "error_bars", "options", "residual_function", "settings")
EDGES += ("result", "result_file")
CORE = [path for room in ("optics", "tracer", "inverse") for path in sorted((PACKAGE / room).rglob("*.py"))]
CORE = [path for path in CORE if path.stem not in EDGES]
CORE += [PACKAGE / name for name in ("scene/scene.py", "scene/structs.py", "util/numerics.py")]
if IN_CI:
    modules = [".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts) for path in CORE]
    jaxtyping.install_import_hook(modules, "beartype.beartype")

# A compile takes longer than any deadline. Everyone's suite draws the same examples, CI's and a user's; who looks for
# new ones says `--hypothesis-profile explore`.
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
hypothesis.settings.register_profile("explore", deadline=None, derandomize=False)
hypothesis.settings.load_profile("fixed")


LONGEST = ("fit", "physical", "fits_of_glass", "transformations", "textures", "render", "optics_formulas")
"""The files that take longest begin first, so that the processes of `-n 2` end together."""


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A file's tests run in one process: what one of them has compiled serves the others."""
    config.option.loadscopereorder = False
    return LoadFileScheduling(config, log)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    seen = collections.Counter()
    for item in items:
        fast_cases = item.get_closest_marker("fast_cases")
        if fast_cases is not None:
            function = item.nodeid.partition("[")[0]
            seen[function] += 1
            if seen[function] > fast_cases.args[0]:
                item.add_marker(pytest.mark.slow)
    order = {f"test_{name}": place for place, name in enumerate(LONGEST)}
    items.sort(key=lambda item: order.get(item.path.stem, len(order)))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    # Nearly all of the suite's time is XLA's. With less effort it makes the same program up to rounding in two thirds
    # of the time, which is fast enough for small pictures; fits run longer than they save.
    jax.config.update("jax_disable_most_optimizations", item.get_closest_marker("optimized") is None)


def pytest_configure(config):
    # By its class, wherever it is said to come from. Not in pyproject.toml: pytest would import the package
    # before the hook above.
    config.addinivalue_line("filterwarnings", "error::raytrace_jax.errors.RaytraceWarning")
    if IN_CI:
        # Before all other filters, which take exceptions from it.
        config.getini("filterwarnings").insert(0, "error")
        if config.option.durations is None:
            config.option.durations = 20
    # Programs compiled by an earlier run, or by the other process of `-n 2`, are not compiled again; nor are the small
    # ones, of which there are so many that unit tests take a sixth less time.
    # What was compiled for another processor crashes on this one, and JAX's key does not tell them apart.
    features = np.show_config(mode="dicts")["SIMD Extensions"]["found"]
    jax.config.update("jax_compilation_cache_dir", str(config.cache.mkdir("-".join(["jax", *features]))))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


@pytest.fixture(autouse=True)
def bounded_memory():
    """Forget compiled programs beyond 5 GB, so that two processes fit into 16 GB; the cache on disk has them still."""
    yield
    if psutil.Process().memory_info().rss > 5e9:
        # Not at the top: the hook above comes before the package.
        from raytrace_jax.util.compilation import forget_programs

        forget_programs()
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # The C library of Linux has it, others need it less.
            ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture
def unroll(monkeypatch):
    """Let straight-line code meet so many shapes, and a loop those of a scene that has more."""
    return functools.partial(monkeypatch.setattr, "raytrace_jax.tracer.geometry.shape_types.UNROLL")


@pytest.fixture
def replace_work(monkeypatch):
    """Let a command do something else: `replace_work("fit.fit", function)`, by the place within `cli.actions`."""
    return lambda place, function: monkeypatch.setattr(f"raytrace_jax.cli.actions.{place}", function)
