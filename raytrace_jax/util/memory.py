"""How much memory is left, so that what cannot fit is refused before it begins."""

import os
from collections.abc import Iterator
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")


def free_memory() -> int | None:
    """Bytes that this process may still take: what the machine, its container and its own limit leave; None if unknown.

    Linux tells all of these; elsewhere it is all of the machine's memory, or nothing is known.
    """
    return min(_bounds(), default=None)


def _bounds() -> Iterator[int]:
    used = 0
    try:
        fields = dict(line.split(":") for line in Path("/proc/meminfo").read_text().splitlines())
        yield 1024 * int(fields["MemAvailable"].split()[0])
        used = os.sysconf("SC_PAGE_SIZE") * int(Path("/proc/self/statm").read_text().split()[0])
    except (OSError, ValueError, KeyError):
        try:
            yield os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
        except (AttributeError, OSError, ValueError):  # Windows.
            return
    yield from _of_container()
    try:
        import resource
    except ImportError:
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY:
        yield max(limit - used, 0)


def _of_container() -> Iterator[int]:
    """What the control group of a container leaves, of either version; its pages of files can be given back."""
    for group, limit, usage, files in (
        (CGROUP, "memory.max", "memory.current", "file"),
        (CGROUP / "memory", "memory.limit_in_bytes", "memory.usage_in_bytes", "total_cache"),
    ):
        try:
            most, used = (int((group / name).read_text()) for name in (limit, usage))
            kept = dict(line.split() for line in (group / "memory.stat").read_text().splitlines())
            yield max(most - used + int(kept.get(files, 0)), 0)
        except (OSError, ValueError):  # There is none, or it has no limit ("max").
            continue
