"""Textures in plain numbers, on their way to other renderers and from them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.scene import build
from raytrace_jax.scene.rows import Description


class Texture(NamedTuple):
    """A texture: a checker board, or a picture.

    Args:
        name: that it has; empty where it has none.
        colors: the two colours of a checker board; none of a picture.
        square: the side of a checker board's squares, in world units.
        offset: where one of them begins.
        texels: the picture's, scene-linear, the top row first; None for a checker board.
        filter, wrap: the picture's, as in `scene.Images`.
    """

    name: str
    colors: tuple[tuple[float, ...], ...] = ()
    square: float = 1.0
    offset: tuple[float, ...] = (0.0, 0.0)
    texels: Float[np.ndarray, "3 height width"] | None = None
    filter: str = "bilinear"
    wrap: str = "repeat"

    @property
    def mean(self) -> tuple[float, ...]:
        """The mean colour."""
        colors = np.array(self.colors).T if self.texels is None else self.texels.reshape(3, -1)
        return tuple(map(float, colors.mean(axis=1)))

    def block(self, name: str) -> Description:
        """The block of that name."""
        if self.texels is not None:
            return build.texture(name, kind="image", file=self.texels, filter=self.filter, wrap=self.wrap)
        first, second = self.colors
        return build.texture(name, kind="checker", color1=first, color2=second, square=self.square, offset=self.offset)

    def is_like(self, other: "Texture | None") -> bool:
        """Whether another one shows the same."""
        if other is None or (self.texels is None) != (other.texels is None):
            return False
        same = self._replace(name="", texels=None) == other._replace(name="", texels=None)
        return same and (self.texels is None or np.array_equal(self.texels, np.asarray(other.texels)))
