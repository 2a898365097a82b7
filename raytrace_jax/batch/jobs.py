"""The jobs of a plan, with all that determines their outcomes, their names and their labels."""

import collections
import dataclasses
import functools
import hashlib
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from .._version import __version__
from ..inverse.build_problem import OfViews
from ..scene.parameters import set_parameters
from ..scene.reader import parse_scene
from ..scene.scene import Scene
from ..scene.table import BLOCK_TYPES
from ..tracer.settings import Precision, ResolvedSettings
from .plan import BatchPlan, JobKind, PlannedScene, Values

TableCell = float | int | str | None
Row = dict[str, TableCell]


@dataclasses.dataclass(frozen=True)
class Job:
    """One picture, one set of derivatives or one fit; `scene_name` and `varied` determine nothing of it."""

    kind: JobKind
    scene_name: str  # The scene's file as the plan names it.
    scene: PlannedScene
    values: Values
    settings: ResolvedSettings
    precision: Precision
    options: Mapping[str, Any]  # All else that determines a job of its kind, as plain values that JSON can hold.
    target: OfViews[str] = ""  # The target's file, for a fit that has one; its contents are among the options.
    varied: tuple[tuple[str, str], ...] = ()  # Names and values that are not the same in all jobs of this kind.

    @functools.cached_property
    def name(self) -> str:
        """16 hexadecimal digits: a fingerprint of all that determines the outcome, and of this version."""
        parts = {
            "version": __version__,
            "kind": self.kind,
            "scene": self.scene.text,
            "pictures": self.scene.pictures,
            "values": dict(self.values),
            "settings": dataclasses.asdict(self.settings),
            "precision": self.precision,
            "options": dict(self.options),
        }
        numbers = json.loads(json.dumps(parts), parse_int=float)  # 2 is the same as 2.0.
        return hashlib.sha256(json.dumps(numbers, sort_keys=True).encode()).hexdigest()[:16]


def expand(plan: BatchPlan) -> list[Job]:
    """All jobs of a plan: kind by kind, scene by scene, row by row, the last name of the grid running fastest."""
    return [
        Job(kind, name, scene, values, dataclasses.replace(scene.settings, **changes), plan.precision, *task)
        for kind, (changes, tasks) in plan.work.items()
        for name, scene in plan.scenes.items()
        for values in plan.rows
        for task in tasks
    ]


def job_scene(job: Job, values: Values | None = None) -> Scene:
    """A job's scene with its values, or with other ones; float64 needs `jax_enable_x64`."""
    dtype = np.dtype(jnp.float64 if job.precision == 64 else jnp.float32)
    return set_parameters(_parsed(job.scene, dtype), job.values if values is None else values)


@functools.lru_cache(maxsize=64)
def _parsed(scene: PlannedScene, dtype: np.dtype) -> Scene:
    """The scene of a text; the jobs of a batch share few of them."""
    return parse_scene(scene.text, dtype=dtype, model=scene.settings.model, folder=scene.folder)


COMPONENTS = {
    (attribute.name, attribute.value_count): attribute.components
    for kinds in BLOCK_TYPES.values()
    for kind in kinds
    for attribute in kind.continuous
}

OF_NOISE, TOTAL, OF_TRUTH = ".standard_error", ".total_error", ".truth"  # Ends of the columns beside an estimate's.


def job_cells(job: Job) -> Row:
    """The cells of the table that say which job it is: its scene, its values, a fit's target."""
    cells: Row = {"scene": job.scene_name}
    for name, value in job.values.items():
        if isinstance(value, tuple):
            components = COMPONENTS[name.rpartition(".")[2], len(value)]
            cells |= {f"{name}.{component}": number for component, number in zip(components, value, strict=True)}
        else:
            cells[name] = value
    if job.kind == "fit":
        names = {"target": "target_name", "noise": "noise", "seed": "seed"}
        cells |= {column: job.options.get(name) for column, name in names.items()}
    return cells


def setting_cells(job: Job) -> Row:
    """The settings of a job as the plan and the scene have them, several numbers as the command line takes them."""
    values = {"precision": job.precision} | dataclasses.asdict(job.settings)
    return {
        f"settings.{name}": " ".join(map(str, value)) or None if isinstance(value, tuple) else value
        for name, value in values.items()
    }


def labelled(jobs: Sequence[Job]) -> list[Job]:
    """The jobs with their field `varied`: what is not the same in all jobs of the kind."""
    rows, distinct = [job_cells(job) for job in jobs], collections.defaultdict[tuple[str, str], set[TableCell]](set)
    for job, row in zip(jobs, rows, strict=True):
        for name, cell in row.items():
            distinct[job.kind, name].add(cell)

    found = []
    for job, row in zip(jobs, rows, strict=True):
        names = [name for name, cell in row.items() if cell is not None and len(distinct[job.kind, name]) > 1]
        found.append(dataclasses.replace(job, varied=tuple((name, cell_text(row[name])) for name in names)))
    return found


def file_name(job: Job) -> str:
    """The name of a job's files without a suffix, as `vitreous.ior=1.45_3f2a9b1c`."""
    # Of the characters before the fingerprint 100: most systems allow 255 in all, Windows 260 in a path.
    pieces = [Path(value).stem if name == "scene" else f"{name}={value}" for name, value in job.varied]
    words = re.sub(r"[^\w.,=+-]", "_", ",".join(pieces) or Path(job.scene_name).stem, flags=re.ASCII)[:100]
    # The fingerprint tells jobs apart that look alike: other plans with the same folder vary the same names.
    return f"{words}_{job.name[:8]}"


def cell_text(cell: TableCell) -> str:
    """A cell as people read it: six digits of a number."""
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
