"""A problem from what a user says: scene, target, free parameters, priors and options."""

import dataclasses
import math
import os
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from ..images.jpeg import JpegStorage
from ..images.pictures import read_origin
from ..scene.checks import check_values
from ..scene.parameters import (
    get_parameter,
    response_effects,
    row_of_names,
    scalar_names,
    set_parameters,
    with_response,
)
from ..scene.response import RESPONSE_EFFECTS
from ..scene.scene import Scene
from ..tracer.pixels import refuse_too_large
from ..tracer.settings import ResolvedSettings
from ..util.checked import refuse_other
from .options import FitOptions
from .problem.fixed import root_covariance, stated_uncertainties, with_known_offsets
from .problem.observation import Observation, observe
from .problem.problem import Problem
from .problem.unknowns import Priors, make_prior, make_unknowns, spelled


class FitSetup(NamedTuple):
    """A problem, with what the report wants to know of its parameters.

    Args:
        uncertain: standard deviation by canonical name of each fixed number that is stated to be uncertain.
    """

    problem: Problem
    priors: Priors
    uncertain: dict[str, float]
    profiled: tuple[int, ...]


def build_problem(
    scene: Scene,
    target: ArrayLike,
    free: Sequence[str],
    settings: ResolvedSettings,
    options: FitOptions,
    weights: ArrayLike | None = None,
    storage: JpegStorage | None = None,
) -> FitSetup:
    """The problem that a user means, under any of the names that a parameter has.

    Raises:
        ParameterError: unknown names, none at all, or one twice; a tie, prior or profile of what is not free.
        PictureError: a target of another size, with NaN or infinity, or constant; weights that make no sense; there is
            no memory for such a picture and its derivatives.
        SceneError: a number of the scene is not finite or cannot be what it is.
    """
    # What is free, and whether there is memory for it.
    if storage is not None:
        refuse_other(storage, JpegStorage, "jpeg_storage")
    check_values(scene)
    scene, free, ties = asked_for(scene, free, options)
    if options.edges == "aware":  # Its samples are those of the target, which `inverse.problem.sampling` adds.
        settings = dataclasses.replace(settings, samples=1)
    refuse_too_large(scene, settings, len(free))

    # What was observed: how large its light is says how large the numbers are that light is free with.
    observation = observe(target, weights, scene, settings)
    unknowns = make_unknowns(scene, free, ties, model=settings.model, light=observation.light_unit)

    def own(name: str, role: str) -> str:
        return spelled(scene, unknowns.names, name, role)

    # What is known besides, by the problem's own names.
    priors = {own(name, "prior"): prior for name, prior in options.priors.items()}
    profiled = tuple(unknowns.names.index(own(name, "profile")) for name in options.profiles)
    prior = make_prior(priors, unknowns, scene.camera.viewpoint.dtype)
    uncertain = stated_uncertainties(scene, unknowns, options.uncertain)
    # Refuses what cannot be.
    root_covariance(list(uncertain), np.array(list(uncertain.values())), options.correlations)
    problem = Problem(scene, observation, unknowns, prior, settings, options.target_samples, storage)
    reach = math.ceil(problem.response_reach(problem.start()))
    if reach:
        # The film mixes pixels: part of the light at the border comes from beyond it, so these do not count. With
        # them the blur of a ball before a board, 1.1 at 160 x 120, is off by 7 errors; without 4 rows by 2.
        observation = observation.weighted(inside(observation, max(4, reach)))
        problem = dataclasses.replace(problem, observation=observation)
    return FitSetup(problem, priors, uncertain, profiled)


def inside(observation: Observation, margin: int) -> Float[np.ndarray, "height width"]:
    """1 for the pixels that are at least `margin` from the border, 0 for others; 1 for all if none of these counts."""
    height, width = observation.counts.shape
    weight = np.zeros((height, width))
    weight[margin : height - margin, margin : width - margin] = 1
    return weight if np.any(weight * observation.counts) else np.ones_like(weight)


def asked_for(scene: Scene, free: Sequence[str], options: FitOptions) -> tuple[Scene, tuple[str, ...], dict[str, str]]:
    """The scene with the film that a fit asks for, if it has none; the free numbers, and the followers' leaders.

    Raises:
        ParameterError: a free number is unknown or named twice.
    """
    free, ties = list(row_of_names(free)), dict(options.ties)
    if options.fit_exposure:  # A gain and an offset that all channels have in common.
        free += ["film.gain.r", "film.offset.r"]
        ties |= {f"film.{name}.{channel}": f"film.{name}.r" for name in ("gain", "offset") for channel in "gb"}
    scene = with_response(scene, [*free, *ties, *ties.values(), *options.priors, *options.uncertain, *options.profiles])
    names = scalar_names(scene, free)
    # The film's free numbers that are 0 begin at their effect's start, if it has one.
    starts = {effect.name: effect.start for effect in RESPONSE_EFFECTS if effect.start is not None}
    effect_of = response_effects(scene, names).items()
    values = {
        name: starts[effect]
        for name, effect in effect_of
        if effect in starts and float(get_parameter(scene, name)) == 0
    }
    return set_parameters(scene, values), names, ties


def as_file_says(options: FitOptions, target: str | os.PathLike[str], scene: Scene, free: Sequence[str]) -> FitOptions:
    """The options with what a target's file says of how it was made, where nothing else was said; may warn."""
    origin, (filmed, names, _) = read_origin(target), asked_for(scene, free, options)
    return with_known_offsets(options.as_made(origin.how_made), filmed, names, origin.maker)
