"""Sums over squares of pixels, over which neighbours that err together are one."""

import numpy as np
from jaxtyping import Float


def square_sums(
    image: Float[np.ndarray, "channels height width"], side: int
) -> Float[np.ndarray, "channels rows columns"]:
    """Sums over squares of so many pixels a side; squares at the right and lower border may be cut."""
    channels, height, width = image.shape
    padded = np.pad(image, ((0, 0), (0, -height % side), (0, -width % side)))
    return padded.reshape(channels, padded.shape[1] // side, side, -1, side).sum((2, 4))
