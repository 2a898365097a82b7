"""Gaussian blur, and means over squares of pixels."""

from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

Images = Float[Array, "*any height width"]


def gaussian_blur(image: Images, sigma: Float[Array, ""]) -> Images:
    """Blur rows and columns with a Gaussian of standard deviation `sigma` pixels; 0 leaves the picture as it is.

    The kernel is cut off at the picture's border and scaled to sum to one there. `sigma` may be traced: a new one
    needs no new compile. Two matrix products of the picture's size are as fast as any convolution at these sizes and
    linear to the letter, so that a blurred derivative is the derivative of the blurred picture.
    """
    return jax.lax.cond(sigma > 0, lambda image: blurred(image, sigma, jnp), lambda image: image, image)


def blurred(image, sigma, xp: ModuleType = np):
    """Blur as `gaussian_blur` does; in NumPy, which needs no new program for another size, or in the library `xp`."""

    def kernel(size: int):
        """Row i holds the weights with which the pixels of a line contribute to its blurred pixel i, "size size"."""
        position = xp.arange(size, dtype=image.dtype)
        # A sigma of 0 must not divide by 0; its kernel is the identity.
        distance = (position[:, None] - position[None, :]) / xp.maximum(xp.asarray(sigma, image.dtype), 1e-3)
        # Cut the exponent, not the result: exp(-80) = 2e-35 is a normal number of float32, and no weight that counts.
        weights = xp.exp(-xp.minimum(distance * distance / 2, 80.0))
        return weights / xp.sum(weights, axis=1, keepdims=True)

    height, width = image.shape[-2:]
    return kernel(height) @ image @ kernel(width).T


def bin_pixels(image: Float[np.ndarray, "*any height width"], binning: int) -> Float[np.ndarray, "*any rows columns"]:
    """Means over squares of `binning` pixels; what does not fill one is left out, as in a render with that setting."""
    rows, columns = (max(1, size // binning) for size in image.shape[-2:])
    image = image[..., : rows * binning, : columns * binning]
    return image.reshape(*image.shape[:-2], rows, -1, columns, image.shape[-1] // columns).mean((-3, -1))
