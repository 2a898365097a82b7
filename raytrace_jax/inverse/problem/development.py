"""What the film of a fitted scene makes of pictures of its light, and the derivatives by its numbers, without a ray.

The light is traced, with the derivatives by the numbers that it depends on, in `tracer.pixels`.
"""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from raytrace_jax.images.filters import gaussian_blur
from raytrace_jax.inverse.problem.forward_model import Picture
from raytrace_jax.inverse.problem.observation import Observation
from raytrace_jax.inverse.problem.unknowns import Unknowns, moved_scene
from raytrace_jax.scene.parameters import resolve
from raytrace_jax.scene.response import FILM, Frame, develop, develop_compiled, linear_effects, reach, without_idle
from raytrace_jax.scene.scene import CameraResponse, Scene, without_texels
from raytrace_jax.tracer.derivatives import develop_derivatives
from raytrace_jax.util.compilation import jit


@dataclasses.dataclass(frozen=True)
class Development:
    """The film of a fitted scene.

    Args:
        scene: gives the film, or has none: then pictures stay as they are.
        unknowns: what is free.
    """

    scene: Scene
    unknowns: Unknowns

    @functools.cached_property
    def of_scene(self) -> Scene:
        """The scene without texels, and with only those effects of its film that do something or have a free number."""
        film = self.scene.film
        if film is not None:
            free = (resolve(self.scene, name).address for name in self.unknowns.names)
            film = without_idle(film, {one.field for one in free if one.group == FILM})
        return without_texels(dataclasses.replace(self.scene, film=film))

    @property
    def is_needed(self) -> bool:
        """Whether the scene has a film."""
        return self.scene.film is not None

    def linear_places(self, known: Float[np.ndarray, " parameters"]) -> tuple[int, ...]:
        """The places of the film's unknowns in which the picture is linear and that have no prior.

        Args:
            known: the precision of each unknown's prior; 0 is none.
        """
        linear = linear_effects(self.of_scene.film)
        fields = [resolve(self.scene, name).address for name in self.unknowns.names]
        return tuple(
            k for k, one in enumerate(fields) if one.group == FILM and one.field in linear and not known[k] > 0
        )

    def film(self, values: Float[np.ndarray, " parameters"]) -> CameraResponse | None:
        """The film with these values of the free parameters, with None for effects that do nothing."""
        return moved_scene(self.of_scene, self._array(values), self.unknowns).film if self.is_needed else None

    def reach(self, values: Float[np.ndarray, " parameters"], frame: Frame) -> float:
        """How far away from a pixel its light may come, in pixels; 0 if it is the pixel's own."""
        return reach(self.film(values), frame)

    def image(
        self, light: Float[np.ndarray, "3 height width"], values: Float[np.ndarray, " parameters"], frame: Frame
    ) -> Float[np.ndarray, "3 height width"]:
        """What the film makes of a picture."""
        film = self.film(values)
        return light if film is None else np.asarray(develop_compiled(self._array(light), film, frame))

    def picture(self, light: Picture, y: Float[Array, " parameters"], frame: Frame) -> Picture:
        """What the film makes of a picture at the unknowns `y`, with the derivatives by all of them.

        Args:
            light: the light's picture, with the derivatives by the unknowns that are not the film's.
            y: all unknowns.
            frame: which part of the whole picture it is.
        """
        if not self.is_needed:
            return light
        columns = np.zeros((len(self.unknowns.names), *light.image.shape), light.image.dtype)
        columns[list(self.unknowns.light_places)] = light.columns
        developed = develop_derivatives(light.image, columns, self._array(y), self.of_scene, self.unknowns, frame)
        return Picture(developed[0], developed[1], light.sees_edge)

    def changes(
        self,
        light: Float[np.ndarray, "3 height width"],
        changes: Float[np.ndarray, "changes 3 height width"],
        values: Float[np.ndarray, " parameters"],
        frame: Frame,
    ) -> Float[np.ndarray, "changes 3 height width"]:
        """How much the developed picture changes with small changes of the picture of the light."""
        film = self.film(values)
        if film is None:
            return changes
        return np.asarray(develop_changes(self._array(light), self._array(changes), film, frame))

    def _array(self, values: ArrayLike) -> Array:
        return jnp.asarray(np.asarray(values), self.scene.camera.viewpoint.dtype)


@functools.partial(jit, static_argnames=("unknowns", "frame", "linear"))
def develop_best(
    rows: Float[Array, "pictures parameters"],
    lights: Float[Array, "pictures 3 height width"],
    scene: Scene,
    observation: Observation,
    blur: Float[Array, ""],
    unknowns: Unknowns,
    frame: Frame,
    linear: tuple[int, ...],
) -> tuple[Float[Array, "pictures parameters"], Float[Array, "pictures 3 height width"]]:
    """Values that bring each picture nearest to the target, and the pictures.

    Only values in which the picture is linear change: least squares gives their best ones in closed form.

    Args:
        rows, lights: values of the free parameters and the picture of the light, for each.
        scene, unknowns, frame: as for `develop_derivatives`.
        observation: the target and its weights.
        blur: standard deviation of a blur, in pixels, with which they are compared.
        linear: the places of the numbers that may change.
    """
    places = np.array(linear, int)

    def best(row, light):
        def developed(numbers):
            film = unknowns.scene(scene, row.at[places].set(numbers)).film
            return develop(light, film, frame)

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
def develop_changes(
    image: Float[Array, "3 height width"],
    changes: Float[Array, "changes 3 height width"],
    film: CameraResponse,
    frame: Frame,
) -> Float[Array, "changes 3 height width"]:
    """How much the developed picture changes with small changes of the light's picture, one after the other."""
    _, push = jax.linearize(lambda image: develop(image, film, frame), image)
    return jax.lax.map(push, changes)
