"""Pictures are blurred by a Gaussian and averaged over squares of pixels."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float


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


def blurred(image: Float[np.ndarray, "*any height width"], sigma: float) -> Float[np.ndarray, "*any height width"]:
    """Blur as `gaussian_blur` does, in NumPy, which needs no new program for another size."""
    if sigma == 0:
        return image
    rows, columns = (kernel(size, sigma, image.dtype, np) for size in image.shape[-2:])
    return rows @ image @ columns.T


def bin_pixels(image: Float[np.ndarray, "*any height width"], binning: int) -> Float[np.ndarray, "*any rows columns"]:
    """Means over squares of `binning` pixels; what does not fill one is left out, as in a render with that setting."""
    rows, columns = (max(1, size // binning) for size in image.shape[-2:])
    image = image[..., : rows * binning, : columns * binning]
    return image.reshape(*image.shape[:-2], rows, -1, columns, image.shape[-1] // columns).mean((-3, -1))


def kernel(size: int, sigma: Float[ArrayLike, ""], dtype, numpy: Any = jnp) -> Any:
    """Row i holds the weights with which the pixels of a line contribute to its blurred pixel i, "size size".

    `numpy` is the library, of JAX or its model, whose array it is.
    """
    position = numpy.arange(size, dtype=dtype)
    # A blur of 0 is traced but not taken: it must not divide by 0.
    distance = (position[:, None] - position[None, :]) / numpy.maximum(numpy.asarray(sigma, dtype), 1e-3)
    # Cut the exponent, not the result: exp(-80) = 2e-35 is still a normal number of float32, and no weight that counts.
    weights = numpy.exp(-numpy.minimum(distance * distance / 2, 80.0))
    return weights / numpy.sum(weights, axis=1, keepdims=True)
