"""How each pixel of a picture changes with each of some parameters, and finite differences to check it against."""

import dataclasses
import functools
from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

from raytrace_jax.errors import ParameterError
from raytrace_jax.scene.addresses import resolve
from raytrace_jax.scene.film import without_idle
from raytrace_jax.scene.parameters import get_parameter, scalar_names, set_parameters, with_film
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.validity import check_values
from raytrace_jax.tracer.memory import refuse_too_large
from raytrace_jax.tracer.programs.plan import Plan, Wanted
from raytrace_jax.tracer.programs.plan_cache import PLANS, scene_kind
from raytrace_jax.tracer.programs.planning import few_runs, plan_render
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.words import quoted

HALVINGS = 4
"""A step that leaves a parameter's limits is halved so often before the difference becomes one-sided.

Each halving makes the noise of edges that cross samples twice as large. But one-sided, a difference by alpha is off by
about half a step in its own units on two scenes; halved it is right to 2e-4 and better (experiments/tuning)."""


class PictureDerivatives(NamedTuple):
    """A picture and its derivatives.

    Args:
        image: scene-linear RGB.
        names: the scalar parameters.
        values: for each of them the change of the picture per unit of the parameter, signed.
        units: what one of each of them is, for people.
    """

    image: Float[Array, "3 height width"]
    names: tuple[str, ...]
    values: Float[Array, "parameters 3 height width"]
    units: tuple[str, ...] = ()


def picture_derivatives(
    scene: Scene,
    names: Iterable[str],
    settings: RenderSettings | None = None,
    on_step: Callable[[str], None] | None = None,
) -> PictureDerivatives:
    """Render a picture and differentiate each of its pixels with respect to parameters, in forward mode.

    The parameters are taken one at a time by one compiled program, in the memory of one derivative picture.

    Args:
        scene: the scene, with concrete values; its dtype is that of the pictures.
        names: the parameters; a vector such as `vitreous.center` stands for its numbers.
        settings: what to render, without its AOVs; None is what the scene's file says. Without `edges` the picture is
            that of points and the derivative that of areas; with `edges="point"` it is that of the colours at the
            pixels' points: what edges that move gain or lose is not in it.
        on_step: called with a scalar parameter's name when its derivative is there.

    Returns:
        The picture, and for each number the change of the picture per unit of it.

    Raises:
        ParameterError: no names, an unknown one, or two for one number.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such pictures.
    """
    # All that can be refused is refused before any work.
    settings = resolve_settings(scene, settings)
    scene = with_film(scene, names := tuple(names))
    scalars = _expand(scene, names)
    check_values(scene)
    settings = dataclasses.replace(settings, aov=())
    refuse_too_large(scene, settings, len(scalars))
    # Effects of the film that do nothing and are not differentiated are not computed.
    if scene.film is not None:
        varied = {one.field for name in scalars if (one := resolve(scene, name).address).group == "film"}
        scene = dataclasses.replace(scene, film=without_idle(scene.film, varied))
    values = jnp.stack([get_parameter(scene, name) for name in scalars])
    # Without `edges` the picture is that of points, and only the derivative that of areas.
    image, derivatives = render(scene, settings).image if settings.edges is None else None, []
    settings = settings.of_derivative

    def make_plan():
        return plan_render(scene, settings, runs=few_runs(scene, settings))

    # One program, whose direction is an argument, for all parameters.
    for direction, name in zip(np.eye(len(scalars), dtype=values.dtype), scalars, strict=True):

        def program(plan, direction=direction):
            *found, wanted = _along(values, jnp.asarray(direction), scene, scalars, settings, plan)
            return found, wanted

        # Remembered, so that the same derivatives of a scene with other numbers compile nothing.
        light, derivative = PLANS.run(program, scene_kind(scene, settings), make_plan, settings)
        image = light if image is None else image
        derivatives.append(np.asarray(derivative))
        if on_step:
            on_step(name)
    units = tuple(resolve(scene, name).attribute.unit for name in scalars)
    # By way of the host: one at a time there is room for more of them, and they lie on one device.
    return PictureDerivatives(jnp.asarray(np.asarray(image)), scalars, jnp.asarray(np.stack(derivatives)), units)


def finite_differences(
    scene: Scene,
    names: Iterable[str],
    settings: RenderSettings | None = None,
    step: float = 6e-3,
    samples: int = 16,
    on_step: Callable[[str], None] | None = None,
) -> Float[np.ndarray, "parameters 3 height width"]:
    """Difference quotients of point-sampled pictures, which include the motion of edges and need no derivative.

    They are central. Where a parameter's limits leave no room (an alpha of 1, a small radius) the step is halved up
    to four times, and at last taken to one side only.

    Args:
        scene, names: as for `picture_derivatives`.
        settings: as for `picture_derivatives`; its `edges`, `samples` and AOVs are not used.
        step: how far a parameter moves to either side, in its own unit. An edge has to cross several samples on the
            way, or the difference is noise.
        samples: the pictures have `samples` x `samples` rays a pixel, 1 to 64.
        on_step: called with a scalar parameter's name when its difference is there.

    Raises:
        ParameterError: as `picture_derivatives`; or a parameter cannot move by the step, or not visibly in its dtype.
        ValueError: the step is not a finite number above 0; `samples` is out of range; a crop outside of the picture.
    """
    # What to vary, and by pictures of many point samples: these see edges without a derivative.
    settings = resolve_settings(scene, settings)
    if not (np.isfinite(step) and step > 0):
        raise ValueError(f"step is {step}; it can be any number greater than 0")
    scene = with_film(scene, names := tuple(names))
    scalars = _expand(scene, names)
    settings = dataclasses.replace(settings, edges="point", samples=samples, aov=())
    # All ends before the first picture: a step that a parameter cannot take is refused before the work.
    ends = [_ends(scene, name, step) for name in scalars]
    differences = []
    for name, (ahead, behind) in zip(scalars, ends, strict=True):
        # Between the numbers as they are stored: in float32 they lie a little off `value + step`.
        width = float(get_parameter(ahead, name)) - float(get_parameter(behind, name))
        after, before = (np.asarray(render(end, settings).image) for end in (ahead, behind))
        differences.append((after - before) / after.dtype.type(width))
        if on_step:
            on_step(name)
    return np.stack(differences)


def relative_error(
    derivative: Float[ArrayLike, "3 height width"], reference: Float[ArrayLike, "3 height width"]
) -> float:
    """The L2 norm of `derivative - reference` in units of the reference's; 0 if they are equal, also if both are 0."""
    derivative, reference = np.asarray(derivative), np.asarray(reference, np.float64)
    error, size = float(np.linalg.norm(derivative - reference)), float(np.linalg.norm(reference))
    if error == 0:
        return 0.0
    return error / size if size > 0 else float("inf")


def correlation(derivative: Float[ArrayLike, "3 height width"], reference: Float[ArrayLike, "3 height width"]) -> float:
    """Pearson's correlation of two derivative pictures over pixels and channels; 0 if one of them is constant."""
    one, other = (values - values.mean() for values in (np.asarray(x, np.float64) for x in (derivative, reference)))
    size = float(np.linalg.norm(one) * np.linalg.norm(other))
    return float(np.sum(one * other)) / size if size > 0 else 0.0


@functools.partial(jit, static_argnames=("names", "settings", "plan"))
def _along(
    values: Float[Array, " parameters"],
    direction: Float[Array, " parameters"],
    scene: Scene,
    names: tuple[str, ...],
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[Float[Array, "3 height width"], Float[Array, "3 height width"], Wanted]:
    """The picture, its derivative along a direction in the space of the parameters, and the plan's ray counts."""

    def image(values):
        moved = set_parameters(scene, {name: values[k] for k, name in enumerate(names)})
        film, wanted = render_planned(moved, settings, plan)
        return film.image, wanted

    return jax.jvp(image, (values,), (direction,), has_aux=True)


def _expand(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    scalars = scalar_names(scene, names)
    if not scalars:
        raise ParameterError("a derivative needs the name of at least one parameter.")
    return scalars


def _ends(scene: Scene, name: str, step: float) -> tuple[Scene, Scene]:
    """Two scenes in which one parameter lies on either side of its value, or at it where a limit is near."""
    value = float(get_parameter(scene, name))
    for halvings in range(HALVINGS + 1):
        ahead, behind = (_moved(scene, name, value + sign * step / 2**halvings) for sign in (1, -1))
        if ahead is not None and behind is not None:
            break
    else:
        # At a limit: one side only, by the whole step.
        ahead, behind = (_moved(scene, name, value + sign * step) or scene for sign in (1, -1))
    if float(get_parameter(ahead, name)) == float(get_parameter(behind, name)):
        raise ParameterError(f"{quoted(name)}: {value:g} cannot move by a step of {step:g}; choose another step.")
    return ahead, behind


def _moved(scene: Scene, name: str, value: float) -> Scene | None:
    """The scene with another value of a parameter, None if that is beyond the parameter's limits."""
    try:
        return set_parameters(scene, {name: value})
    except ParameterError:
        return None
