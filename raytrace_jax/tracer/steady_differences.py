"""Finite differences by two steps each, so that they tell how far they can be trusted, and by a step that suits."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.derivatives import HALVINGS, finite_differences, relative_error
from raytrace_jax.tracer.resolved_settings import resolve_settings
from raytrace_jax.tracer.settings import RenderSettings


class Differences(NamedTuple):
    """Finite differences of a picture.

    Args:
        values: for each parameter the change of the picture per unit.
        spreads: for each the relative L2 difference from those by twice the step: about their own error, be it that of
            a step that is too long or of samples that are too few for a short one.
        steps: for each how far it moved to either side, before its limits.
        samples: the pictures have `samples` x `samples` rays a pixel.
    """

    values: Float[np.ndarray, "parameters 3 height width"]
    spreads: tuple[float, ...]
    steps: tuple[float, ...]
    samples: int


def steady_differences(
    scene: Scene,
    names: Iterable[str],
    settings: RenderSettings | None = None,
    step: float | None = None,
    samples: int | None = None,
    on_step: Callable[[str], None] | None = None,
) -> Differences:
    """Central finite differences of a picture by two steps, the second half of the first, to check derivatives against.

    Args:
        scene, names, settings: as for `finite_differences`.
        step: the first step. Without it the step is halved until the differences by two steps agree, or until halving
            it once more makes them worse, as the noise of samples then does.
        samples: as for `finite_differences`; without it as many as `default_samples` says.
        on_step: called with a scalar parameter's name for each difference.

    Raises:
        ParameterError, ValueError: as `finite_differences`.
    """
    settings = resolve_settings(scene, settings)
    scalars = scalar_names(scene, names)
    if samples is None:
        samples = default_samples(settings.window(scene.camera.pixeldim)[2:])
    # Edges of a scene of some units cross several samples on the way. An image in glass moves by hundreds of pixels for
    # a unit of the index, which asks for a smaller step.
    first = 0.006 if step is None else step

    def differ(names: Iterable[str], halvings: int) -> Float[np.ndarray, "parameters 3 height width"]:
        return finite_differences(scene, names, settings, first / 2**halvings, samples, on_step)

    # Of all parameters first: a step that one cannot take is refused before the work.
    pairs = zip(scalars, differ(scalars, 0), differ(scalars, 1), strict=True)
    values, spreads, steps = zip(*(_settle(*pair, differ, step is None) for pair in pairs), strict=True)
    return Differences(np.stack(values), spreads, tuple(first / 2**halvings for halvings in steps), samples)


def default_samples(size: tuple[int, int]) -> int:
    """How many samples a pixel has in each direction in a picture of that width and height."""
    # About 8e6 rays take some seconds, and lie as near to each other in the scene whatever the picture's size.
    return int(np.clip(np.sqrt(8e6 / (size[0] * size[1])), 16, 48))


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
