"""Derivatives of each pixel of a picture by some parameters."""

import dataclasses
from collections.abc import Iterable
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from ..errors import ParameterError
from ..scene.checks import check_values
from ..scene.parameters import (
    film_effects,
    resolve,
    row_of_names,
    scalar_names,
    set_parameters,
    with_film,
)
from ..scene.response import without_idle
from ..scene.scene import Scene, without_texels
from ..util.numerics import on_device
from .film import Image
from .radiance import Jacobian, develop_derivatives, radiance_derivatives, refuse_too_large
from .resolved_settings import resolve_settings
from .settings import RenderSettings


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
        The picture, and for each number the change of the picture per unit of it.

    Raises:
        ParameterError: no names, an unknown one, or two for one number.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such pictures.
    """
    settings = resolve_settings(scene, settings)
    scene = with_film(scene, names := row_of_names(names))
    scalars = differentiated_names(scene, names)
    check_values(scene)
    settings = dataclasses.replace(settings, aov=())
    refuse_too_large(scene, settings, len(scalars))
    of_film = film_effects(scene, scalars)
    values = np.stack([resolve(scene, name).address.read(scene) for name in scalars])

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
        image, jacobian = develop_derivatives(image, by_all, on_device(values), filmed, Named(scalars), frame)
    units = tuple(resolve(scene, name).attribute.unit for name in scalars)
    image, jacobian = jax.device_put((image, jacobian))
    return PictureDerivatives(image, scalars, jacobian, units)


@dataclasses.dataclass(frozen=True)
class Named:
    """Scalar parameters as the unknowns of `pixel_derivatives`: each is its own value."""

    names: tuple[str, ...]

    def moved(self, scene: Scene, y: Float[Array, " parameters"]) -> Scene:
        return set_parameters(scene, {name: y[k] for k, name in enumerate(self.names)})


def differentiated_names(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    """The numbers that names stand for. Raises ParameterError of no names, an unknown one, or two for one number."""
    scalars = scalar_names(scene, names)
    if not scalars:
        raise ParameterError("a derivative needs the name of at least one parameter.")
    return scalars
