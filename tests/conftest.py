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
import pytest
from xdist.scheduler import LoadFileScheduling

MOST_MEMORY = 5e9
"""Bytes; two processes of the suite side by side fit into 16 GB."""

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

# In the numerical core every annotation of a shape or a type is checked at run time. The modules at the edges answer
# bad input with errors of their own instead. This must come before the package is imported.
CORE = "util.numerics scene.structs scene.scene optics tracer.geometry tracer.visibility tracer.shading"
CORE += " tracer.levels tracer.world tracer.run tracer.pixels tracer.pure tracer.rendering tracer.derivatives"
CORE += " tracer.ray_tree"
CORE += " inverse.problem inverse.observe inverse.judge inverse.solve inverse.status inverse.estimate"
if IN_CI:
    jaxtyping.install_import_hook([f"raytrace_jax.{module}" for module in CORE.split()], "beartype.beartype")

# A compile takes longer than any deadline. Everyone's suite draws the same examples, CI's and a user's; who looks for
# new ones says `--hypothesis-profile explore`.
hypothesis.settings.register_profile("fixed", deadline=None, derandomize=True)
hypothesis.settings.register_profile("explore", deadline=None, derandomize=False)
hypothesis.settings.load_profile("fixed")


LONGEST = ("fit", "physical", "fits_of_glass", "renderer", "textures", "render", "optics_formulas")
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


LONG = 0.2
"""Seconds from which on compiling a program counts: what is above is most of the suite's time."""

MOST_PROGRAMS = 350
"""So many programs that long may the whole fast suite compile: what comes new is paid for by what goes. A slow machine
counts more of them: a busy one counted 227."""


class Weight:
    """Counts the programs that tests compile, says by file what tests take, and holds the fast suite to its budget."""

    compiled = 0

    def listen(self, name, seconds, **_):
        self.compiled += name == "/jax/core/compile/backend_compile_duration" and seconds > LONG

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_makereport(self, item, call):
        # Reports carry it from the processes of `-n 2` to the one that writes.
        item.user_properties[:] = [("programs", self.compiled)]
        self.compiled = 0

    def pytest_terminal_summary(self, terminalreporter, exitstatus, config):
        programs, seconds = self.by_file(terminalreporter)
        if len(programs) > 20:
            terminalreporter.section(f"{sum(programs.values())} programs of {LONG} s or more, by file")
            for file, count in sorted(programs.items(), key=lambda row: -seconds[row[0]])[:20]:
                terminalreporter.write_line(f"{count:4d} programs {seconds[file]:7.1f} s  {file}")

    def pytest_sessionfinish(self, session):
        programs, _ = self.by_file(session.config.pluginmanager.get_plugin("terminalreporter"))
        whole = len(programs) > 60 and session.config.option.markexpr == "not slow"
        if whole and sum(programs.values()) > MOST_PROGRAMS and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
            print(f"\nThe fast suite compiled {sum(programs.values())} long programs; its budget is {MOST_PROGRAMS}.")

    @staticmethod
    def by_file(terminalreporter):
        programs, seconds = collections.Counter(), collections.Counter()
        for reports in terminalreporter.stats.values() if terminalreporter else ():
            for report in reports:
                if hasattr(report, "user_properties") and hasattr(report, "when"):
                    file = report.nodeid.partition("::")[0]
                    programs[file] += dict(report.user_properties).get("programs", 0)
                    seconds[file] += report.duration
        return programs, seconds


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item):
    # Nearly all of the suite's time is XLA's. With less effort it makes the same program up to rounding in two thirds
    # of the time, which is fast enough for small pictures; fits run longer than they save.
    jax.config.update("jax_disable_most_optimizations", item.get_closest_marker("optimized") is None)


OUR_WARNINGS = ("ModelFileWarning", "SceneWarning", "PictureWarning")


def pytest_configure(config):
    weight = Weight()
    jax.monitoring.register_event_duration_secs_listener(weight.listen)
    config.pluginmanager.register(weight)
    # By their class, wherever they are said to come from. Not in pyproject.toml: pytest would import the package
    # before the hook above.
    for name in OUR_WARNINGS:
        config.addinivalue_line("filterwarnings", f"error::raytrace_jax.errors.{name}")
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
    """Give back what the compiler has left in the heap, and if that is not enough, forget compiled programs.

    Those that are still wanted come back from the cache on disk.
    """
    yield
    # Not at the top: the hook above comes before the package.
    from raytrace_jax.util.compilation import forget_programs

    for forget in (lambda: None, forget_programs):
        if memory_in_use() > MOST_MEMORY:
            forget()
            gc.collect()
            with contextlib.suppress(OSError, AttributeError):  # The C library of Linux has it, others need it less.
                ctypes.CDLL("libc.so.6").malloc_trim(0)


@pytest.fixture
def unroll(monkeypatch):
    """Let straight-line code meet so many shapes, and a loop those of a scene that has more."""
    return functools.partial(monkeypatch.setattr, "raytrace_jax.tracer.geometry.shape_types.UNROLL")


WORK = {
    "render": "render.render",
    "grad": "pictures.picture_derivatives",
    "fit": "fit.fit",
    "rays": "explain.draw_tree",
    "sweep": "pictures.render",
}
"""What the commands of the command line call for their work, of `cli.actions`."""


@pytest.fixture
def replace_work(monkeypatch):
    """Let a command do something else: `replace_work("fit", function)` has it called as `raytrace_jax.fit` would be."""

    def replace(command, function):
        monkeypatch.setattr(f"raytrace_jax.cli.actions.{WORK[command]}", function)

    return replace


def memory_in_use():
    """Bytes of this process, where the system tells (Linux), else 0."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")
