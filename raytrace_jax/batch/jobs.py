"""From a plan to its jobs: each knows all that determines its outcome, and has a name made of that."""

import dataclasses
import functools
import hashlib
import itertools
import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.batch.fit_plan import OPTIONS
from raytrace_jax.batch.plan import BatchPlan, Values
from raytrace_jax.batch.plan_scenes import PlannedScene
from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.scene.reader import parse_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.settings import Precision


@dataclasses.dataclass(frozen=True)
class Job:
    """One picture, one set of derivatives or one fit.

    Args:
        kind: `render`, `gradient` or `fit`.
        scene_name: the scene's file as the plan names it; it determines nothing.
        values: parameters that are set in it.
        options: what else determines a job of its kind, as plain values that JSON can hold.
        target: the target's file, for a fit that has one; what is in it is among the options.
        varied: names and values of what is not the same in all jobs of this kind, for people; it determines nothing.
    """

    kind: str
    scene_name: str
    scene: PlannedScene
    values: Values
    settings: ResolvedSettings
    precision: Precision
    options: Mapping[str, Any]
    target: str = ""
    varied: tuple[tuple[str, str], ...] = ()

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

    @property
    def shape(self) -> str:
        """Jobs of equal shapes run the same compiled programs."""
        # What differs between fits of one shape are numbers: where they start, their targets, the noise.
        numbers = ("start", "fixed", "noise", "seed", "target", "target_name", "sigma")
        options = {name: value for name, value in self.options.items() if name not in numbers}
        return repr((self.kind, self.precision, self.settings, self.scene.structure, options))


def expand(plan: BatchPlan) -> list[Job]:
    """All jobs of a plan: kind by kind, scene by scene, row by row, the last name of the grid running fastest."""
    jobs = []
    if plan.render:
        for name, scene, values in _scenes_and_values(plan):
            jobs.append(Job("render", name, scene, values, scene.settings, plan.precision, {}))
    if plan.gradient:
        options = {"wrt": list(plan.gradient.wrt)}
        for name, scene, values in _scenes_and_values(plan):
            settings = dataclasses.replace(scene.settings, edges=plan.gradient.edges, aov=())
            jobs.append(Job("gradient", name, scene, values, settings, plan.precision, options))
    if plan.fit:
        for name, scene, values in _scenes_and_values(plan):
            settings = dataclasses.replace(scene.settings, edges="point", aov=())
            for options, path in _fits(plan):
                jobs.append(Job("fit", name, scene, values, settings, plan.precision, options, path))
    return jobs


def job_scene(job: Job, values: Values | None = None) -> Scene:
    """A job's scene with its values, or with other ones; float64 needs `jax_enable_x64`.

    Raises:
        ParameterError: the values are impossible together.
    """
    dtype = np.dtype(jnp.float64 if job.precision == 64 else jnp.float32)
    return set_parameters(_parsed(job.scene, dtype), job.values if values is None else values)


def by_shape(jobs: Sequence[Job]) -> list[list[Job]]:
    """The jobs in groups of equal shapes, in the order in which shapes and jobs come; equal jobs come once."""
    groups: dict[str, dict[str, Job]] = {}
    for job in jobs:
        groups.setdefault(job.shape, {}).setdefault(job.name, job)
    return [list(group.values()) for group in groups.values()]


def _scenes_and_values(plan: BatchPlan) -> Iterator[tuple[str, PlannedScene, Values]]:
    combinations = [dict(zip(plan.grid, values, strict=True)) for values in itertools.product(*plan.grid.values())]
    for name, scene in plan.scenes.items():
        for row in plan.rows:
            for combination in combinations:
                yield name, scene, {**plan.fixed, **row, **combination}


def _fits(plan: BatchPlan) -> Iterator[tuple[dict[str, Any], str]]:
    """For one scene and its values the options of each fit, and the path of its target's file."""
    fit = plan.fit
    assert fit is not None
    common = {
        "free": list(fit.table.free),
        "start": dict(fit.start),
        **{name: getattr(fit.options, name) for name in OPTIONS},
    }
    files = [({"target": target.digest, "target_name": target.name}, target.path) for target in fit.targets]
    # A rendered target takes the job's values, and the fit starts at the plan's; a file's fit starts at the job's.
    rendered = [({"target_samples": fit.table.target_samples, "fixed": dict(plan.fixed)}, "")]
    for target, path in files or rendered:
        for sigma in fit.table.noise:
            # Without noise a seed makes no difference.
            for seed in fit.table.seeds if sigma > 0 else (None,):
                yield {**common, **target, "noise": sigma, "seed": seed}, path


@functools.lru_cache(maxsize=64)
def _parsed(scene: PlannedScene, dtype: np.dtype) -> Scene:
    """The scene of a text; the jobs of a batch share few of them."""
    return parse_scene(scene.text, dtype=dtype, model=scene.settings.model, folder=scene.folder)
