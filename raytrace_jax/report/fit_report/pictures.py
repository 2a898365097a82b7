"""The pictures of a report: a residual with a scale of its own, and any of them as a PNG inside of a page."""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image

from raytrace_jax.inverse.result import FitResult
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


class Embedded(NamedTuple):
    """An image of a page: its data address, its size in pixels, and whether its pixels are to stay visible."""

    address: str
    width: int
    height: int
    coarse: bool = False


def embed(image: Image.Image, colours: int | None = None) -> Embedded:
    """Embed an 8-bit picture, in so few colours if it is one of lines."""
    # Pictures above 1600 pixels are reduced: a page has no room for more, and a mail no patience.
    image = image.reduce(-(-max(image.size) // 1600))
    image = image.quantize(colours) if colours else image
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=1)
    # Pictures below 200 pixels are shown with visible pixels rather than smoothed.
    return Embedded(data_address(file.getvalue()), *image.size, coarse=image.width < 200)
