"""The observation: a target, the weight of its colours, and what the tracer's picture is known to lack of it."""

import dataclasses
import math
import warnings

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from ...errors import PictureError, RaytraceWarning
from ...images.filters import bin_pixels
from ...scene.checks import is_gray
from ...scene.scene import Scene
from ...tracer.settings import ResolvedSettings
from ...util.numerics import is_masked, on_device, on_host, real_numbers
from .unknowns import AnyArray, Image, Mask, Picture


class Observation(eqx.Module):
    """The observation model `target = picture + bias + noise`, whose noise has the standard deviation sigma / sqrt(w).

    Args:
        target: scene-linear RGB; 0 in a pixel without a weight, and where no finite number came.
        bias: what the tracer's picture is known to lack of the mean over each pixel, 0 where nothing is known.
        root_weight: square root of the weight w of each pixel's channel in the sum of squares.
    """

    target: Picture
    bias: Picture
    root_weight: Picture

    def residual(self, image: Float[AnyArray, "3 height width"]) -> Float[AnyArray, "3 height width"]:
        """Picture and bias minus target, weighted; a picture of numpy compiles nothing."""
        fields = self.bias, self.target, self.root_weight
        bias, target, root = map(np.asarray, fields) if isinstance(image, np.ndarray) else fields
        return (image + bias - target) * root

    def with_bias(self, bias: Image) -> "Observation":
        """The same target beside pictures that lack something else."""
        return dataclasses.replace(self, bias=jnp.asarray(bias, self.target.dtype))

    def weighted(self, factor: Float[np.ndarray, "height width"]) -> "Observation":
        """The same target, each pixel of which weighs `factor` times as much."""
        root = np.asarray(self.root_weight) * np.sqrt(factor)
        return dataclasses.replace(self, root_weight=jnp.asarray(root, self.target.dtype))

    def binned(self, binning: int) -> "Observation":
        """Squares of pixels averaged to one; a square with a pixel of weight 0 is left out.

        Where that leaves nothing of a channel, as of the mosaic of a sensor, the mean of what has a weight stands for
        the square.
        """
        # In numpy: each operation on arrays of a new size is a program to JAX.
        weight, target = np.asarray(self.root_weight) ** 2, np.asarray(self.target)
        seen = (weight > 0).astype(weight.dtype)
        share = bin_pixels(seen, binning)
        whole = share == 1
        kept = np.where(np.any(whole, axis=(1, 2), keepdims=True), whole, share > 0)
        means = bin_pixels(target * seen, binning) / np.where(share > 0, share, 1)
        binned = np.where(kept, bin_pixels(weight, binning), 0)
        return Observation(*map(on_device, (means, bin_pixels(np.asarray(self.bias), binning), np.sqrt(binned))))

    @property
    def light_unit(self) -> float:
        """The power of two next to the root mean square of the target's light."""
        target, root = map(on_host, (self.target, self.root_weight))
        return nearest_power(np.sqrt(np.mean(target[root > 0] ** 2)))

    @property
    def seen(self) -> Bool[np.ndarray, "3 height width"]:
        """The numbers of the target with a weight."""
        return np.asarray(self.root_weight) > 0

    @property
    def counts(self) -> Mask:
        """The pixels with a weight in any channel."""
        return np.any(self.seen, axis=0)

    @property
    def count(self) -> int:
        """The number of the target's numbers that count: three for each pixel with a weight in all channels."""
        return int(np.sum(self.seen))


def nearest_power(size: float) -> float:
    """The power of two next to a size, on a logarithmic scale; 1 for 0."""
    return 2.0 ** round(math.log2(size)) if size > 0 else 1.0


def observe(target: object, weights: object, scene: Scene, settings: ResolvedSettings) -> Observation:
    """Check target and weights and bring them to the scene's dtype.

    Args:
        target: scene-linear RGB, top row first; NaN may stand where the weight is 0. A pixel of which `numpy.ma` masks
            a channel, here or in the weights, has the weight 0.
        weights: weight of each pixel, "height width", or of each of its channels, "3 height width"; 0 or more. None is
            1 everywhere.

    Raises:
        PictureError: no numbers, another size than the render, NaN, infinity, a constant target, or weights that are
            negative, or all zero.

    Warns:
        RaytraceWarning: the target's colours are hardly those of such a scene.
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
    if hidden.all():
        raise PictureError("no pixel of the target is there: all are masked, or outside of what its file stores")
    weight = _checked_weights(np.ones(hidden.shape) if weights is None else weights, hidden)
    counts = weight > 0
    bad = int(np.sum(~np.isfinite(picture[counts])))
    if bad:
        raise PictureError(
            f"the target has {bad} values that are NaN or infinite; a fit needs finite ones, or a mask without them"
        )
    picture = np.where(counts.any(axis=0) & np.isfinite(picture), picture, 0)
    if not any(np.ptp(channel[seen]) for channel, seen in zip(picture, counts, strict=True) if seen.any()):
        where = "" if counts.all() else ", as far as the mask shows it"
        raise PictureError(f"the target is one constant colour{where}; there is nothing in it to fit")
    for sentence in _oddities(picture, counts, scene):
        warnings.warn(sentence, RaytraceWarning, stacklevel=2)

    # All that follows computes in the scene's precision.
    dtype = scene.camera.viewpoint.dtype
    return Observation(*(on_device(part, dtype) for part in (picture, np.zeros(picture.shape), np.sqrt(weight))))


def _oddities(picture: Image, counts: Bool[np.ndarray, "3 height width"], scene: Scene) -> list[str]:
    """Oddities of a target's colours: a sentence for each oddity."""
    oddities, colours, whole = [], picture[counts], picture[:, counts.all(axis=0)]
    most = float(np.max(colours))
    # White is not 1 where most colours are beyond twice that, or all are whole numbers. Colours beyond 16 bits are in a
    # scene's own unit of light.
    if 2.0 < most <= 65535 and (np.median(colours) > 2.0 or np.all(colours == np.round(colours))):
        oddities.append(
            f"the target's colours go up to {most:.4g}, where white is 1: divide what was stored as 0 to 255."
        )
    if not is_gray(scene) and whole.size and np.all(whole == whole[:1]):
        oddities.append(
            "the target is gray, and the scene has colours: each channel is compared with the same numbers."
        )
    return oddities


def _numbers(values: object, name: str) -> np.ndarray:
    try:
        return real_numbers(values)
    except ValueError as reason:
        raise PictureError(f"the {name} {reason}") from None


def _checked_weights(weights: object, hidden: Bool[np.ndarray, "height width"]) -> Float[np.ndarray, "3 height width"]:
    """The weights of all pixels' channels, 0 for pixels that are hidden or of which a weight is masked."""
    weight, (height, width) = _numbers(weights, "mask"), hidden.shape
    if weight.ndim != 2 and (weight.ndim != 3 or weight.shape[0] != 3):
        raise PictureError(f"the mask has shape {weight.shape}; wanted ({height}, {width}) or (3, {height}, {width})")
    if weight.shape[-2:] != hidden.shape:
        raise PictureError(f"the mask is {weight.shape[-1]} x {weight.shape[-2]} pixels, the target {width} x {height}")
    masked = is_masked(weights)
    weight = np.where(hidden | (masked.any(axis=0) if masked.ndim == 3 else masked), 0.0, weight)
    bad = int(np.sum(~(np.isfinite(weight) & (weight >= 0))))
    if bad:
        raise PictureError(f"the mask has {bad} values that are negative, NaN or infinite; weights are 0 or more")
    if not np.any(weight > 0):
        raise PictureError("the mask is 0 everywhere; there is nothing left to fit")
    return np.broadcast_to(weight, (3, height, width))
