"""The table `[fit]` of a plan: what is found, of which targets, from where, and how."""

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from typing import Annotated

from raytrace_jax.batch.plan_file import PlanFile
from raytrace_jax.batch.plan_scenes import PlanScenes
from raytrace_jax.batch.plan_values import Value, read_value
from raytrace_jax.errors import RaytraceError
from raytrace_jax.inverse.fixed import numbers_of, standard_deviation
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.scene.parameters import scalar_names, set_parameters
from raytrace_jax.scene.setting_words import MAX_SAMPLES
from raytrace_jax.util.checked import Checked, Wanted
from raytrace_jax.util.files import read_bytes

# In a plan `target_samples` is of targets that it renders; a fit finds out by itself what it was.
# Correlations come from a calibration, not from a text.
NOT_OPTIONS = ("profiles", "max_seconds", "target_samples", "correlations")
OPTIONS = tuple(field.name for field in dataclasses.fields(FitOptions) if field.name not in NOT_OPTIONS)
"""What a plan can tell a fit: a job draws no profiles, and what it finds does not depend on how fast the machine is."""


@dataclasses.dataclass(frozen=True)
class Target:
    """A target's file, and the SHA-256 of its contents."""

    name: str
    path: str
    digest: str


@dataclasses.dataclass(frozen=True)
class FitTable(Checked):
    """What the table `[fit]` says beside the options of the fit itself."""

    free: Annotated[tuple[str, ...], Wanted('the names of parameters, as ["vitreous.ior"]', some=True)]
    """The parameters to find."""
    targets: Annotated[tuple[str, ...], Wanted("an array of file names")] = ()
    """Files of targets; without them targets are rendered, with the values of the job."""
    target_samples: Annotated[int, Wanted(least=1, most=MAX_SAMPLES)] = 4
    """N x N rays in each pixel of a rendered target."""
    noise: Annotated[tuple[float, ...], Wanted("numbers from 0 up", least=0, below=math.inf, some=True)] = (0.0,)
    """Standard deviations of the noise that is added to the targets."""
    seeds: Annotated[tuple[int, ...], Wanted("whole numbers from 0 up", least=0, some=True)] = (0,)
    """Of the noise."""


@dataclasses.dataclass(frozen=True)
class FitPlan:
    """What is fitted.

    Args:
        start: where the search begins, for parameters that are not to begin at the scene file's value.
        targets: the targets' files; none: targets are rendered.
    """

    table: FitTable
    start: Mapping[str, Value]
    targets: tuple[Target, ...]
    options: FitOptions


def read_fit(file: PlanFile, scenes: PlanScenes) -> FitPlan:
    """Read and check the table `[fit]`.

    Raises:
        PlanError: an unknown name, a value that makes no sense, a parameter that a scene lacks, a missing target.
    """
    names = tuple(field.name for field in dataclasses.fields(FitTable))
    file.table(("fit",), known=(*names, "start", *OPTIONS))
    table, options = file.read(("fit",), FitTable), file.read(("fit",), FitOptions, OPTIONS)
    scenes.each(("fit", "free"), lambda scene: scalar_names(scene, table.free))
    start = {}
    for name, (keys, value) in file.parameters(("fit", "start")).items():
        start[name] = read_value(file, keys, value)
        scenes.each(keys, lambda scene, name=name: set_parameters(scene, {name: start[name]}))
    for follower, (keys, leader) in file.parameters(("fit", "ties")).items():
        scenes.each(keys, lambda scene, names=(follower, leader): [scalar_names(scene, [name]) for name in names])
    for name, (keys, _) in file.parameters(("fit", "priors")).items():
        scenes.each(keys, lambda scene, name=name: scalar_names(scene, [name]))
    for name, (keys, amount) in file.parameters(("fit", "uncertain")).items():
        scenes.each(
            keys,
            lambda scene, name=name, amount=amount: [
                standard_deviation(scene, address, name, amount) for address in numbers_of(scene, name)
            ],
        )
    return FitPlan(table, start, tuple(_target(file, name) for name in table.targets), options)


def _target(file: PlanFile, name: str) -> Target:
    path = file.path.parent.absolute() / name
    try:
        return Target(name, str(path), hashlib.sha256(read_bytes(path)).hexdigest())
    except RaytraceError as reason:
        raise file.error(("fit", "targets"), f"{reason}.") from None
