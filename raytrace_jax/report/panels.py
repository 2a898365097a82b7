"""What the figures share: pixels for a screen, signed colours with their scale, panels without ticks."""

from collections.abc import Iterable

import matplotlib
import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes

from raytrace_jax.images.options import Transfer
from raytrace_jax.images.transfer import ENCODERS

SIGNED = matplotlib.colormaps["RdBu_r"].with_extremes(bad="#8c8c8c")
"""Blue below zero, red above, grey where a pixel is masked."""


def as_pixels(rgb: ArrayLike, transfer: Transfer) -> np.ndarray:
    """The 8-bit pixels "height width 3" of a picture "3 height width"."""
    return np.ascontiguousarray(np.moveaxis(ENCODERS[transfer](np.asarray(rgb)), 0, -1))


def signed_pixels(values: np.ndarray, limit: float) -> np.ndarray:
    """8-bit colours "height width 3" of signed values "height width", white at zero and symmetric about it."""
    return SIGNED((values / limit + 1) / 2, bytes=True)[..., :3]


def draw_signed_values(ax: Axes, values: np.ndarray, limit: float, extends: bool, words: str) -> None:
    """Draw signed values "height width" with a colour bar, which has arrows where values lie beyond its ends."""
    mesh = ax.imshow(values, cmap=SIGNED, vmin=-limit, vmax=limit)
    beside = ax.inset_axes((1.03, 0, 0.05, 1))
    bar = ax.figure.colorbar(mesh, cax=beside, extend="both" if extends else "neither")
    bar.set_label(words, fontsize=7)
    bar.ax.tick_params(labelsize=7)
    bar.ax.yaxis.get_offset_text().set_fontsize(7)


def remove_ticks(axes: Iterable[Axes]) -> None:
    """Take the ticks off panels that show pictures."""
    for ax in axes:
        ax.set_xticks([])
        ax.set_yticks([])
