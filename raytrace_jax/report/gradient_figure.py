"""The sheet of a picture's derivatives: one signed panel for each parameter, with finite differences below if asked."""

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from raytrace_jax.images.options import Transfer
from raytrace_jax.report.derivative_check import PIXEL_SHARE
from raytrace_jax.report.fit_report.text import drawable
from raytrace_jax.report.panels import as_pixels, draw_signed_values, remove_ticks
from raytrace_jax.tracer.derivatives import PictureDerivatives, correlation, relative_error

CELL = 3.0  # inches
LONGEST_NAME = 34


def draw_gradients(
    found: PictureDerivatives,
    differences: np.ndarray | None = None,
    caption: str = "",
    verdicts: Sequence[str] = (),
    origin: tuple[int, int] = (0, 0),
    transfer: Transfer = "course",
) -> Figure:
    """Draw the picture and, for each parameter, the mean over R, G and B of the derivative, symmetric about zero.

    Args:
        found: the picture and its derivatives.
        differences: finite differences, "parameters 3 height width": each is drawn below its derivative in the same
            colours, with the derivative's relative error and correlation.
        caption: how the differences were made, put below the picture.
        verdicts: for each parameter what to say about its differences besides.
        origin: column and row of the first pixel in the whole picture.
        transfer: how the picture is shown: `course` without a gamma, `srgb` as screens expect it.
    """
    # Room for each panel in inches: at most five in a row, with their titles and the words on how they agree.
    _, height, width = found.image.shape
    panels = 1 + len(found.names)
    bands = math.ceil(panels / 5)
    columns = math.ceil(panels / bands)
    rows_each = 1 if differences is None else 2
    panel_height = min(6.0, max(1.2, 0.7 * CELL * height / width))
    band_height = rows_each * panel_height + 0.35 + (0.85 if rows_each == 2 else 0)
    figure = Figure(figsize=(CELL * columns, band_height * bands), dpi=150, layout="constrained")

    # A band has one row of panels, or two: derivatives above, differences below.
    axes = figure.subplots(bands * rows_each, columns, squeeze=False)
    axes = axes.reshape(bands, rows_each, columns).swapaxes(1, 2).reshape(bands * columns, rows_each)
    axes[0, 0].imshow(as_pixels(found.image, transfer))
    axes[0, 0].set_title("picture", fontsize=9)
    if differences is not None:
        axes[0, 1].text(0.5, 0.5, caption, ha="center", va="center", fontsize=8, color="0.35")
        axes[0, 1].set_axis_off()

    # A derivative and its difference share one colour scale, so that eyes can compare them.
    for number, (name, unit) in enumerate(zip(found.names, found.units, strict=True)):
        above, *below = axes[1 + number]
        derivative = np.asarray(found.values[number])
        limit = scale_limit(derivative) or (scale_limit(differences[number]) if differences is not None else 0) or 1.0
        draw_signed(above, derivative, limit, unit, drawable(f"d.{name}", LONGEST_NAME), origin)
        if below and differences is not None:
            title = "\n".join([_agreement(derivative, differences[number]), *verdicts[number : number + 1]])
            draw_signed(below[0], differences[number], limit, unit, title, origin)
    remove_ticks(axes.ravel())
    for ax in axes[panels:].ravel():
        ax.set_visible(False)
    return figure


def scale_limit(derivative: np.ndarray) -> float:
    """The end of the colour scale: below it lie 99.5 % of the pixels that depend on the parameter; 0 if none does."""
    size = np.abs(derivative.mean(axis=0))
    size = size[size > 0]
    return float(np.quantile(size, 0.995)) if size.size else 0.0


def draw_signed(
    ax: Axes, derivative: np.ndarray, limit: float, unit: str, title: str, origin: tuple[int, int] = (0, 0)
) -> None:
    """Draw a derivative as its mean over the channels, blue where the picture darkens and red where it brightens."""
    mean = derivative.mean(axis=0)
    beyond = _beyond(mean, limit, origin)
    ax.set_title(title, fontsize=9)
    draw_signed_values(ax, mean, limit, bool(beyond), "\n".join([f"mean of R, G, B per {unit}", *beyond]))


def _beyond(mean: np.ndarray, limit: float, origin: tuple[int, int]) -> list[str]:
    """What to say of the pixels beyond the colour scale: how many they are, and how much of the squared norm is theirs.

    A few pixels at edges must not hide all the rest; but they may be what the derivative is made of.
    """
    squares, clipped = mean**2, np.abs(mean) > limit
    if not clipped.any():
        return []
    said = [f"{100 * np.mean(clipped[mean != 0]):.1g} % of its pixels are off the scale"]
    share = squares[clipped].sum() / squares.sum()
    # Pixels beyond the scale are told of where they hold a good part.
    if share >= 0.25:
        said.append(f"and make {100 * share:.0f} % of its sum of squares")
    row, column = np.unravel_index(np.argmax(squares), squares.shape)
    largest = squares[row, column] / squares.sum()
    if largest >= PIXEL_SHARE:
        said.append(f"({100 * largest:.0f} % pixel {origin[0] + column}, {origin[1] + row} alone)")
    return said


def _agreement(derivative: np.ndarray, difference: np.ndarray) -> str:
    error, agreement = relative_error(derivative, difference), correlation(derivative, difference)
    return f"finite difference\nrelative L2 error {error:.3g}\ncorrelation {agreement:.3f}".replace("-", "−")
