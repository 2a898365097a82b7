"""The prediction: the picture of a scene by the tracer, and the camera's response to its radiance."""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from ...images.filters import gaussian_blur
from ...scene.parameters import response_effects
from ...scene.response import Frame, apply_response, apply_response_compiled, light_reach, linear_effects, without_idle
from ...scene.scene import CameraResponse, Scene, without_texels
from ...tracer.pixels import (
    PixelDerivatives,
    pixel_colors,
    pixel_derivatives,
    response_derivatives,
)
from ...util.compilation import jit
from .observation import Observation
from .unknowns import Image, Mask, Picture, Scalar, Unknowns, Values, Vector, moved_scene


class PredictedPicture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Outcome.sees_edge`; else None.
    """

    image: Picture
    jacobian: Float[Array, "parameters 3 height width"]
    sees_edge: Mask | None = None


class ForwardModel(NamedTuple):
    """The programs that compute what pixels show of a scene's radiance, before the camera's response.

    Args:
        differentiate: colours of pixels and their derivatives by the traced unknowns.
        points: colours at points of the pictures of several scenes.
    """

    differentiate: Callable[..., PixelDerivatives] = pixel_derivatives
    points: Callable[..., Float[np.ndarray, "scenes 3 points"]] = pixel_colors


@functools.singledispatch
def forward_model(scene: Scene) -> ForwardModel:
    """The forward model for a scene's type; the tracer, unless another one was registered."""
    return ForwardModel()


@dataclasses.dataclass(frozen=True)
class CameraModel:
    """The camera's response to the radiance of a fitted scene.

    Args:
        known: the parameters that have a prior.
    """

    scene: Scene
    unknowns: Unknowns
    known: Bool[np.ndarray, " parameters"]

    @functools.cached_property
    def free_effects(self) -> dict[str, str]:
        """The film's effect of each of its free numbers."""
        return response_effects(self.scene, self.unknowns.of_film)

    @functools.cached_property
    def of_scene(self) -> Scene:
        """The scene without texels, and with only those effects of its film that do something or have a free number."""
        film = self.scene.film
        if film is not None:
            film = without_idle(film, self.free_effects.values())
        return without_texels(dataclasses.replace(self.scene, film=film))

    @property
    def is_needed(self) -> bool:
        """Whether the scene has a film."""
        return self.scene.film is not None

    @property
    def linear_indices(self) -> tuple[int, ...]:
        """The places of the film's unknowns in which the picture is linear and that have no prior."""
        linear, free = linear_effects(self.of_scene.film), self.free_effects
        return tuple(k for k, name in enumerate(self.unknowns.names) if free.get(name) in linear and not self.known[k])

    def film(self, values: Values) -> CameraResponse | None:
        """The film with these values of the free parameters, with None for effects that do nothing."""
        return moved_scene(self.of_scene, self._array(values), self.unknowns).film if self.is_needed else None

    def reach(self, values: Values) -> float:
        """The distance in pixels from which the light of a pixel may come; 0 if all of it is its own."""
        return light_reach(self.film(values))

    def image(self, light: Image, values: Values, frame: Frame) -> Image:
        """The picture after the camera's response."""
        film = self.film(values)
        return light if film is None else np.asarray(apply_response_compiled(self._array(light), film, frame))

    def picture(self, light: PredictedPicture, y: Vector, frame: Frame) -> PredictedPicture:
        """The picture after the camera's response at the unknowns `y`, with the derivatives by all of them."""
        if not (self.is_needed or self.unknowns.unseen):
            return light
        jacobian = np.zeros((len(self.unknowns.names), *light.image.shape), light.image.dtype)
        jacobian[self.unknowns.traced] = light.jacobian
        if not self.is_needed:
            return PredictedPicture(light.image, self._array(jacobian), light.sees_edge)
        developed = response_derivatives(light.image, jacobian, self._array(y), self.of_scene, self.unknowns, frame)
        return PredictedPicture(developed[0], developed[1], light.sees_edge)

    def changes(
        self, light: Image, changes: Float[np.ndarray, "changes 3 height width"], values: Values, frame: Frame
    ) -> Float[np.ndarray, "changes 3 height width"]:
        """Changes of the picture after the camera's response with small changes of the picture of the light."""
        film = self.film(values)
        if film is None:
            return changes
        return np.asarray(response_changes(self._array(light), self._array(changes), film, frame))

    def _array(self, values: ArrayLike) -> Array:
        return jnp.asarray(np.asarray(values), self.scene.camera.viewpoint.dtype)


@functools.partial(jit, static_argnames=("unknowns", "frame", "linear"))
def best_response(
    rows: Float[Array, "pictures parameters"],
    lights: Float[Array, "pictures 3 height width"],
    scene: Scene,
    observation: Observation,
    blur: Scalar,
    unknowns: Unknowns,
    frame: Frame,
    linear: tuple[int, ...],
) -> tuple[Float[Array, "pictures parameters"], Float[Array, "pictures 3 height width"]]:
    """Values that bring each picture nearest to the target, and the pictures.

    Only values in which the picture is linear change: least squares gives their best ones in closed form.

    Args:
        blur: standard deviation of a blur, in pixels, with which they are compared.
    """
    places = np.array(linear, int)

    def best(row, light):
        def developed(numbers):
            film = unknowns.scene(scene, row.at[places].set(numbers)).film
            return apply_response(light, film, frame)

        def residual(numbers):
            return gaussian_blur(observation.residual(developed(numbers)), blur).reshape(-1)

        # One step from anywhere is the solution of a linear problem.
        numbers = row[places]
        if linear:
            jacobian = jax.jacfwd(residual)(numbers)
            normal, right = jacobian.T @ jacobian, jacobian.T @ residual(numbers)
            # What a picture leaves open, such as the gain of a black one, stays.
            length = jnp.sqrt(jnp.diagonal(normal))
            length = jnp.where(length > 0, length, 1)
            # In columns of length one a smaller eigenvalue than a millionth of the largest is rounding.
            step = jnp.linalg.pinv(normal / jnp.outer(length, length), rtol=1e-6) @ (right / length) / length
            # A picture that would have to be turned into its negative is compared as it is.
            least, most = jnp.asarray(unknowns.limits, row.dtype)[:, places]
            moved = numbers - step
            numbers = jnp.where(jnp.all((moved > least) & (moved < most)), moved, numbers)
        return row.at[places].set(numbers), developed(numbers)

    return jax.vmap(best)(rows, lights)


@functools.partial(jit, static_argnames="frame")
def response_changes(
    image: Picture,
    changes: Float[Array, "changes 3 height width"],
    film: CameraResponse,
    frame: Frame,
) -> Float[Array, "changes 3 height width"]:
    """Changes of the picture after the camera's response with small changes of the light's, one after the other."""
    _, push = jax.linearize(lambda image: apply_response(image, film, frame), image)
    return jax.lax.map(push, changes)
