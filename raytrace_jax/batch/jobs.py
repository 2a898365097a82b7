"""The jobs of a plan, with all that determines their outcomes, their names and their labels."""

import dataclasses
import functools
import hashlib
import itertools
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from .._version import __version__
from ..scene.parameters import set_parameters
from ..scene.reader import parse_scene
from ..scene.scene import Scene
from ..scene.table import BLOCK_TYPES
from ..tracer.resolved_settings import ResolvedSettings
from ..tracer.settings import Precision
from .plan import OPTIONS, BatchPlan, PlannedScene, Values

TableCell = float | int | str | None
Row = dict[str, TableCell]
JobKind = Literal["render", "gradient", "fit"]


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
    target: str = ""  # The target's file, for a fit that has one; its contents are among the options.
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
    kinds: list[tuple[JobKind, dict[str, Any], list[tuple[dict[str, Any], str]]]] = []
    if plan.render:
        kinds.append(("render", {}, [({}, "")]))
    if plan.gradient:
        changes = {"edges": plan.gradient.edges, "aov": ()}
        kinds.append(("gradient", changes, [({"wrt": list(plan.gradient.wrt)}, "")]))
    if plan.fit:
        kinds.append(("fit", {"edges": "point", "aov": ()}, list(_fits(plan))))
    combinations = [dict(zip(plan.grid, values, strict=True)) for values in itertools.product(*plan.grid.values())]
    rows = [{**plan.fixed, **row, **combination} for row in plan.rows for combination in combinations]
    return [
        Job(kind, name, scene, values, dataclasses.replace(scene.settings, **changes), plan.precision, options, path)
        for kind, changes, each in kinds
        for name, scene in plan.scenes.items()
        for values in rows
        for options, path in each
    ]


def job_scene(job: Job, values: Values | None = None) -> Scene:
    """A job's scene with its values, or with other ones; float64 needs `jax_enable_x64`."""
    dtype = np.dtype(jnp.float64 if job.precision == 64 else jnp.float32)
    return set_parameters(_parsed(job.scene, dtype), job.values if values is None else values)


def _fits(plan: BatchPlan) -> Iterator[tuple[dict[str, Any], str]]:
    """For one scene and its values the options of each fit, and the path of its target's file."""
    fit = plan.fit
    assert fit is not None
    common = {"free": list(fit.table.free), "start": dict(fit.start)}
    common |= {name: getattr(fit.options, name) for name in OPTIONS}
    # A rendered target takes the job's values, and the fit starts at the plan's; a file's fit starts at the job's.
    rendered = [({"target_samples": fit.table.target_samples, "fixed": dict(plan.fixed)}, "")]
    for target, path in fit.targets or rendered:
        for sigma in fit.table.noise:
            # Without noise a seed makes no difference.
            for seed in fit.table.seeds if sigma > 0 else (None,):
                yield {**common, **target, "noise": sigma, "seed": seed}, path


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

OF_NOISE, TOTAL = ".standard_error", ".total_error"  # Ends of the columns of an estimate's errors.


def value_cells(job: Job) -> Row:
    cells: Row = {}
    for name, value in job.values.items():
        if isinstance(value, tuple):
            components = COMPONENTS[name.rpartition(".")[2], len(value)]
            cells |= {f"{name}.{component}": number for component, number in zip(components, value, strict=True)}
        else:
            cells[name] = value
    return cells


def target_cells(job: Job) -> Row:
    if job.kind != "fit":
        return {}
    names = {"target_name": "target", "noise": "noise", "seed": "seed"}
    return {column: job.options.get(name) for name, column in names.items()}


def labelled(jobs: Sequence[Job]) -> list[Job]:
    """The jobs with their field `varied`: what is not the same in all jobs of the kind."""
    rows = [{"scene": job.scene_name, **value_cells(job), **target_cells(job)} for job in jobs]
    seen: dict[tuple[str, str], set[TableCell]] = {}
    for job, row in zip(jobs, rows, strict=True):
        for name, cell in row.items():
            seen.setdefault((job.kind, name), set()).add(cell)

    def varied(job: Job, row: Row) -> tuple[tuple[str, str], ...]:
        return tuple((n, cell_text(c)) for n, c in row.items() if c is not None and len(seen[job.kind, n]) > 1)

    return [dataclasses.replace(job, varied=varied(job, row)) for job, row in zip(jobs, rows, strict=True)]


def file_name(job: Job) -> str:
    """The name of a job's files without a suffix, as `vitreous.ior=1.45_3f2a9b1c`."""
    # Of the characters before the fingerprint 100: most systems allow 255 in all, Windows 260 in a path.
    pieces = [Path(value).stem if name == "scene" else f"{name}={value}" for name, value in job.varied]
    words = re.sub(r"[^\w.,=+-]", "_", ",".join(pieces) or Path(job.scene_name).stem, flags=re.ASCII)[:100]
    # The fingerprint tells jobs apart that look alike: other plans with the same folder vary the same names.
    return f"{words}_{job.name[:8]}"


def cell_text(cell: TableCell) -> str:
    return f"{cell:.6g}" if isinstance(cell, float) else str(cell)
