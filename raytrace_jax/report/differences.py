"""Finite differences of pictures, to check derivatives against: they need none, and include the motion of edges."""

import contextlib
import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import ArrayLike, Float

from ..errors import ParameterError
from ..scene.parameters import get_parameter, row_of_names, scalar_names, set_parameters, with_response
from ..scene.scene import Scene
from ..tracer.rendering import differentiated_names, render
from ..tracer.settings import RenderSettings, resolve_settings
from ..util.numerics import on_host
from ..util.text import quoted

HALVINGS = 4
"""A step that leaves a parameter's limits is halved so often before the difference becomes one-sided.

One-sided, a difference by alpha is off by about half a step in its own units on two scenes; halved it is right to 2e-4
and better, though noise of edges that cross samples doubles with each halving (experiments/tuning)."""


def finite_differences(
    scene: Scene,
    names: Iterable[str],
    settings: RenderSettings | None = None,
    step: float = 6e-3,
    samples: int = 16,
) -> Float[np.ndarray, "parameters 3 height width"]:
    """Difference quotients of point-sampled pictures, which include the motion of edges and need no derivative.

    They are central. Where a parameter's limits leave no room (an alpha of 1, a small radius) the step is halved up
    to four times, and at last taken to one side only.

    Args:
        settings: as for `picture_derivatives`; its `edges`, `samples` and AOVs are not used.
        step: how far a parameter moves to either side, in its own unit. An edge has to cross several samples on the
            way, or the difference is noise.
        samples: the pictures have `samples` x `samples` rays a pixel, 1 to 64.

    Raises:
        ParameterError: as `picture_derivatives`; or a parameter cannot move by the step, or not visibly in its dtype.
        ValueError: the step is not a finite number above 0; `samples` is out of range; a crop outside of the picture.
    """
    settings = resolve_settings(scene, settings)
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"step is {step}; it can be any number greater than 0")
    scene = with_response(scene, names := row_of_names(names))
    settings = dataclasses.replace(settings, edges="point", samples=samples, aov=())
    # A step that a parameter cannot take is refused before the first picture.
    ends = {name: _ends(scene, name, step) for name in differentiated_names(scene, names)}
    differences = []
    for name, (ahead, behind) in ends.items():
        # Between the numbers as they are stored: in float32 they lie a little off `value + step`.
        width = float(get_parameter(ahead, name)) - float(get_parameter(behind, name))
        after, before = (np.asarray(render(end, settings).image) for end in (ahead, behind))
        differences.append((after - before) / after.dtype.type(width))
    return np.stack(differences)


def relative_error(derivative: ArrayLike, reference: ArrayLike) -> float:
    """The L2 norm of `derivative - reference` in units of the reference's; 0 if they are equal, also if both are 0."""
    derivative, reference = np.asarray(derivative), on_host(reference)
    error, size = float(np.linalg.norm(derivative - reference)), float(np.linalg.norm(reference))
    if error == 0:
        return 0.0
    return error / size if size > 0 else float("inf")


def correlation(derivative: ArrayLike, reference: ArrayLike) -> float:
    """Pearson's correlation of two derivative pictures over pixels and channels; 0 if one of them is constant."""
    one, other = (values - values.mean() for values in map(on_host, (derivative, reference)))
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.sum(one * other)) / size if size > 0 else 0.0


def _ends(scene: Scene, name: str, step: float) -> tuple[Scene, Scene]:
    """Two scenes in which one parameter lies on either side of its value, or at it where a limit is near."""
    value = float(get_parameter(scene, name))

    def moved(change: float) -> Scene | None:
        with contextlib.suppress(ParameterError):
            return set_parameters(scene, {name: value + change})

    for halvings in range(HALVINGS + 1):
        ahead, behind = (moved(sign * step / 2**halvings) for sign in (1, -1))
        if ahead and behind:
            break
    else:
        # At a limit: one side only, by the whole step.
        ahead, behind = (moved(sign * step) or scene for sign in (1, -1))
    if float(get_parameter(ahead, name)) == float(get_parameter(behind, name)):
        raise ParameterError(f"{quoted(name)}: {value:g} cannot move by a step of {step:g}; choose another step.")
    return ahead, behind


class Differences(NamedTuple):
    """Difference quotients of a picture, and how they were made."""

    values: Float[np.ndarray, "parameters 3 height width"]
    spreads: tuple[float, ...]  # The relative L2 differences from those by twice the step: about their own errors.
    steps: tuple[float, ...]  # How far each parameter moved to either side, before its limits.
    samples: int


def steady_differences(
    scene: Scene,
    names: Iterable[str],
    settings: RenderSettings | None = None,
    step: float | None = None,
    samples: int | None = None,
) -> Differences:
    """Central finite differences of a picture by two steps, the second half of the first, to check derivatives against.

    Args:
        step: the first step. Without it the step is halved until the differences by two steps agree, or until halving
            it once more makes them worse, as the noise of samples then does.
        samples: as for `finite_differences`; without it 16 to 48, fewer in large pictures.
    """
    settings = resolve_settings(scene, settings)
    scalars = scalar_names(scene, names)
    if samples is None:
        # About 8e6 rays take some seconds, and lie as near to each other in the scene whatever the picture's size.
        samples = int(np.clip(np.sqrt(8e6 / np.prod(settings.window(scene.camera.pixeldim)[2:])), 16, 48))
    # Edges of a scene of some units cross several samples on the way. An image in glass moves by hundreds of pixels for
    # a unit of the index, which asks for a smaller step.
    first = 0.006 if step is None else step

    def differ(names: Iterable[str], halvings: int) -> Float[np.ndarray, "parameters 3 height width"]:
        return finite_differences(scene, names, settings, first / 2**halvings, samples)

    # Of all parameters first: a step that one cannot take is refused before the work.
    pairs = zip(scalars, differ(scalars, 0), differ(scalars, 1), strict=True)
    values, spreads, steps = zip(*(_settle(*pair, differ, step is None) for pair in pairs), strict=True)
    return Differences(np.stack(values), spreads, tuple(first / 2**halvings for halvings in steps), samples)


def _settle(
    name: str, coarser: np.ndarray, finer: np.ndarray, differ, may_halve: bool
) -> tuple[np.ndarray, float, int]:
    """The difference by the best step, its spread, and how often the first step was halved for it."""
    halvings = 1
    # Where limits are near both steps may have been shortened to one and the same, which would say nothing.
    while np.array_equal(coarser, finer) and finer.any() and halvings <= HALVINGS:
        halvings += 1
        (finer,) = differ([name], halvings)
    best = finer, relative_error(coarser, finer), halvings
    # Differences by two steps within 15 % of each other need no smaller step. Six steps are tried at most.
    while may_halve and best[1] > 0.15 and halvings + 1 < 6:
        halvings += 1
        coarser, (finer,) = finer, differ([name], halvings)
        spread = relative_error(coarser, finer)
        if spread >= best[1]:
            break
        best = finer, spread, halvings
    return best
