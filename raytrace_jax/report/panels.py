"""What figures and pages share: pixels for a screen, signed colours with their scale, letters of panels, templates."""

import base64
import io
import itertools
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from string import ascii_lowercase
from typing import Any

import jinja2
import matplotlib
import numpy as np
from jax.typing import ArrayLike
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties, findfont, get_font
from PIL import Image

from ..images import Transfer
from ..images.transfer import ENCODERS
from ..util.files import atomic_write

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
    # Numbers below a tenth are written with a power of ten above the bar: else they push its label off the sheet.
    bar.formatter.set_powerlimits((-1, 3))  # pyright: ignore[reportAttributeAccessIssue]
    bar.ax.tick_params(labelsize=7)
    bar.ax.yaxis.get_offset_text().set_fontsize(7)


def remove_ticks(axes: Iterable[Axes]) -> None:
    """Take the ticks off axes that show pictures."""
    for ax in axes:
        ax.set(xticks=[], yticks=[])


def panel_bands(count: int, columns: int, rows_each: int, width: float, height: float) -> tuple[Figure, np.ndarray]:
    """A figure of `count` places in rows of `columns`, each of `rows_each` panels below each other, without ticks.

    A place has `width` and `height` in inches. Returned are the figure and its panels, "count rows_each".
    """
    bands = -(-count // columns)
    figure = Figure(figsize=(width * columns, height * bands), dpi=150, layout="constrained")
    axes = figure.subplots(bands * rows_each, columns, squeeze=False)
    remove_ticks(axes.ravel())
    places = axes.reshape(bands, rows_each, columns).swapaxes(1, 2).reshape(bands * columns, rows_each)
    for ax in places[count:].ravel():
        ax.set_visible(False)
    return figure, places[:count]


def page_template(name: str, filters: Mapping[str, Callable[..., Any]] | None = None) -> jinja2.Template:
    """The template in a file of `raytrace_jax`, as `batch/index.html.jinja`; text is escaped.

    A name that is not defined is an error.
    """
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("raytrace_jax", ""),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= filters or {}
    return environment.get_template(name)


def save_figure(path: Path, figure: Figure, **how: Any) -> None:
    """Write a figure as `atomic_write` does, by the suffix of its path; `how` is as matplotlib takes it."""
    with atomic_write(path) as temporary:
        figure.savefig(temporary, **how)


def png_bytes(image: Image.Image) -> bytes:
    """The bytes of a PNG file of a picture, made quickly."""
    file = io.BytesIO()
    image.save(file, "PNG", compress_level=1)
    return file.getvalue()


def data_address(body: bytes, media: str = "image/png") -> str:
    """A `data:` URL of some bytes, for a page that needs no other file."""
    return f"data:{media};base64,{base64.b64encode(body).decode()}"


def drawable(name: str, longest: int) -> str:
    """Shorten a name in its middle, and replace what the figures' font has no sign for (a warning otherwise)."""
    font = get_font(findfont(FontProperties()))
    shown = "".join(sign if font.get_char_index(ord(sign)) else "?" for sign in name)
    return shown if len(shown) <= longest else f"{shown[: longest // 2]}…{shown[-longest // 2 :]}"


def letter_panels(axes: Iterable[Axes]) -> None:
    """Put (a), (b), (c) and so on before the titles of the panels that have one and are seen."""
    names = map("".join, itertools.product(["", *ascii_lowercase], ascii_lowercase))
    for ax in axes:
        if ax.get_visible() and ax.get_title():
            ax.title.set_text(f"({next(names)}) {ax.get_title()}")
