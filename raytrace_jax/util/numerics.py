"""Small numerical building blocks: components first, rays last, and no NaN in values or derivatives.

One number a ray meets vectors of three a ray, as NumPy broadcasts: `with_lower_ranks` lets it where JAX would not.

Inner products are sums over an axis, which XLA fuses with what is around them: written out, a quarter of a program's
operations are slices of vectors.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from equinox.internal import unvmap_any
from jax.core import Tracer
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])

Vectors = Float[Array, "3 *rays"]
"""Three numbers a ray, components first: a point, a direction or a colour."""

Scalars = Float[Array, " *rays"]
"""One number a ray."""

TINY = 1e-300
"""A divisor in float64 is at least this, lest it is 0: above the least normal number, 2e-308."""

TINY_32 = 1e-30
"""A divisor in any dtype is at least this, also under a square root: the least normal number of float32 is 1e-38, and
the root, 1e-15 units, is below the rounding of every point."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over the median of its magnitude: 1 over the normal quartile, 0.6745."""


def with_lower_ranks(function: F) -> F:
    """A function whose arrays of several ranks meet also where `jax_numpy_rank_promotion` is "raise" or "warn"."""

    @functools.wraps(function)
    def wrapped(*args, **kwargs):
        with jax.numpy_rank_promotion("allow"):
            return function(*args, **kwargs)

    return wrapped  # pyright: ignore[reportReturnType]


def dot(a: Float[Array, "3 *#rays"], b: Float[Array, "3 *#rays"]) -> Float[Array, " *#rays"]:
    """Inner product of vectors whose components lie on the first axis."""
    return jnp.sum(a * b, 0)


def dot_fixed(a: Float[Array, "3"], b: Vectors) -> Scalars:
    """Dot product of one vector with that of each ray."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def per_ray(vector: Float[Array, "3"], ray_axes: int) -> Float[Array, "3 *ones"]:
    """One vector, shaped to broadcast over rays with `ray_axes` axes."""
    return vector.reshape((3,) + (1,) * ray_axes)


def vectors_to(end: Float[Array, "3"], o: Vectors) -> Vectors:
    """Vectors from the origin of each ray to one point."""
    return per_ray(end, o.ndim - 1) - o


def normalize(a: Vectors) -> Vectors:
    """Vectors of length one along `a`, which must not be zero."""
    return a * jax.lax.rsqrt(dot(a, a))


def direction(a: Vectors) -> Vectors:
    """Vectors of length one along `a`, which has any length but 0: its squares neither overflow nor vanish."""
    # The scale is only a matter of rounding and has no derivative.
    return normalize(a / jax.lax.stop_gradient(jnp.max(jnp.abs(a), axis=0)))


def renormalize(a: Vectors) -> Vectors:
    """Vectors of length one but for rounding errors, without most of these: a Newton step of the inverse root."""
    return a * ((3 - dot(a, a)) / 2)


@jax.custom_jvp
def safe_normalize(a: Vectors) -> Vectors:
    """Vectors of length one along `a`; what is shorter than 1e-6 stays short, with a finite derivative."""
    return a * jax.lax.rsqrt(jnp.maximum(dot(a, a), 1e-12))


@safe_normalize.defjvp
def _safe_normalize_jvp(primals, tangents):
    (a,), (a_dot,) = primals, tangents
    squared = dot(a, a)
    inverse = jax.lax.rsqrt(jnp.maximum(squared, 1e-12))
    n = a * inverse
    # A vector of length one turns, and does not grow.
    return n, (a_dot - jnp.where(squared > 1e-12, dot(n, a_dot), 0) * n) * inverse


def safe_sqrt(x: Scalars) -> Scalars:
    """`sqrt(max(x, 0))` whose derivative is zero where `x <= 0`: `where(x > 0, sqrt(x), 0)` has a derivative of NaN."""
    positive = x > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1)), 0)


def mean_sqrt(x: Scalars, width: Scalars) -> Scalars:
    """The mean of `safe_sqrt` over an interval of that width, not negative, around `x`; `safe_sqrt(x)` where it is 0.

    Its derivative is the root's mean one, at most `1 / sqrt(width)`; the width is a constant to it. With p and q the
    roots at the interval's ends the mean is `2/3 (p^3 - q^3) / width`, written without a difference of the two.
    """
    width = jax.lax.stop_gradient(width)
    fixed = jax.lax.stop_gradient(x)
    upper, lower = (jnp.maximum(fixed + side * width / 2, 0) for side in (1, -1))
    p, q = jnp.sqrt(upper), jnp.sqrt(lower)
    positive = upper > 0
    ends = jnp.where(positive, p + q, 1)
    # The fraction of the interval above zero; all of it if its width is 0 or lost to rounding.
    fraction = jnp.where(lower > 0, 1, upper / jnp.where(width > 0, jnp.maximum(width, upper), 1))
    slope = jnp.where(positive, fraction / ends, 0)
    return slope * (2 / 3 * (p * p + p * q + q * q) + (x - fixed))


def away_from_zero(x: Scalars, least: Float[Array, " *#rays"] | float) -> Scalars:
    """`x`, moved to magnitude `least` with its sign kept where it is smaller: a divisor that cannot blow up."""
    return jnp.where(jnp.abs(x) < least, jnp.where(x < 0, -least, least), x)


@jax.custom_jvp
def clamp01(x: Float[Array, "*any"]) -> Float[Array, "*any"]:
    """`x` limited to [0, 1]; the derivative is one on the closed interval, so that clamping twice is clamping once."""
    return jnp.clip(x, 0, 1)


@clamp01.defjvp
def _clamp01_jvp(primals, tangents):
    (x,), (x_dot,) = primals, tangents
    return clamp01(x), jnp.where((x >= 0) & (x <= 1), x_dot, 0)


def select(condition: Bool[Array, " *rays"], this: T, other: T) -> T:
    """Ray by ray the leaves of one pytree or of another; the rays lie on their last axes."""
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), this, other)


def unstacked(values: T, count: int) -> list[T]:
    """The pytrees that lie side by side on the leaves' first axes."""
    return [jax.tree.map(lambda x: x[k], values) for k in range(count)]  # noqa: B023


def is_zero(tangents: Any) -> bool:
    """Whether nothing is differentiated, as a rule with `symbolic_zeros` is told."""
    return all(isinstance(leaf, jax.custom_derivatives.SymbolicZero) for leaf in jax.tree.leaves(tangents))


def instantiated(tangents: T) -> T:
    """Such tangents as arrays."""
    return jax.tree.map(lambda x: np.zeros(x.shape, x.dtype) if is_zero(x) else x, tangents)


def any_nonzero(color: Vectors) -> Bool[Array, " *rays"]:
    """Whether a colour is not black, of each ray."""
    return (color[0] != 0) | (color[1] != 0) | (color[2] != 0)


def materialize(values: T, live: Bool[Array, "*rays"]) -> T:
    """The values themselves, computed once and stored; zeros if no ray is live at all.

    XLA fuses a cheap computation into all that uses it and computes it anew in each: across many stages, and in
    derivatives with many directions, two to four times as long. Nothing is fused across a condition, so that stages end
    at this one, which also skips a level that nobody reached.
    """
    return jax.lax.cond(unvmap_any(live), lambda x: x, lambda x: jax.tree.map(jnp.zeros_like, x), values)


def only_if(condition: Bool[Array, ""], function: Callable[..., T], *given: Any) -> T:
    """What the function gives, or zeros without asking it; in reverse mode it is computed anew."""
    nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(function, *given))
    return jax.lax.cond(unvmap_any(condition), jax.checkpoint(function), lambda *_: nothing, *given)


def repeat(step: Callable[[T], T], start: T, goes_on: Callable[[T], Array], most: int, reversible: bool) -> T:
    """Take steps while there is something to do: `most` of them, if reverse mode is to go through them.

    A step after the last one changes nothing that counts. So the loop ends with the last of many that `jax.vmap` maps
    it over, without a choice between old and new values at each step.
    """
    if reversible:
        return jax.lax.scan(lambda state, _: (step(state), None), start, length=most)[0]
    return jax.lax.while_loop(lambda state: unvmap_any(goes_on(state)), step, start)


def finite_or_last(cost: float) -> float:
    """A cost for comparisons: one that is not finite is infinite, so that it is never the least."""
    return cost if math.isfinite(cost) else math.inf


def root_diagonal(matrix: Float[np.ndarray, "numbers numbers"]) -> Float[np.ndarray, " numbers"]:
    """The roots of a diagonal: standard deviations by a covariance, lengths of columns by their inner products."""
    return np.sqrt(np.maximum(np.diagonal(matrix), 0))


def solve_normal(normal: Float[np.ndarray, "parameters parameters"], right: Float[np.ndarray, "parameters *changes"]):
    """Solve normal equations after scaling the columns to length one; the solution is 0 along what they leave open."""
    length = root_diagonal(normal)
    length = np.where(length > 0, length, 1.0)
    by_row = length.reshape(-1, *[1] * (right.ndim - 1))
    return np.linalg.lstsq(normal / np.outer(length, length), right / by_row, rcond=1e-12)[0] / by_row


def cast(values: np.ndarray, dtype: np.dtype) -> np.ndarray:
    """Cast float64 to the scene's dtype; what is too large becomes infinite, what is too small zero."""
    with np.errstate(over="ignore", under="ignore"):
        return values.astype(dtype)


def is_traced(value: object) -> bool:
    """Whether a value, or anything in it, is only known when a program runs: it cannot be checked yet."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(value))


def on_device(value: Any, dtype: DTypeLike | None = None) -> Array:
    """A copy of a value as an array of JAX. `jnp.asarray` compiles a program for each shape that comes from NumPy."""
    if is_traced(value):
        return jnp.asarray(value, dtype)
    # Inside a jit it is known at once as well. What is too large becomes infinite.
    with jax.ensure_compile_time_eval(), np.errstate(over="ignore", under="ignore"):
        return jax.device_put(np.array(value, dtype))


def on_host(value: Any) -> Float[np.ndarray, "*any"]:
    """A value, such as an array of JAX, as an array of NumPy in float64."""
    return np.asarray(value, np.float64)


def real_numbers(values: object) -> np.ndarray:
    """Values as an array of real numbers, of which those that `numpy.ma` masks are NaN.

    Raises:
        ValueError: they are no real numbers; the message is what follows their name.
    """
    try:
        array = np.ma.asarray(values)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"is no array of numbers, but a {type(values).__name__}") from None
    if not any(jnp.issubdtype(array.dtype, kind) for kind in (np.floating, np.integer, np.bool_)):
        raise ValueError(f"is an array of the dtype {array.dtype}, and real numbers are wanted")
    return np.ma.filled(array.astype(float), np.nan) if np.ma.is_masked(array) else array.data


def is_masked(values: object) -> Bool[np.ndarray, "*any"]:
    """Which values `numpy.ma` masks; none of a plain array."""
    return np.ma.getmaskarray(np.ma.asarray(values))
