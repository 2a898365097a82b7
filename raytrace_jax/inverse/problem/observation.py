"""What is known before a fit: the target, how much each of its pixels counts, its noise, and priors."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from raytrace_jax.errors import ParameterError, PictureError
from raytrace_jax.inverse.problem.blur import bin_pixels
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.settings import RenderSettings

Priors = dict[str, tuple[float, float]]
"""Mean and standard deviation by name of a free scalar parameter."""


class Observation(eqx.Module):
    """A target picture and its weights.

    Args:
        target: scene-linear RGB; 0 where the weight is 0.
        root_weight: square root of each pixel's weight in the sum of squares; the noise of a pixel of weight w has the
            standard deviation sigma / sqrt(w).
    """

    target: Float[Array, "3 height width"]
    root_weight: Float[Array, "height width"]

    def binned(self, binning: int) -> "Observation":
        """Squares of pixels averaged to one; a square with a pixel of weight 0 is left out."""
        weight = self.root_weight**2
        whole = bin_pixels((weight > 0).astype(weight.dtype), binning) == 1
        return Observation(
            bin_pixels(self.target, binning), jnp.sqrt(jnp.where(whole, bin_pixels(weight, binning), 0.0))
        )

    @property
    def count(self) -> int:
        """How many numbers of the target count: three for each pixel with a weight."""
        return 3 * int(np.sum(np.asarray(self.root_weight) > 0))


class Prior(eqx.Module):
    """Independent Gaussian priors on the values of the free parameters.

    Args:
        mean: of each parameter.
        precision: one over the standard deviation; 0 where there is no prior.
    """

    mean: Float[Array, " parameters"]
    precision: Float[Array, " parameters"]


def observe(target: ArrayLike, weights: ArrayLike | None, scene: Scene, settings: RenderSettings) -> Observation:
    """Check target and weights and bring them to the scene's dtype.

    Args:
        target: scene-linear RGB, top row first; NaN may stand where the weight is 0.
        weights: weight of each pixel, "height width" or "3 height width" (the channels' mean is taken), 0 or more;
            None is 1 everywhere.
        scene, settings: what will be rendered.

    Raises:
        PictureError: another size than the render, NaN, infinity, a constant target, or weights that are negative,
            or all zero.
    """
    _, _, width, height = settings.window(scene.camera.pixeldim)
    picture = np.asarray(target)
    if picture.ndim != 3 or picture.shape[0] != 3:
        raise PictureError(f"the target has shape {picture.shape}; wanted (3, {height}, {width})")
    if picture.shape[1:] != (height, width):
        raise PictureError(
            f"the target is {picture.shape[2]} x {picture.shape[1]} pixels, the scene renders {width} x {height}; "
            "set the size to the target's, or crop"
        )
    weight = np.ones((height, width)) if weights is None else _checked_weights(np.asarray(weights), (height, width))
    counts = weight > 0
    bad = int(np.sum(~np.isfinite(picture[:, counts])))
    if bad:
        raise PictureError(
            f"the target has {bad} values that are NaN or infinite; a fit needs finite ones, or a mask without them"
        )
    picture = np.where(counts, picture, 0)
    seen = picture[:, counts]
    if np.all(seen == seen[:, :1]):
        where = "" if weights is None else ", as far as the mask shows it"
        raise PictureError(f"the target is one constant colour{where}; there is nothing in it to fit")
    dtype = scene.camera.viewpoint.dtype
    return Observation(jnp.asarray(picture, dtype), jnp.asarray(np.sqrt(weight), dtype))


def _checked_weights(weight: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    weight = weight.mean(0) if weight.ndim == 3 else weight
    if weight.shape != size:
        found = " x ".join(map(str, weight.shape[::-1]))
        raise PictureError(f"the mask is {found} pixels, the target {size[1]} x {size[0]}")
    bad = int(np.sum(~(np.isfinite(weight) & (weight >= 0))))
    if bad:
        raise PictureError(f"the mask has {bad} values that are negative, NaN or infinite; weights are 0 or more")
    if not np.any(weight > 0):
        raise PictureError("the mask is 0 everywhere; there is nothing left to fit")
    return weight


def make_prior(priors: Priors, unknowns: Unknowns, dtype: jnp.dtype) -> Prior:
    """The priors, by names of `unknowns`, as arrays.

    Raises:
        ParameterError: a mean or standard deviation that makes no sense.
    """
    mean, precision = np.zeros((2, len(unknowns.names)))
    for name, (middle, deviation) in priors.items():
        if not np.isfinite(middle) or not (np.isfinite(deviation) and deviation > 0):
            raise ParameterError(
                f"prior on {name}: {middle:g}+-{deviation:g}; wanted a finite mean and a standard deviation above 0."
            )
        place = unknowns.names.index(name)
        mean[place], precision[place] = middle, 1 / deviation
    return Prior(jnp.asarray(mean, dtype), jnp.asarray(precision, dtype))
