"""What varies among the jobs of a plan: in words for people, and in the names of files."""

import dataclasses
import re
from collections.abc import Sequence
from pathlib import Path

from raytrace_jax.batch.jobs import Job
from raytrace_jax.scene.table import BLOCK_TYPES

Cell = float | int | str | None
Row = dict[str, Cell]

COMPONENTS = {
    (attribute.name, attribute.value_count): attribute.components
    for kinds in BLOCK_TYPES.values()
    for kind in kinds
    for attribute in kind.continuous
}

OF_NOISE, TOTAL = ".standard_error", ".total_error"
"""What the columns of an estimate's errors end in."""

LONGEST = 100
"""Characters of a file's name before the fingerprint; most systems allow 255 in all, Windows 260 in a path."""

_DEVICES = re.compile(r"(?i)^(con|prn|aux|nul|com\d|lpt\d)(?=\.)")
"""What Windows takes for a device, whatever follows the dot."""


def value_cells(job: Job) -> Row:
    """The values of a job by name, those of vectors by their components."""
    cells: Row = {}
    for name, value in job.values.items():
        if isinstance(value, tuple):
            components = COMPONENTS[name.rpartition(".")[2], len(value)]
            cells |= {f"{name}.{component}": number for component, number in zip(components, value, strict=True)}
        else:
            cells[name] = value
    return cells


def target_cells(job: Job) -> Row:
    """The target of a fit; nothing for other jobs."""
    if job.kind != "fit":
        return {}
    names = {"target_name": "target", "noise": "noise", "seed": "seed"}
    return {column: job.options.get(name) for name, column in names.items()}


def labelled(jobs: Sequence[Job]) -> list[Job]:
    """The jobs with their field `varied`: what is not the same in all jobs of the kind."""
    rows = [{"scene": job.scene_name, **value_cells(job), **target_cells(job)} for job in jobs]
    seen: dict[tuple[str, str], set[Cell]] = {}
    for job, row in zip(jobs, rows, strict=True):
        for name, cell in row.items():
            seen.setdefault((job.kind, name), set()).add(cell)
    varied = [
        tuple((n, cell_text(c)) for n, c in row.items() if c is not None and len(seen[job.kind, n]) > 1)
        for job, row in zip(jobs, rows, strict=True)
    ]
    return [dataclasses.replace(job, varied=pairs) for job, pairs in zip(jobs, varied, strict=True)]


def file_name(job: Job) -> str:
    """The name of a job's files without a suffix, as `vitreous.ior=1.45_3f2a9b1c`."""
    pieces = [Path(value).stem if name == "scene" else f"{name}={value}" for name, value in job.varied]
    words = re.sub(r"[^\w.,=+-]", "_", ",".join(pieces) or Path(job.scene_name).stem, flags=re.ASCII)[:LONGEST]
    # The fingerprint tells jobs apart that look alike: other plans with the same folder vary the same names.
    return _DEVICES.sub(r"\1_", words) + f"_{job.name[:8]}"


def cell_text(cell: Cell) -> str:
    """A number in up to six digits, a word as it is."""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
