"""The picture as a part of a caller's program, and the rules of its derivatives."""

import dataclasses
import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..scene.response import develop
from ..scene.scene import Scene, without_texels
from ..util.compilation import jit
from ..util.numerics import instantiated, is_zero, with_lower_ranks
from .batches import in_one_call
from .film import Film, Image
from .pixels import SceneFunction
from .radiance import (
    Jacobian,
    develop_derivatives,
    not_differentiable,
    radiance_derivatives,
    render_radiance,
)
from .resolved_settings import ResolvedSettings


@functools.partial(jit, static_argnames="settings")
def pure_picture(scene: Scene, settings: ResolvedSettings) -> Film:
    """The picture; without `edges` it is that of points, and its derivative that of areas."""
    image, aov, overflow = pure_radiance(dataclasses.replace(scene, film=None), settings)
    image = develop(image, scene.film, settings.frame(scene.camera.pixeldim))
    return Film(image, aov, overflow)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1, 2))
@with_lower_ranks
def pure_radiance(scene: Scene, settings: ResolvedSettings, reversible: bool = False) -> tuple[Image, Any, Any]:
    """The fields of a film of radiance: at the pixels' points, or by areas if the settings say so.

    A point's colour jumps where an edge crosses it, so that its derivative lacks what edges sweep. The mean over an
    area changes by that too, and edge-aware tracing knows how. Only who differentiates pays for it.
    """
    film = render_radiance(scene, settings.of_points, in_one_call, reversible)
    return film.image, film.aov, film.overflow


@pure_radiance.defjvp
@with_lower_ranks
def _pure_radiance_jvp(settings: ResolvedSettings, _, primals, tangents):
    def traced(settings: ResolvedSettings):
        return functools.partial(pure_radiance.fun, settings=settings, reversible=True)

    # The slopes of edges and the spreads of footprints are constants to the first derivative of areas; a second one
    # would lack what they change.
    fixed = primals if settings.edges == "point" else not_differentiable(primals)
    if settings.edges:
        return jax.jvp(traced(settings), fixed, tangents)
    # AOVs have no area: their derivative is that of points.
    if settings.aov:
        points, moved = jax.jvp(traced(settings.of_points), primals, tangents)
    else:
        points, moved = pure_radiance(*primals, settings), (None, {}, None)
    areas, by_areas = jax.jvp(traced(dataclasses.replace(settings.of_derivative, aov=())), fixed, tangents)
    return (*points[:2], points[2] + areas[2]), (by_areas[0], moved[1], by_areas[2])


@functools.partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def picture_at(
    y: Float[Array, " parameters"], scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings
) -> Image:
    """The picture of a scene at the numbers `y`.

    Each derivative that a transformation takes by itself would be another copy of the tracer in its program. All
    derivatives by `y` are products with one Jacobian, which rides along with the picture in forward mode.
    """
    return pure_picture(unknowns.moved(scene, y), settings).image


def _picture_at_jvp(unknowns: SceneFunction, settings: ResolvedSettings, primals, tangents):
    if is_zero(tangents[0]) or not is_zero(tangents[1]):
        # The scene's own numbers change too.
        plain = functools.partial(picture_at.fun, unknowns=unknowns, settings=settings)
        return jax.jvp(plain, primals, instantiated(tangents))
    image, jacobian = picture_jacobian(*primals, unknowns, settings)
    return image, jnp.tensordot(tangents[0], jacobian, 1)


picture_at.defjvp(_picture_at_jvp, symbolic_zeros=True)


@functools.partial(jit, static_argnames=("unknowns", "settings"))
def picture_jacobian(
    y: Float[Array, " parameters"], scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings
) -> tuple[Image, Jacobian]:
    """The picture at `y` and its derivatives; those of points can be differentiated again."""
    is_point = settings.edges == "point"
    fixed = (y, scene) if is_point else not_differentiable((y, scene))
    image, jacobian, _ = radiance_derivatives(fixed[0], fixed[1], unknowns, settings, in_one_call, is_point)
    if scene.film is not None:
        frame = settings.frame(scene.camera.pixeldim)
        image, jacobian = develop_derivatives(image, jacobian, y, without_texels(scene), unknowns, frame)
    return image, jacobian
