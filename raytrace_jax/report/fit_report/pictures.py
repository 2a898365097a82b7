"""The pictures of a report: a residual with a scale of its own, and any of them as a PNG inside of a page."""

import io
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.panels import draw_signed_values
from raytrace_jax.report.templates import data_address


class Residual(NamedTuple):
    """Fit minus target in units of 1/255.

    Args:
        picture: "height width", of each pixel's three differences the largest with its sign; masked where the pixel
            does not count.
        limit: the end of the colour scale.
        extends: whether some pixels lie beyond it.
    """

    picture: np.ma.MaskedArray
    limit: float
    extends: bool


def residual_of(result: FitResult, image: np.ndarray) -> Residual:
    """The signed residual of a fit's picture, with a scale that a few bright pixels at edges do not spoil."""
    difference = 255 * (image - result.pictures.target)
    worst = np.argmax(np.abs(difference), axis=0)[None]
    picture = np.ma.masked_where(result.pictures.weights == 0, np.take_along_axis(difference, worst, axis=0)[0])
    sizes = np.abs(picture.compressed())
    if not sizes.size:
        return Residual(picture, 1.0, False)
    limit = float(np.quantile(sizes, 0.995)) or float(sizes.max()) or 1.0
    return Residual(picture, limit, bool(sizes.max() > limit))


def draw_residual(ax: Axes, result: FitResult, image: np.ndarray) -> None:
    """Draw the signed residual: blue where the fit is darker than the target, grey where a pixel does not count."""
    residual = residual_of(result, image)
    draw_signed_values(ax, residual.picture, residual.limit, residual.extends, "1/255")


class Embedded(NamedTuple):
    """An image of a page: its data address, its size in pixels, and whether its pixels are to stay visible."""

    address: str
    width: int
    height: int
    coarse: bool = False


def embed_pixels(pixels: np.ndarray) -> Embedded:
    """Embed an 8-bit picture "height width 3"."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    # Pictures above 1600 pixels are reduced: a page has no room for more, and a mail no patience.
    image = image.reduce(-(-max(image.size) // 1600))
    file = io.BytesIO()
    image.save(file, "PNG")
    # Pictures below 200 pixels are shown with visible pixels rather than smoothed.
    return Embedded(data_address(file.getvalue()), *image.size, coarse=image.width < 200)


def embed_panel(draw: Callable[[Axes], None]) -> Embedded:
    """Draw one panel and embed it, transparent, so that the page's own background shows."""
    size, dots = (3.3, 2.3), 200  # Inches, and dots in each.
    figure = Figure(figsize=size, dpi=dots, layout="constrained")
    draw(figure.subplots())
    file = io.BytesIO()
    figure.savefig(file, format="png", transparent=True)
    width, height = (round(dots * inches) for inches in size)
    return Embedded(data_address(file.getvalue()), width, height)
