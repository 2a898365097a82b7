"""The pictures of a report: a residual with a scale of its own, and any of them as a PNG inside of a page."""

import base64
import io
from collections.abc import Callable
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from PIL import Image

from raytrace_jax.images.png import ENCODERS
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

SHOWN_SHARE = 0.995
EXCLUDED = "#8c8c8c"


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
    limit = float(np.quantile(sizes, SHOWN_SHARE)) or float(sizes.max()) or 1.0
    return Residual(picture, limit, bool(sizes.max() > limit))


def residual_colours() -> Colormap:
    """Blue where the fit is darker than the target, red where it is brighter, grey where a pixel does not count."""
    return matplotlib.colormaps["RdBu_r"].with_extremes(bad=EXCLUDED)


def draw_residual(ax: Axes, result: FitResult, image: np.ndarray) -> None:
    """Draw the signed residual with a colour bar, which has arrows where pixels lie beyond it."""
    residual = residual_of(result, image)
    mesh = ax.imshow(residual.picture, cmap=residual_colours(), vmin=-residual.limit, vmax=residual.limit)
    bar = ax.figure.colorbar(mesh, ax=ax, extend="both" if residual.extends else "neither", fraction=0.046, pad=0.03)
    bar.set_label("1/255", fontsize=8)
    bar.ax.tick_params(labelsize=7)
    bar.ax.yaxis.get_offset_text().set_fontsize(7)


def as_pixels(rgb: np.ndarray, settings: ResolvedSettings) -> np.ndarray:
    """The 8-bit pixels "height width 3" of a picture "3 height width": sRGB, or as the course stores its models'."""
    return np.moveaxis(ENCODERS[screen_transfer(settings)](rgb), 0, -1)


def residual_pixels(residual: Residual) -> np.ndarray:
    """The 8-bit pixels "height width 3" of a residual in its colours."""
    scaled = (residual.picture / residual.limit + 1) / 2
    return residual_colours()(scaled, bytes=True)[..., :3]


PANEL_SIZE = (3.3, 2.3)  # inches
PANEL_DPI = 200
LONGEST_SIDE = 1600
"""Larger pictures are reduced: a page has no room for more pixels, and a mail no patience."""

FEWEST_PIXELS = 200
"""Pictures narrower than this are shown with visible pixels rather than smoothed."""


class Embedded(NamedTuple):
    """An image of a page: its data address, its size in pixels, and whether its pixels are to stay visible."""

    address: str
    width: int
    height: int
    coarse: bool = False


def embed_pixels(pixels: np.ndarray) -> Embedded:
    """Embed an 8-bit picture "height width 3"."""
    image = Image.fromarray(np.ascontiguousarray(pixels))
    image = image.reduce(-(-max(image.size) // LONGEST_SIDE))
    file = io.BytesIO()
    image.save(file, "PNG")
    return Embedded(_address(file.getvalue()), *image.size, coarse=image.width < FEWEST_PIXELS)


def embed_panel(draw: Callable[[Axes], None]) -> Embedded:
    """Draw one panel and embed it, transparent, so that the page's own background shows."""
    figure = Figure(figsize=PANEL_SIZE, dpi=PANEL_DPI, layout="constrained")
    draw(figure.subplots())
    file = io.BytesIO()
    figure.savefig(file, format="png", transparent=True)
    width, height = (round(PANEL_DPI * inches) for inches in PANEL_SIZE)
    return Embedded(_address(file.getvalue()), width, height)


def _address(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
