"""A problem from what a user says: scene, target, free parameters, priors and options."""

import dataclasses
import math
from collections.abc import Iterable, Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple, TypeVar

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from ..errors import ParameterError, PictureError
from ..images.jpeg import JpegStorage
from ..images.pictures import read_origin
from ..scene.checks import check_values
from ..scene.parameters import (
    get_parameter,
    row_of_names,
    scalar_names,
    set_parameters,
    with_response,
)
from ..scene.response import FILM, RESPONSE_EFFECTS
from ..scene.scene import Scene
from ..tracer.pixels import refuse_too_large
from ..tracer.settings import ResolvedSettings
from ..util.checked import refuse_other
from ..util.files import StrPath
from ..util.text import did_you_mean, listed, quoted
from .options import FitOptions
from .problem.fixed import root_covariance, stated_uncertainties, with_known_offsets
from .problem.observation import Observation, observe
from .problem.problem import Problem
from .problem.unknowns import Priors, all_response_effects, make_prior, make_unknowns, spelled


class FitSetup(NamedTuple):
    """A problem, with what the report wants to know of its parameters.

    Args:
        uncertain: standard deviation by canonical name of each fixed number that is stated to be uncertain.
    """

    problem: Problem
    priors: Priors
    uncertain: dict[str, float]
    profiled: tuple[int, ...]


T = TypeVar("T")

OfViews = T | Mapping[str, T]
"""Of a scene's only camera; or by the name of each of its cameras."""


def of_each_view(scene: Scene, what: str, given: OfViews[Any], optional: bool = False) -> dict[str, Any]:
    """What is given of each camera of a scene, in the scene's order.

    Args:
        what: `a picture`, for the message.
        optional: what is no mapping is that of every camera, and a mapping need not have all; then it is None.

    Raises:
        ParameterError: a camera that the scene does not have, or one of which nothing is given.
    """
    cameras = scene.cameras
    if not isinstance(given, Mapping):
        if len(cameras) > 1 and not optional:
            names = ", ".join(f'"{name}": ...' for name in cameras)
            raise ParameterError(
                f"the scene has the cameras {listed(cameras)}: {what} of each is wanted, as {{{names}}}."
            )
        return dict.fromkeys(cameras, given)
    if unknown := [name for name in given if name not in cameras]:
        guess = did_you_mean(str(unknown[0]), cameras)
        having = f"the scene's cameras are {listed(cameras)}"
        raise ParameterError(f"there is {what} of {quoted(str(unknown[0]))}, and {having}.{guess}")
    if not optional and (missing := [name for name in cameras if name not in given]):
        raise ParameterError(
            f"there is no {what.removeprefix('a ')} of the camera {listed(missing)}: give one, or leave the camera "
            "out of the scene."
        )
    return {name: given.get(name) for name in cameras}


def build_problem(
    scene: Scene,
    target: OfViews[ArrayLike],
    free: Sequence[str],
    settings: OfViews[ResolvedSettings],
    options: FitOptions,
    weights: OfViews[ArrayLike | None] = None,
    storage: OfViews[JpegStorage | None] = None,
    shown: Mapping[str, Scene] = MappingProxyType({}),
) -> FitSetup:
    """The problem that a user means, under any of the names that a parameter has.

    Raises:
        ParameterError: unknown names, none at all, or one twice; a tie, prior or profile of what is not free; a camera
            without a target, or a target without a camera.
        PictureError: a target of another size, with NaN or infinity, or constant; weights that make no sense; there is
            no memory for such a picture and its derivatives.
        SceneError: a number of the scene is not finite or cannot be what it is.
    """
    # What is free, and whether there is memory for it.
    check_values(scene)
    targets = of_each_view(scene, "a picture", target)
    masks, stored = (of_each_view(scene, *each, optional=True) for each in (("weights", weights), ("storage", storage)))
    each_settings = of_each_view(scene, "settings", settings, optional=True)
    scene, free, ties = asked_for(scene, free, options)
    parts = of_each_view(scene, "a scene", shown, optional=True)
    seen = {name: (parts[name] or scene).seen_by(name) for name in scene.cameras}
    for name, view in seen.items():
        if stored[name] is not None:
            refuse_other(stored[name], JpegStorage, "jpeg_storage")
        if options.edges == "aware":  # Its samples are those of the target, which `inverse.problem.sampling` adds.
            each_settings[name] = dataclasses.replace(each_settings[name], samples=1)
        refuse_too_large(view.alone(), each_settings[name], len(free))

    # What was observed: how large its light is says how large the numbers are that light is free with.
    observed = {}
    for name, view in seen.items():
        try:
            observed[name] = observe(targets[name], masks[name], view, each_settings[name])
        except PictureError as reason:
            raise PictureError(f"the camera {name}: {reason}" if len(seen) > 1 else str(reason)) from None
    first, model = observed[scene.camera.name], each_settings[scene.camera.name].model
    unknowns = make_unknowns(scene, free, ties, model=model, light=first.light_unit)

    def own(name: str, role: str) -> str:
        return spelled(scene, unknowns.names, name, role)

    # What is known besides, by the problem's own names.
    priors = {own(name, "prior"): prior for name, prior in options.priors.items()}
    profiled = tuple(unknowns.names.index(own(name, "profile")) for name in options.profiles)
    uncertain = stated_uncertainties(scene, unknowns, options.uncertain)
    # Refuses what cannot be.
    root_covariance(list(uncertain), np.array(list(uncertain.values())), options.correlations)

    # A view has the unknowns as its camera knows them; priors count once.
    views, widest = [], max(observation.target.shape[2] for observation in observed.values())
    for name, view in seen.items():
        problem = Problem(
            view.alone(),
            observed[name],
            unknowns,
            make_prior({} if views else priors, unknowns, scene.camera.viewpoint.dtype),
            each_settings[name],
            scene,
            unknowns.seen_in(view),
            zoom=observed[name].target.shape[2] / widest,
            samples=options.target_samples,
            storage=stored[name],
        )
        views.append(without_border(problem))
    return FitSetup(views[0].of_views(views), priors, uncertain, profiled)


def without_border(problem: Problem) -> Problem:
    """The problem whose pixels near the border do not count where the film mixes pixels.

    Part of their light comes from beyond it. With them the blur of a ball before a board, 1.1 at 160 x 120, is off by 7
    errors; without 4 rows by 2.
    """
    reach = math.ceil(problem.response_reach(problem.start()))
    if not reach:
        return problem
    observation = problem.observation.weighted(inside(problem.observation, max(4, reach)))
    return dataclasses.replace(problem, observation=observation)


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
    if options.fit_exposure:  # A gain and an offset that all channels of a view have in common.
        for film in scene.cameras if len(scene.cameras) > 1 else [FILM]:
            free += [f"{film}.gain.r", f"{film}.offset.r"]
            ties |= {f"{film}.{name}.{channel}": f"{film}.{name}.r" for name in ("gain", "offset") for channel in "gb"}
    scene = with_response(scene, [*free, *ties, *ties.values(), *options.priors, *options.uncertain, *options.profiles])
    names = scalar_names(scene, free)
    # The film's free numbers that are 0 begin at their effect's start, if it has one.
    starts = {effect.name: effect.start for effect in RESPONSE_EFFECTS if effect.start is not None}
    effect_of = all_response_effects(scene, names).items()
    values = {
        name: starts[effect]
        for name, effect in effect_of
        if effect in starts and float(get_parameter(scene, name)) == 0
    }
    return set_parameters(scene, values), names, ties


def as_file_says(options: FitOptions, targets: Iterable[StrPath], scene: Scene, free: Sequence[str]) -> FitOptions:
    """The options with what the targets' files say of how they were made, where nothing else was said; may warn.

    The sampling is taken where all files say the same.
    """
    origins, (filmed, names, _) = [read_origin(target) for target in targets], asked_for(scene, free, options)
    made = [options.as_made(origin.how_made) for origin in origins]
    if len({(one.target_samples, one.target_sampling) for one in made}) == 1:
        options = made[0]
    for maker in dict.fromkeys(origin.maker for origin in origins):
        options = with_known_offsets(options, filmed, names, maker)
    return options
