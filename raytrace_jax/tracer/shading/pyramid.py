"""A picture at ever half the size, for the mean over an area from a few look-ups (Williams 1983).

Levels are made by exact means: the texel of a level covers so many of the next finer one as the sizes say, also where
these are odd, so that no level is shifted and all have the same mean.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from raytrace_jax.tracer.geometry.gather import take_column


class Pyramid(eqx.Module):
    """The levels of a picture, one after the other and row by row, the finest first."""

    texels: Float[Array, "3 texels"]
    sizes: tuple[tuple[int, int], ...] = eqx.field(static=True)
    """Height and width of each level."""

    def size(self, level: Int[Array, " *rays"]) -> tuple[Float[Array, " *rays"], Float[Array, " *rays"]]:
        """Height and width of levels."""
        sizes = jnp.asarray(self.sizes, self.texels.dtype).T
        return take_column(sizes[0], level), take_column(sizes[1], level)

    def texel(
        self, level: Int[Array, " *rays"], row: Int[Array, " *rays"], column: Int[Array, " *rays"]
    ) -> Float[Array, "3 *rays"]:
        """Texels of levels; rows and columns are in bounds."""
        starts, start = [], 0
        for height, width in self.sizes:
            starts.append(start)
            start += height * width
        starts, widths = jnp.asarray(starts, jnp.int32), jnp.asarray([width for _, width in self.sizes], jnp.int32)
        index = take_column(starts, level) + row * take_column(widths, level) + column
        return self.texels.at[:, index].get(mode="promise_in_bounds")


def make_pyramid(texels: Float[Array, "3 height width"], *, levels: int | None = None) -> Pyramid:
    """The pyramid of a picture, down to one texel or to so many levels; one level is enough to look up points."""
    made = [texels]
    while max(made[-1].shape[1:]) > 1 and (levels is None or len(made) < levels):
        made.append(_halved(_halved(made[-1], axis=1), axis=2))
    sizes = tuple((level.shape[1], level.shape[2]) for level in made)
    return Pyramid(jnp.concatenate([level.reshape(3, -1) for level in made], axis=1), sizes)


def _halved(texels: Float[Array, "3 _ _"], axis: int) -> Float[Array, "3 _ _"]:
    """Means over floor(n / 2) equal parts of an axis of n texels, of which an odd one is shared by two parts."""
    n = texels.shape[axis]
    half = n // 2
    if half == 0:
        return texels
    texels = jnp.moveaxis(texels, axis, -1)
    if n % 2 == 0:
        means = (texels[..., 0::2] + texels[..., 1::2]) / 2
    else:
        # Part k reaches from k n / half to (k + 1) n / half.
        k = jnp.arange(half, dtype=texels.dtype)
        first, middle, last = texels[..., 0 : n - 1 : 2], texels[..., 1::2], texels[..., 2::2]
        means = ((half - k) * first + half * middle + (k + 1) * last) / n
    return jnp.moveaxis(means, -1, axis)
