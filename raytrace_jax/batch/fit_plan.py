"""The table `[fit]` of a plan: what is found, of which targets, from where, and how."""

import dataclasses
import hashlib
import math
from collections.abc import Mapping
from typing import Any, get_args

from raytrace_jax.batch.plan_file import PlanFile, shown
from raytrace_jax.batch.plan_scenes import PlanScenes
from raytrace_jax.batch.plan_values import (
    Value,
    read_count,
    read_numbers,
    read_option,
    read_switch,
    read_texts,
    read_value,
)
from raytrace_jax.errors import RaytraceError
from raytrace_jax.inverse.options import FitOptions, LossChoice, TargetSampling
from raytrace_jax.inverse.problem.stated import numbers_of, standard_deviation
from raytrace_jax.scene.parameters import scalar_names, set_parameters
from raytrace_jax.scene.setting_words import MAX_SAMPLES, EdgeMode
from raytrace_jax.util.files import read_bytes

# In a plan `target_samples` is of targets that it renders; a fit finds out by itself what it was.
# Correlations come from a calibration, not from a text.
NOT_OPTIONS = ("profiles", "max_seconds", "target_samples", "correlations")
OPTIONS = tuple(field.name for field in dataclasses.fields(FitOptions) if field.name not in NOT_OPTIONS)
"""What a plan can tell a fit: a job draws no profiles, and what it finds does not depend on how fast the machine is."""

NAMES = ("free", "start", "targets", "target_samples", "noise", "seeds", *OPTIONS)
MOST_STEPS = 100_000


@dataclasses.dataclass(frozen=True)
class Target:
    """A target's file, and the SHA-256 of its contents."""

    name: str
    path: str
    digest: str


@dataclasses.dataclass(frozen=True)
class FitPlan:
    """What is fitted.

    Args:
        free: the parameters to find.
        start: where the search begins, for parameters that are not to begin at the scene file's value.
        targets: files of targets; none: targets are rendered, with the values of the job.
        target_samples: n x n samples in each pixel of a rendered target.
        noise: standard deviations of the noise that is added to the targets.
        seeds: of the noise.
        options: of the fit itself.
    """

    free: tuple[str, ...]
    start: Mapping[str, Value]
    targets: tuple[Target, ...]
    target_samples: int
    noise: tuple[float, ...]
    seeds: tuple[int, ...]
    options: FitOptions


def read_fit(file: PlanFile, scenes: PlanScenes) -> FitPlan:
    """Read and check the table `[fit]`.

    Raises:
        PlanError: an unknown name, a value that makes no sense, a parameter that a scene lacks, a missing target.
    """
    table = file.table(("fit",), known=NAMES)
    if "free" not in table:
        raise file.error(("fit",), 'needs the names of parameters, as free = ["vitreous.ior"].')
    free = read_texts(file, ("fit", "free"), table["free"], "an array of the names of parameters")
    scenes.each(("fit", "free"), lambda scene: scalar_names(scene, free))
    start = {}
    for name, (keys, value) in file.parameters(("fit", "start")).items():
        start[name] = read_value(file, keys, value)
        scenes.each(keys, lambda scene, name=name: set_parameters(scene, {name: start[name]}))
    targets = _read_targets(file) if "targets" in table else ()
    return FitPlan(
        free=free,
        start=start,
        targets=targets,
        target_samples=read_count(file, ("fit", "target_samples"), 1, MAX_SAMPLES, 4),
        noise=read_numbers(file, ("fit", "noise"), table.get("noise", 0.0), "an array of numbers from 0 up", least=0),
        seeds=_read_seeds(file),
        options=_read_options(file, scenes),
    )


def _read_options(file: PlanFile, scenes: PlanScenes) -> FitOptions:
    """The options of the fit itself."""
    table = file.table(("fit",))
    options: dict[str, Any] = {"ties": {}, "priors": {}, "uncertain": {}}
    for name in ("search", "fit_exposure"):
        options[name] = read_switch(file, ("fit", name), getattr(FitOptions, name))
    for name, words in (("loss", LossChoice), ("edges", EdgeMode), ("target_sampling", TargetSampling)):
        options[name] = read_option(file, ("fit", name), get_args(words), getattr(FitOptions, name))
    options["max_steps"] = read_count(file, ("fit", "max_steps"), 1, MOST_STEPS, FitOptions.max_steps)
    if "sigma" in table:
        [*sigma] = read_numbers(file, ("fit", "sigma"), table["sigma"], "a number greater than 0")
        if len(sigma) != 1 or not sigma[0] > 0:
            raise file.error(("fit", "sigma"), f"is {shown(table['sigma'])}; a number greater than 0 is wanted.")
        options["sigma"] = sigma[0]
    if "blur" in table:
        options["blur"] = read_numbers(file, ("fit", "blur"), table["blur"], "an array of numbers from 0 up", least=0)
    for follower, (keys, leader) in file.parameters(("fit", "ties")).items():
        read_texts(file, keys, leader, "the name of a free parameter")
        scenes.each(keys, lambda scene, names=(follower, leader): [scalar_names(scene, [name]) for name in names])
        options["ties"][follower] = leader
    for name, (keys, prior) in file.parameters(("fit", "priors")).items():
        numbers = read_numbers(file, keys, prior, "an array of mean and standard deviation")
        if len(numbers) != 2 or not numbers[1] > 0:
            raise file.error(keys, f"is {shown(prior)}; a mean and a standard deviation above 0 are wanted.")
        scenes.each(keys, lambda scene, name=name: scalar_names(scene, [name]))
        options["priors"][name] = numbers
    for name, (keys, amount) in file.parameters(("fit", "uncertain")).items():
        if not isinstance(amount, (int, float, str)) or isinstance(amount, bool):
            raise file.error(keys, f'is {shown(amount)}; a standard deviation, or a share as "0.1%", is wanted.')
        scenes.each(
            keys,
            lambda scene, name=name, amount=amount: [
                standard_deviation(scene, address, name, amount) for address in numbers_of(scene, name)
            ],
        )
        options["uncertain"][name] = amount
    return FitOptions(**options)


def _read_targets(file: PlanFile) -> tuple[Target, ...]:
    keys = ("fit", "targets")
    names = read_texts(file, keys, file.table(("fit",))["targets"], "an array of file names")
    targets = []
    for name in names:
        path = file.path.parent.absolute() / name
        try:
            digest = hashlib.sha256(read_bytes(path)).hexdigest()
        except RaytraceError as reason:
            raise file.error(keys, f"{reason}.") from None
        targets.append(Target(name, str(path), digest))
    return tuple(targets)


def _read_seeds(file: PlanFile) -> tuple[int, ...]:
    seeds = file.table(("fit",)).get("seeds", 0)
    seeds = seeds if isinstance(seeds, list) else [seeds]
    if not seeds or not all(type(seed) is int and 0 <= seed < math.inf for seed in seeds):
        raise file.error(("fit", "seeds"), f"is {shown(seeds)}; an array of whole numbers from 0 up is wanted.")
    return tuple(seeds)
