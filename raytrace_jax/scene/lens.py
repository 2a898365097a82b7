"""Radial distortion of a lens (Brown, Close-range camera calibration, 1971), its inverse, and where it folds over.

Lengths are in units of the focal length, from the principal point. What a pinhole camera shows at x is shown at
`x (1 + k1 r^2 + k2 r^4)` with r = |x|, in OpenCV's order and sign: `k1 < 0` is a barrel.
"""

from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..util.numerics import TINY_32

AnyArray = TypeVar("AnyArray", Array, np.ndarray)

FARTHEST_SQUARE = 1e9
"""Beyond this squared distance, in its own unit, a distortion is taken for as strong as there."""


def folds_of(distortion: AnyArray) -> tuple[AnyArray, AnyArray, AnyArray]:
    """The unit of a distortion (k1, k2), of JAX or of numpy, and where it folds over in it; nothing overflows.

    In its unit of length the larger of its two terms is 1 where the radius is 1.

    Returns:
        How many squares of this unit the squared focal length has; and the squared radii, in this unit, at which the
        distortion folds over, without and with distortion: `FARTHEST_SQUARE` if it does not.
    """
    xp = distortion.__array_namespace__()
    k1, k2 = distortion
    larger = xp.maximum(xp.abs(k1), xp.sqrt(xp.abs(k2)))
    per_square = xp.where(larger > TINY_32, larger, xp.ones_like(larger))
    k1, k2 = k1 / per_square, k2 / per_square / per_square
    # The first zero of 1 + 3 k1 r^2 + 5 k2 r^4, the slope of the radius.
    discriminant = 9 * k1 * k1 - 20 * k2
    slope = xp.sqrt(xp.maximum(discriminant, 0 * k1)) - 3 * k1
    folds = (discriminant >= 0) & (slope > 0)
    undistorted = 2 / xp.where(folds, slope, xp.ones_like(slope))
    distorted = undistorted * (1 + undistorted * (k1 + undistorted * k2)) ** 2
    nowhere = xp.full_like(slope, FARTHEST_SQUARE)
    return per_square, xp.where(folds, undistorted, nowhere), xp.where(folds, distorted, nowhere)


def visible_fraction(distortion: Float[np.ndarray, "2"], farthest: float) -> float:
    """The fraction of a distance from the principal point up to which the picture shows anything; 1 or more for all.

    The distance is in focal lengths, in the distorted picture. Beyond, the distortion would have to fold the picture
    over. Divides by zero where the distance is 0.
    """
    per_square, _, distorted = folds_of(np.asarray(distortion, np.float64))
    return np.inf if distorted == FARTHEST_SQUARE else float(np.sqrt(distorted / per_square) / farthest)


def undistorted_factor(distortion: Float[Array, "2"], square: Float[Array, " *points"]) -> Float[Array, " *points"]:
    """The factor from points of the distorted picture to those of a pinhole camera: exactly 1 without distortion.

    Beyond the point where the distortion folds over, the factor stays what it is there.

    Args:
        square: squared distances of the points from the principal point, in the distorted picture.
    """
    per_square, undistorted, distorted = folds_of(jax.lax.stop_gradient(distortion))
    k1, k2 = distortion
    return _factor(k1 / per_square, k2 / per_square / per_square, square * per_square, undistorted, distorted)


@jax.custom_jvp
def _factor(k1, k2, square, undistorted, distorted):
    """The root t of `t (1 + a t^2 + b t^4) = 1` with a = k1 square, b = k2 square^2; exactly 1 where both are 0."""
    square = jnp.minimum(square, distorted)
    # Most cameras have none: without the steps a picture's rays are set up in a tenth of the time.
    return jax.lax.cond(
        (k1 == 0) & (k2 == 0), lambda *_: jnp.ones_like(square), _find_root, k1, k2, square, undistorted
    )


def _find_root(k1, k2, square, undistorted):
    a, b = k1 * square, k2 * square * square
    # Exact for large a or b alone; where these are negative the function is concave from here to the root.
    start = jnp.minimum(1 / jnp.cbrt(1 + jnp.maximum(a, 0)), (1 + jnp.maximum(b, 0)) ** -0.2)
    # Before it folds over, a distortion draws nothing nearer to the principal point than 4/9 of where it was.
    highest = jnp.minimum(2.25, jnp.sqrt(undistorted / jnp.maximum(square, TINY_32)))

    def step(state):
        step_count, lowest, highest, t, _ = state
        excess, slope = t * (1 + t * t * (a + t * t * b)) - 1, _slope(a, b, t)
        lowest, highest = jnp.where(excess < 0, t, lowest), jnp.where(excess < 0, highest, t)
        following = t - excess / jnp.where(slope > 0, slope, 1)
        is_inside = (slope > 0) & (following >= lowest) & (following <= highest)
        return step_count + 1, lowest, highest, jnp.where(is_inside, following, (lowest + highest) / 2), t

    def goes_on(state):
        step_count, _, _, t, before = state
        return (step_count < 16) & jnp.any(jnp.abs(t - before) > 4 * jnp.finfo(t.dtype).eps * t)

    # 12 steps reach the rounding errors of either dtype up to 99 % of the squared radius at which any distortion folds
    # over, and 15 up to 99.99 % (400000 distortions and points). The lenses of cameras take four or five.
    lowest = jnp.zeros_like(square)
    return jax.lax.while_loop(goes_on, step, (0, lowest, highest, jnp.minimum(start, highest), lowest))[3]


@_factor.defjvp
def _factor_jvp(primals, tangents):
    """The root's derivative by the implicit function theorem, to any order; the steps are not differentiated."""
    k1, k2, square, _, distorted = primals
    k1_dot, k2_dot, square_dot, *_ = tangents
    t = _factor(*primals)
    is_seen = square < distorted
    square = jnp.minimum(square, distorted)
    # The slope of the distorted radius by the undistorted one is 0 at the fold.
    slope = jnp.maximum(_slope(k1 * square, k2 * square * square, t), 1e-6)
    s = square * t * t
    change = s * k1_dot + s * s * k2_dot + (k1 + 2 * k2 * s) * t * t * square_dot
    return t, jnp.where(is_seen, -t * change / slope, 0)


def _slope(a, b, t):
    return 1 + t * t * (3 * a + 5 * t * t * b)
