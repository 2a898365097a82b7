"""A picture from a scene, and its derivatives, for concrete scenes and under every transformation of JAX."""

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import ParameterError
from ..scene.checks import check_values
from ..scene.parameters import resolve, response_effects, row_of_names, scalar_names, set_parameters, with_response
from ..scene.response import apply_response, apply_response_compiled, without_idle
from ..scene.scene import Scene, without_texels
from ..util.compilation import jit
from ..util.numerics import instantiated, is_traced, is_zero, on_device, with_lower_ranks
from .film import Film, Image
from .pixels import (
    Jacobian,
    Parameters,
    SceneFunction,
    not_differentiable,
    radiance_derivatives,
    refuse_too_large,
    render_radiance,
    response_derivatives,
)
from .settings import RenderSettings, ResolvedSettings, resolve_settings


def render(scene: Scene, settings: RenderSettings | None = None) -> Film:
    """Render a scene; `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap` may be around it.

    The gradient by a scene is a scene::

        loss = lambda scene: ((render(scene, settings).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points (or the mean of `samples` x `samples`
    of them), and their derivative is that of their areas: it contains what a pixel gains or loses as an edge moves
    across it, and is paid for only where it is asked for. `edges="point"` has the derivative of the points, which lacks
    that; `edges="aware"` has the values of areas as well. Second derivatives (`jax.hessian`) are those of points, with
    `edges="point"`; those of areas are refused.

    Args:
        scene: its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render. None is what the scene's file says. Of concrete scenes no size or crop compiles the
            tracer anew, nor does a number of point samples; the effects of a film are compiled for each size.

    Returns:
        The film: `film.image` and the AOVs that were asked for.

    Raises:
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have; of a traced scene
            nobody knows.
        PictureError: there is no memory for such a picture.
        RuntimeError, ValueError: as JAX raises an error of a running program: a transformed picture wants more rays
            than `rays_per_pixel` of the settings. The message, within that of JAX, says what to state. Without a
            transformation there is room for all.
    """
    settings = resolve_settings(scene, settings)
    refuse_too_large(scene, settings)
    if is_traced(scene):
        return pure_picture(scene.alone(), settings)
    check_values(scene)
    scene = scene.alone()  # What no picture shows is no argument of its programs.
    radiance = render_radiance(scene, settings.with_edges("point"))
    if scene.film is None:
        return radiance
    # No effect of the response that does nothing is computed.
    frame = settings.frame(scene.camera.pixeldim)
    return dataclasses.replace(radiance, image=apply_response_compiled(radiance.image, without_idle(scene.film), frame))


class PictureDerivatives(NamedTuple):
    """A picture and its derivatives.

    Args:
        values: for each of them the change of the picture per unit of the parameter, signed.
        units: what one of each of them is, for people.
    """

    image: Image
    names: tuple[str, ...]
    values: Jacobian
    units: tuple[str, ...] = ()


def picture_derivatives(
    scene: Scene, names: Iterable[str], settings: RenderSettings | None = None
) -> PictureDerivatives:
    """Render a picture and differentiate each of its pixels with respect to parameters, in forward mode.

    Args:
        scene: the scene, with concrete values; its dtype is that of the pictures.
        names: the parameters; a vector such as `vitreous.center` stands for its numbers.
        settings: what to render, without its AOVs; None is what the scene's file says. Without `edges` the picture is
            that of points and the derivative that of areas; with `edges="point"` it is that of the colours at the
            pixels' points: what edges that move gain or lose is not in it.

    Returns:
        The picture, and for each number the change of the picture per unit of it: 0 for those of further views.

    Raises:
        ParameterError: no names, an unknown one, or two for one number.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such pictures.
    """
    settings = resolve_settings(scene, settings)
    scene = with_response(scene, names := row_of_names(names))
    scalars = differentiated_names(scene, names)
    check_values(scene)
    settings = dataclasses.replace(settings, aov=())
    refuse_too_large(scene, settings, len(scalars))
    units = tuple(resolve(scene, name).attribute.unit for name in scalars)
    here = [place for place, name in enumerate(scalars) if not resolve(scene, name).address.is_elsewhere]
    image, seen = _derivatives_here(scene.alone(), tuple(scalars[place] for place in here), settings)
    jacobian = np.zeros((len(scalars), *image.shape), image.dtype)
    jacobian[here] = seen
    image, jacobian = jax.device_put((image, jacobian))
    return PictureDerivatives(image, scalars, jacobian, units)


def _derivatives_here(scene: Scene, scalars: tuple[str, ...], settings: ResolvedSettings) -> tuple[Any, Any]:
    """The picture of a scene without further views, and its derivatives by single numbers."""
    of_film = response_effects(scene, scalars)
    values = np.array([resolve(scene, name).address.read(scene) for name in scalars], scene.camera.viewpoint.dtype)

    # Radiance, by the numbers that move what is traced; then what the camera's response makes of it, by all.
    traced = tuple(place for place, name in enumerate(scalars) if name not in of_film)
    unknowns = Named(tuple(scalars[place] for place in traced))
    unfilmed = dataclasses.replace(scene, film=None)
    image, jacobian, _ = radiance_derivatives(on_device(values[np.array(traced, int)]), unfilmed, unknowns, settings)
    if scene.film is not None:
        # Effects of the response that do nothing and are not differentiated are not computed.
        filmed = dataclasses.replace(without_texels(scene), film=without_idle(scene.film, of_film.values()))
        by_all = np.zeros((len(scalars), *image.shape), image.dtype)
        by_all[list(traced)] = jacobian
        frame = settings.frame(scene.camera.pixeldim)
        image, jacobian = response_derivatives(image, by_all, on_device(values), filmed, Named(scalars), frame)
    return image, jacobian


@dataclasses.dataclass(frozen=True)
class Named:
    """Scalar parameters as the unknowns of `pixel_derivatives`: each is its own value."""

    names: tuple[str, ...]

    def moved(self, scene: Scene, y: Parameters) -> Scene:
        return set_parameters(scene, {name: y[k] for k, name in enumerate(self.names)})


def differentiated_names(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    """The numbers that names stand for. Raises ParameterError of no names, an unknown one, or two for one number."""
    scalars = scalar_names(scene, names)
    if not scalars:
        raise ParameterError("a derivative needs the name of at least one parameter.")
    return scalars


@functools.partial(jit, static_argnames="settings")
def pure_picture(scene: Scene, settings: ResolvedSettings) -> Film:
    """The picture; without `edges` it is that of points, and its derivative that of areas."""
    image, aov, overflow = pure_radiance(dataclasses.replace(scene, film=None), settings)
    image = apply_response(image, scene.film, settings.frame(scene.camera.pixeldim))
    return Film(image, aov, overflow)


@functools.partial(jax.custom_jvp, nondiff_argnums=(1, 2))
@with_lower_ranks
def pure_radiance(scene: Scene, settings: ResolvedSettings, reversible: bool = False) -> tuple[Image, Any, Any]:
    """The fields of a film of radiance: at the pixels' points, or by areas if the settings say so.

    A point's colour jumps where an edge crosses it, so that its derivative lacks what edges sweep. The mean over an
    area changes by that too, and edge-aware tracing knows how. Only who differentiates pays for it.
    """
    film = render_radiance(scene, settings.with_edges("point"), reversible)
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
        points, moved = jax.jvp(traced(settings.with_edges("point")), primals, tangents)
    else:
        points, moved = pure_radiance(*primals, settings), (None, {}, None)
    areas, by_areas = jax.jvp(traced(dataclasses.replace(settings.with_edges("aware"), aov=())), fixed, tangents)
    return (*points[:2], points[2] + areas[2]), (by_areas[0], moved[1], by_areas[2])


@functools.partial(jax.custom_jvp, nondiff_argnums=(2, 3))
def picture_at(y: Parameters, scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings) -> Image:
    """The picture of a scene at the numbers `y`.

    Each derivative that a transformation takes by itself would be another copy of the tracer in its program. All
    derivatives by `y` are products with one Jacobian, which rides along with the picture in forward mode.
    """
    return pure_picture(unknowns.moved(scene.alone(), y), settings).image


def _picture_at_jvp(unknowns: SceneFunction, settings: ResolvedSettings, primals, tangents):
    if is_zero(tangents[0]) or not is_zero(tangents[1]):
        # The scene's own numbers change too.
        plain = functools.partial(picture_at.fun, unknowns=unknowns, settings=settings)
        return jax.jvp(plain, primals, instantiated(tangents))
    y, scene = primals
    image, jacobian = picture_jacobian(y, scene.alone(), unknowns, settings)
    return image, jnp.tensordot(tangents[0], jacobian, 1)


picture_at.defjvp(_picture_at_jvp, symbolic_zeros=True)


@functools.partial(jit, static_argnames=("unknowns", "settings"))
def picture_jacobian(
    y: Parameters, scene: Scene, unknowns: SceneFunction, settings: ResolvedSettings
) -> tuple[Image, Jacobian]:
    """The picture at `y` and its derivatives; those of points can be differentiated again."""
    is_point = settings.edges == "point"
    fixed = (y, scene) if is_point else not_differentiable((y, scene))
    image, jacobian, _ = radiance_derivatives(fixed[0], fixed[1], unknowns, settings, is_point)
    if scene.film is not None:
        frame = settings.frame(scene.camera.pixeldim)
        image, jacobian = response_derivatives(image, jacobian, y, without_texels(scene), unknowns, frame)
    return image, jacobian
