"""The noise of a target whose pixels are means of random samples: more of it where the inside of a pixel varies."""

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.util.numerics import TINY

ROUNDS = 20
"""Of the fit of squares: it rests after five to ten."""

LARGEST_SQUARE = 25.0
"""In units of what is expected of it: a square beyond five standard deviations is something else than noise."""

SIGNIFICANT = 5.0
"""Standard errors from which on the share of the variance counts."""

MOST_SHARE = 0.5
"""Of two samples a pixel: a larger share is no mean of samples, but an edge that is not where it should be."""

LEAST_NOISE = 1e-2
"""Share of the whole residual's root mean square that counts as noise everywhere at least: nothing that a picture of
another program is compared with is right to its rounding, and pixels without noise would rule all others."""


def sampling_weights(
    residual: Float[np.ndarray, "3 height width"],
    variance: Float[np.ndarray, "3 height width"],
    counts: Bool[np.ndarray, "height width"],
) -> Float[np.ndarray, "height width"] | None:
    """What each pixel counts beside one whose inside is of one colour; None where the residual shows no such noise.

    A mean of `N` random samples has the variance `v / N`, where `v` is the variance within the pixel. So squares of the
    residual are fitted by `sigma^2 + s v`, by weighted least squares whose weights are those of chi-square of the fit
    before: pixels that are off for other reasons are cut off. The weights are `sigma^2 / (sigma^2 + s v)`.

    Args:
        residual: picture minus target.
        variance: within each pixel.
        counts: the pixels that count.
    """
    squares, inside = (np.mean(part[:, counts], axis=0) for part in (residual**2, variance))
    whole = float(np.mean(squares)) if squares.size else 0.0
    if not whole > 0 or not np.max(inside) > 0:
        return None
    least = LEAST_NOISE**2 * whole
    scale = float(np.max(inside))
    columns = np.stack([np.ones_like(inside), inside / scale])
    noise, share, normal = whole, 0.0, np.eye(2)
    for _ in range(ROUNDS):
        expected = np.maximum(noise + share * columns[1], least)
        cut = np.minimum(squares, LARGEST_SQUARE * expected)
        weighted = columns / expected**2
        normal = weighted @ columns.T
        noise, share = np.linalg.solve(normal, weighted @ cut)
        noise, share = max(float(noise), least), max(float(share), 0.0)
    # Of three channels, a square scatters by about as much as its mean.
    error = float(np.sqrt(max(np.linalg.inv(normal)[1, 1], TINY)))
    if share < SIGNIFICANT * error or share / scale > MOST_SHARE:
        return None
    return np.asarray(noise / (noise + share / scale * variance.mean(axis=0)))
