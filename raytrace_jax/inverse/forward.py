"""The forward model: what was observed, the picture that a scene predicts, and the camera's response to its light."""

import dataclasses
import functools
import math
import warnings
from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.filters import bin_pixels, gaussian_blur
from raytrace_jax.inverse.unknowns import Image, Mask, Unknowns, Values, Vector, moved_scene
from raytrace_jax.scene.checks import is_gray
from raytrace_jax.scene.parameters import film_effects
from raytrace_jax.scene.response import Frame, develop, develop_compiled, linear_effects, without_idle
from raytrace_jax.scene.scene import CameraResponse, Scene, without_texels
from raytrace_jax.tracer.derivatives import develop_derivatives
from raytrace_jax.tracer.pixels import (
    PixelDerivatives,
    Pixels,
    pixel_colors,
    pixel_derivatives,
    prepare_colors,
    prepare_derivatives,
)
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.run import Points
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import is_masked, real_numbers


class Observation(eqx.Module):
    """The observation model `target = picture + bias + noise`, whose noise has the standard deviation sigma / sqrt(w).

    Args:
        target: scene-linear RGB; 0 where the weight is 0.
        bias: what the tracer's picture is known to lack of the mean over each pixel, 0 where nothing is known.
        root_weight: square root of each pixel's weight w in the sum of squares.
    """

    target: Float[Array, "3 height width"]
    bias: Float[Array, "3 height width"]
    root_weight: Float[Array, "height width"]

    def residual(self, image: Float[Array, "3 height width"]) -> Float[Array, "3 height width"]:
        """Picture and bias minus target, weighted."""
        return (image + self.bias - self.target) * self.root_weight

    def binned(self, binning: int) -> "Observation":
        """Squares of pixels averaged to one; a square with a pixel of weight 0 is left out."""
        # In numpy: each operation on arrays of a new size is a program to JAX.
        weight = np.asarray(self.root_weight) ** 2
        whole = bin_pixels((weight > 0).astype(weight.dtype), binning) == 1
        binned = np.where(whole, bin_pixels(weight, binning), 0)
        pictures = (bin_pixels(np.asarray(picture), binning) for picture in (self.target, self.bias))
        return Observation(*map(jnp.asarray, (*pictures, np.sqrt(binned))))

    @property
    def light_unit(self) -> float:
        """The power of two next to the root mean square of the target's light."""
        target, root = (np.asarray(part, np.float64) for part in (self.target, self.root_weight))
        return nearest_power(np.sqrt(np.mean(target[:, root > 0] ** 2)))

    @property
    def count(self) -> int:
        """The number of the target's colours that count: three for each pixel with a weight."""
        return 3 * int(np.sum(np.asarray(self.root_weight) > 0))


def nearest_power(size: float) -> float:
    """The power of two next to a size, on a logarithmic scale; 1 for 0."""
    return 2.0 ** round(math.log2(size)) if size > 0 else 1.0


def observe(target: object, weights: object, scene: Scene, settings: ResolvedSettings) -> Observation:
    """Check target and weights and bring them to the scene's dtype.

    Args:
        target: scene-linear RGB, top row first; NaN may stand where the weight is 0. A pixel of which `numpy.ma` masks
            a channel, here or in the weights, has the weight 0.
        weights: weight of each pixel, "height width" or "3 height width" (the channels' mean is taken), 0 or more;
            None is 1 everywhere.

    Raises:
        PictureError: no numbers, another size than the render, NaN, infinity, a constant target, or weights that are
            negative, or all zero.

    Warns:
        PictureWarning: the target's colours are hardly those of such a scene.
    """
    # The size, and what is to be fitted: finite, and not all of one colour.
    _, _, width, height = settings.window(scene.camera.pixeldim)
    picture = _numbers(target, "target")
    if picture.ndim != 3 or picture.shape[0] != 3:
        raise PictureError(f"the target has shape {picture.shape}; wanted (3, {height}, {width})")
    if picture.shape[1:] != (height, width):
        raise PictureError(
            f"the target is {picture.shape[2]} x {picture.shape[1]} pixels, the scene renders {width} x {height}; "
            "set the size to the target's, or crop"
        )
    hidden = np.any(is_masked(target), axis=0)
    weight = _checked_weights(np.ones(hidden.shape) if weights is None else weights, hidden)
    counts = weight > 0
    bad = int(np.sum(~np.isfinite(picture[:, counts])))
    if bad:
        raise PictureError(
            f"the target has {bad} values that are NaN or infinite; a fit needs finite ones, or a mask without them"
        )
    picture = np.where(counts, picture, 0)
    seen = picture[:, counts]
    if np.all(seen == seen[:, :1]):
        where = "" if counts.all() else ", as far as the mask shows it"
        raise PictureError(f"the target is one constant colour{where}; there is nothing in it to fit")
    for sentence in _oddities(seen, scene):
        warnings.warn(sentence, PictureWarning, stacklevel=2)

    # All that follows computes in the scene's precision.
    dtype = scene.camera.viewpoint.dtype
    target = jnp.asarray(picture, dtype)
    return Observation(target, jnp.zeros_like(target), jnp.asarray(np.sqrt(weight), dtype))


def _oddities(colours: np.ndarray, scene: Scene) -> list[str]:
    """Oddities of a target's colours, "3 pixels": a sentence for each oddity."""
    found = []
    most = float(np.max(colours))
    # White is not 1 where most colours are beyond twice that, or all are whole numbers. Colours beyond 16 bits are in a
    # scene's own unit of light.
    if 2.0 < most <= 65535 and (np.median(colours) > 2.0 or np.all(colours == np.round(colours))):
        found.append(f"the target's colours go up to {most:.4g}, where white is 1: divide what was stored as 0 to 255.")
    if not is_gray(scene) and np.all(colours == colours[:1]):
        found.append("the target is gray, and the scene has colours: each channel is compared with the same numbers.")
    return found


def _numbers(values: object, name: str) -> np.ndarray:
    try:
        return real_numbers(values)
    except ValueError as reason:
        raise PictureError(f"the {name} {reason}") from None


def _checked_weights(weights: object, hidden: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "height width"]:
    """The weights of all pixels, 0 for those that are hidden and for those of which a weight is masked."""
    weight, masked = _numbers(weights, "mask"), is_masked(weights)
    if weight.ndim == 3:
        weight, masked = weight.mean(axis=0), masked.any(axis=0)
    if weight.shape != hidden.shape:
        size, wanted = (" x ".join(map(str, shape[::-1])) for shape in (weight.shape, hidden.shape))
        raise PictureError(f"the mask is {size} pixels, the target {wanted}")
    weight = np.where(hidden | masked, 0.0, weight)
    bad = int(np.sum(~(np.isfinite(weight) & (weight >= 0))))
    if bad:
        raise PictureError(f"the mask has {bad} values that are negative, NaN or infinite; weights are 0 or more")
    if not np.any(weight > 0):
        raise PictureError("the mask is 0 everywhere; there is nothing left to fit")
    return weight


class PredictedPicture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Outcome.sees_edge`; else None.
    """

    image: Float[Array, "3 height width"]
    jacobian: Float[Array, "parameters 3 height width"]
    sees_edge: Mask | None = None


@runtime_checkable
class ForwardModel(Protocol):
    """Computes what pixels show of a scene's light, before the film."""

    def differentiate(
        self, y: Float[Array, " light"], scene: Scene, pixels: Pixels, unknowns: Unknowns, settings: ResolvedSettings
    ) -> PixelDerivatives:
        """Colours of pixels and their derivatives by the unknowns `y`; see `pixel_derivatives`."""
        ...

    def prepare_differentiate(
        self, y: Float[Array, " light"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings
    ) -> None:
        """Compile what `differentiate` will run, and run nothing."""
        ...

    def points(
        self, scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> Float[np.ndarray, "scenes 3 points"]:
        """Colours at points of the pictures of several scenes; see `pixel_colors`."""
        ...

    def prepare_points(
        self, scene: Scene, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
    ) -> None:
        """Compile what `points` will run, and run nothing."""
        ...


class Tracer:
    """The forward model of all scenes that are traced."""

    differentiate = staticmethod(pixel_derivatives)
    prepare_differentiate = staticmethod(prepare_derivatives)
    points = staticmethod(pixel_colors)
    prepare_points = staticmethod(prepare_colors)


@functools.singledispatch
def forward_model(scene: Scene) -> ForwardModel:
    """The forward model for a scene's type; the tracer, unless another one was registered."""
    return Tracer()


@dataclasses.dataclass(frozen=True)
class Development:
    """The film of a fitted scene."""

    scene: Scene
    unknowns: Unknowns

    @functools.cached_property
    def free_effects(self) -> dict[str, str]:
        """The film's effect of each of its free numbers."""
        return film_effects(self.scene, self.unknowns.of_film)

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

    def linear_indices(self, known: Values) -> tuple[int, ...]:
        """The places of the film's unknowns in which the picture is linear and that have no prior."""
        linear, free = linear_effects(self.of_scene.film), self.free_effects
        return tuple(k for k, name in enumerate(self.unknowns.names) if free.get(name) in linear and not known[k] > 0)

    def film(self, values: Values) -> CameraResponse | None:
        """The film with these values of the free parameters, with None for effects that do nothing."""
        return moved_scene(self.of_scene, self._array(values), self.unknowns).film if self.is_needed else None

    def image(self, light: Image, values: Values, frame: Frame) -> Image:
        """The developed picture."""
        film = self.film(values)
        return light if film is None else np.asarray(develop_compiled(self._array(light), film, frame))

    def picture(self, light: PredictedPicture, y: Vector, frame: Frame) -> PredictedPicture:
        """The developed picture at the unknowns `y`, with the derivatives by all of them."""
        if not self.is_needed:
            return light
        jacobian = np.zeros((len(self.unknowns.names), *light.image.shape), light.image.dtype)
        jacobian[list(self.unknowns.traced)] = light.jacobian
        developed = develop_derivatives(light.image, jacobian, self._array(y), self.of_scene, self.unknowns, frame)
        return PredictedPicture(developed[0], developed[1], light.sees_edge)

    def changes(
        self, light: Image, changes: Float[np.ndarray, "changes 3 height width"], values: Values, frame: Frame
    ) -> Float[np.ndarray, "changes 3 height width"]:
        """Changes of the developed picture with small changes of the picture of the light."""
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
        blur: standard deviation of a blur, in pixels, with which they are compared.
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
    """Changes of the developed picture with small changes of the light's, one after the other."""
    _, push = jax.linearize(lambda image: develop(image, film, frame), image)
    return jax.lax.map(push, changes)
