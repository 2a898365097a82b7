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
    limit = float(np.quantile(sizes, 0.995)) or float(sizes.max()) or 1.0
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
    return Embedded(_address(file.getvalue()), *image.size, coarse=image.width < 200)


def embed_panel(draw: Callable[[Axes], None]) -> Embedded:
    """Draw one panel and embed it, transparent, so that the page's own background shows."""
    size, dots = (3.3, 2.3), 200  # Inches, and dots in each.
    figure = Figure(figsize=size, dpi=dots, layout="constrained")
    draw(figure.subplots())
    file = io.BytesIO()
    figure.savefig(file, format="png", transparent=True)
    width, height = (round(dots * inches) for inches in size)
    return Embedded(_address(file.getvalue()), width, height)


def _address(png: bytes) -> str:
    return "data:image/png;base64," + base64.b64encode(png).decode("ascii")
