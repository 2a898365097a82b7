"""The setup of JAX in programs of ours, the command line and a batch's workers, and the memory that is free."""

import contextlib
import os
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path

import jax

from ..errors import RaytraceWarning
from .cache_folder import cache_folder
from .compilation import keep_programs
from .files import StrPath


@contextlib.contextmanager
def jax_session(precision: int, devices: int | None = None) -> Iterator[None]:
    """Run JAX with 32 or 64 bits, on `devices` CPU devices (None: all cores up to 8), and keep compiled programs.

    In a process that uses JAX already cores and cache stay as they are. May warn as `enable_compile_cache`.
    """
    # macOS and Windows do not tell how many cores this process may use.
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    by_flag = "host_platform_device_count" in os.environ.get("XLA_FLAGS", "")
    with contextlib.suppress(RuntimeError):  # JAX runs already.
        if not by_flag and jax.config.jax_num_cpu_devices == -1:  # pyright: ignore[reportAttributeAccessIssue]
            jax.config.update("jax_num_cpu_devices", devices or min(cores, 8))
        enable_compile_cache()
    with jax.enable_x64(precision == 64):
        yield


def enable_compile_cache(folder: StrPath | None = None) -> None:
    """Keep compiled programs in files, so that the next process need not compile them again, as the command line does.

    Where JAX has a folder for that already nothing changes.

    Args:
        folder: where; None is `raytrace-jax` in the user's cache folder.

    Warns:
        RaytraceWarning: the folder cannot be written; nothing is kept then.
    """
    if jax.config.jax_compilation_cache_dir is not None:  # pyright: ignore[reportAttributeAccessIssue]
        return
    folder = cache_folder() if folder is None else Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as reason:
        warnings.warn(
            f"{folder}: compiled programs cannot be kept here, so that every start takes longer: {reason.strerror}.",
            RaytraceWarning,
            stacklevel=2,
        )
        return
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
    keep_programs(folder)


CGROUP = Path("/sys/fs/cgroup")


def free_memory() -> int | None:
    """Bytes that the machine, a container and the process' own limit leave; less is known outside Linux, or None."""
    return min(_bounds(), default=None)


def lack_of_memory(needed: int) -> str:
    """Why some bytes do not fit into memory: `needs about 3 GB of memory, and 2 GB are free`; empty where they fit."""
    # So few fit anywhere, and to ask how much memory there is takes some fifty microseconds.
    free = free_memory() if needed > 100_000_000 else None
    if free is None or needed <= free:
        return ""
    return f"needs about {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free"


def _bounds() -> Iterator[int]:
    with contextlib.suppress(ImportError, AttributeError, OSError, ValueError):  # Windows has none of it.
        import resource

        page = os.sysconf("SC_PAGE_SIZE")
        yield page * os.sysconf("SC_PHYS_PAGES")
        limit, _ = resource.getrlimit(resource.RLIMIT_AS)
        used = page * int(Path("/proc/self/statm").read_text().split()[0])
        if limit != resource.RLIM_INFINITY:
            yield max(limit - used, 0)
    with contextlib.suppress(OSError, ValueError, KeyError):
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        yield 1024 * int(fields["MemAvailable"].split()[0])
    # Control groups of either version, of a container, say; their pages of files can be given back.
    for group, limit, usage, files in (
        (CGROUP, "memory.max", "memory.current", "file"),
        (CGROUP / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache"),
    ):
        with contextlib.suppress(OSError, ValueError):  # There is none, or it has no limit ("max").
            most, taken = (int((group / name).read_text()) for name in (limit, usage))
            kept = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
            yield max(most - taken + int(kept.get(files, 0)), 0)
