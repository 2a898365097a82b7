"""The labelled sheet of a gallery: its pictures in rows, each with its derivatives below."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.images.png import Transfer, encode_course, encode_srgb
from raytrace_jax.report.gradient_figure import draw_signed, scale_limit
from raytrace_jax.tracer.derivatives import PictureDerivatives

CELL = 3.6  # inches
DPI = 150


def draw_gallery(
    titles: Sequence[str], pictures: Sequence[PictureDerivatives], columns: int, transfer: Transfer = "course"
) -> Figure:
    """Draw pictures in rows of `columns`; each derivative has one colour scale for all of them.

    Args:
        titles: one for each picture.
        pictures: all of the same size and with derivatives by the same parameters, or by none.
        columns: how many pictures go into a row.
        transfer: how colours become those of the screen.
    """
    encode = encode_course if transfer == "course" else encode_srgb
    names = pictures[0].names
    _, height, width = pictures[0].image.shape
    bands, rows_each = -(-len(pictures) // columns), 1 + len(names)
    size = CELL * columns, (0.9 * CELL * height / width + 0.3) * bands * rows_each
    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    axes = figure.subplots(bands * rows_each, columns, squeeze=False)
    limits = [max(scale_limit(picture.values[k]) for picture in pictures) or 1.0 for k in range(len(names))]
    for place, (title, picture) in enumerate(zip(titles, pictures, strict=True)):
        band, column = divmod(place, columns)
        ax = axes[band * rows_each, column]
        ax.imshow(np.moveaxis(encode(picture.image), 0, -1))
        ax.set_title(title, fontsize=9)
        for k, name in enumerate(names):
            draw_signed(axes[band * rows_each + 1 + k, column], picture.values[k], limits[k], name, f"d.{name}")
    for ax in axes.ravel():
        ax.set_xticks([])
        ax.set_yticks([])
    for ax in axes.ravel()[len(pictures) * rows_each :]:
        ax.set_visible(False)
    return figure
