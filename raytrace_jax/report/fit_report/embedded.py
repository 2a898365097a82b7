"""Pictures and panels as PNGs inside of a page, so that the page is one file."""

import base64
import io
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from PIL import Image

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
    image.save(file, "PNG", optimize=True)
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
