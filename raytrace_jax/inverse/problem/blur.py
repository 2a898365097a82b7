"""Gaussian blur of pictures: coarse levels see where a structure is before it overlaps the target's."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

LEAST_SIGMA = 1e-3
"""Of a kernel, in pixels, where a blur of 0 is traced but not taken: nothing may be divided by 0."""

LARGEST_EXPONENT = 80.0
"""Of a kernel's weights: exp(-80) = 2e-35 is still a normal number of float32, and no weight that counts."""


def gaussian_blur(
    image: Float[Array, "*any height width"], sigma: Float[Array, ""]
) -> Float[Array, "*any height width"]:
    """Blur rows and columns with a Gaussian of standard deviation `sigma` pixels; 0 leaves the picture as it is.

    The kernel is cut off at the picture's border and scaled to sum to one there. `sigma` may be traced: a new one
    needs no new compile. Two matrix products of the picture's size are as fast as any convolution at these sizes and
    linear to the letter, so that a blurred derivative is the derivative of the blurred picture.
    """
    height, width = image.shape[-2:]

    def apply(image):
        rows, columns = kernel(height, sigma, image.dtype), kernel(width, sigma, image.dtype)
        return rows @ image @ columns.T

    return jax.lax.cond(sigma > 0, apply, lambda image: image, image)


def bin_pixels(image: Float[np.ndarray, "*any height width"], binning: int) -> Float[np.ndarray, "*any rows columns"]:
    """Means over squares of `binning` pixels; what does not fill one is left out, as in a render with that setting."""
    rows, columns = (max(1, size // binning) for size in image.shape[-2:])
    image = image[..., : rows * binning, : columns * binning]
    return image.reshape(*image.shape[:-2], rows, -1, columns, image.shape[-1] // columns).mean((-3, -1))


def kernel(size: int, sigma: Float[Array, ""], dtype) -> Float[Array, "size size"]:
    """Row i holds the weights with which the pixels of a line contribute to its blurred pixel i."""
    position = jnp.arange(size, dtype=dtype)
    distance = (position[:, None] - position[None, :]) / jnp.maximum(jnp.asarray(sigma, dtype), LEAST_SIGMA)
    # Cut the exponent where it underflows, not the result.
    weights = jnp.exp(-jnp.minimum(distance * distance / 2, LARGEST_EXPONENT))
    return weights / jnp.sum(weights, axis=1, keepdims=True)
