"""A sheet of a picture's derivatives, one signed panel for each parameter, and their check by finite differences."""

import math
from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..images import Transfer
from ..tracer.rendering import PictureDerivatives
from ..util.numerics import on_host
from .differences import correlation, relative_error
from .panels import as_pixels, draw_signed_values, drawable, panel_bands

Verdict = Literal["agree", "agree but for pixels", "disagree", "undecided"]


class DerivativeCheck(NamedTuple):
    """The comparison of a derivative picture with differences."""

    verdict: Verdict
    error: float  # The relative L2 error.
    correlation: float
    spread: float  # About the error of the differences themselves.
    exceptions: int  # How many pixels are left out for the rest to agree.
    worst: str  # The pixel that adds most to the error, in words.

    @property
    def words(self) -> str:
        """The verdict and its reason in a sentence."""
        if self.verdict == "agree":
            return f"agree, to {self.error:.2g} of the norm; the differences by two steps to {self.spread:.2g}"
        if self.verdict == "agree but for pixels":
            return f"agree but for {self.exceptions} pixel{'s' * (self.exceptions > 1)}: {self.worst}"
        if self.verdict == "disagree":
            return f"disagree, by {self.error:.2g} of the norm: {self.worst}"
        return (
            f"undecided: differences by two steps are {self.spread:.2g} of their norm apart, too coarse to judge by; "
            "try more --check-samples, or another --check-step"
        )


def check_derivative(
    derivative: Float[np.ndarray, "3 height width"],
    difference: Float[np.ndarray, "3 height width"],
    spread: float,
    origin: tuple[int, int] = (0, 0),
) -> DerivativeCheck:
    """Compare a derivative picture with finite differences.

    Args:
        spread: about the relative L2 error of the differences.
        origin: column and row of the first pixel in the whole picture.
    """
    # The largest relative L2 error of a derivative that agrees. One edge-aware sample a pixel is that good on all of 52
    # pictures of random sizes (experiments/edge_gradients).
    largest_error = 0.4
    # How far the two are apart, in the whole picture and in each pixel.
    derivative, difference = on_host(derivative), on_host(difference)
    error = relative_error(derivative, difference)
    squares, errors = np.sum(derivative**2, axis=0), np.sum((derivative - difference) ** 2, axis=0)
    depends = int(np.count_nonzero(squares + errors))
    # The exceptions are left out, the worst first, until the rest agrees: what is left when k = 0, 1, ... are out.
    expected, worst_first = np.sum(difference**2, axis=0), np.argsort(-errors, axis=None, kind="stable")
    left_errors, left_expected = (
        np.append(np.cumsum(values.ravel()[worst_first][::-1])[::-1], 0.0) for values in (errors, expected)
    )
    exceptions = int(np.argmax(left_errors <= largest_error**2 * left_expected))

    # A single pixel decides if it holds a tenth of the squared norm, is off by more than half of itself, and by more
    # than the differences' own error in the whole picture, which may all lie in it.
    outstanding = (squares > 0.1 * np.sum(squares)) & (errors > 0.5**2 * squares)
    outstanding &= errors > spread**2 * np.sum(expected)

    # The words name the pixel that adds most to the error.
    row, column = np.unravel_index(np.argmax(errors), errors.shape)
    here, there = derivative[:, row, column], difference[:, row, column]
    channel = int(np.argmax(np.abs(here - there)))
    fraction = float(squares[row, column] / max(np.sum(squares), np.finfo(float).tiny))
    worst = f"pixel ({origin[0] + column}, {origin[1] + row}) holds {100 * fraction:.0f} % of the squared norm"
    worst += f", {'RGB'[channel]} {here[channel]:.3g} where the difference says {there[channel]:.3g}"

    # Differences that are themselves uncertain prove nothing. Wrong pixels are exceptions up to 0.5 % of those that
    # depend on the parameter, and a disagreement beyond.
    verdict: Verdict
    if spread <= largest_error and (outstanding.any() or exceptions == 0):
        verdict = "disagree" if outstanding.any() else "agree"
    elif error <= 2 * spread:
        verdict = "undecided"
    else:
        verdict = "agree but for pixels" if exceptions <= max(1, 0.005 * depends) else "disagree"
    return DerivativeCheck(verdict, error, correlation(derivative, difference), spread, exceptions, worst)


def draw_gradients(
    found: PictureDerivatives,
    differences: np.ndarray | None = None,
    caption: str = "",
    verdicts: Sequence[str] = (),
    origin: tuple[int, int] = (0, 0),
    transfer: Transfer = "course",
) -> Figure:
    """Draw the picture and, for each parameter, the mean over R, G and B of the derivative, symmetric about zero.

    Finite differences, "parameters 3 height width", are drawn below their derivatives in the same colours, with the
    derivatives' relative errors and correlations and the `verdicts`; below the picture stands their `caption`. `origin`
    is column and row of the first pixel in the whole picture.
    """
    # Room for each panel in inches, with its title, its caption and the words on how they agree. A place has one panel,
    # or two: the derivative above, the difference below. Rows are as long as make the sheet most like a slide, 16 : 9.
    _, height, width = found.image.shape
    panels = 1 + len(found.names)
    rows_each = 1 if differences is None else 2
    panel_height = min(6.0, max(1.2, 3.2 * height / width))
    band_height = rows_each * (panel_height + 1.1) + 0.6 * (rows_each - 1)

    def unlike_slide(columns: int) -> float:
        return abs(math.log(4.0 * columns / (band_height * math.ceil(panels / columns)) / (16 / 9)))

    columns = min(range(1, panels + 1), key=unlike_slide)
    figure, axes = panel_bands(panels, columns, rows_each, 4.0, band_height)
    axes[0, 0].imshow(as_pixels(found.image, transfer))
    axes[0, 0].set_title("picture", fontsize=11)
    if differences is not None:
        axes[0, 1].text(0.5, 0.5, caption, ha="center", va="center", fontsize=9, color="0.35")
        axes[0, 1].set_axis_off()

    # A derivative and its difference share one colour scale, so that eyes can compare them.
    for k, (name, unit, derivative) in enumerate(zip(found.names, found.units, np.asarray(found.values), strict=True)):
        above, *below = axes[1 + k]
        limit = scale_limit(derivative) or (scale_limit(differences[k]) if differences is not None else 0) or 1.0
        draw_signed(above, derivative, limit, unit, drawable(f"d.{name}", 34), origin)
        if differences is not None:
            error, agreement = (f(derivative, differences[k]) for f in (relative_error, correlation))
            words = f"relative L2 error {error:.3g}", f"correlation {agreement:.3f}".replace("-", "−")
            title = "\n".join(["finite difference", *words, *verdicts[k : k + 1]])
            draw_signed(below[0], differences[k], limit, unit, title, origin)
    return figure


def scale_limit(derivative: np.ndarray) -> float:
    """The end of the colour scale: below it lie 99.5 % of the pixels that depend on the parameter; 0 if none does."""
    size = np.abs(derivative.mean(axis=0))
    size = size[size > 0]
    return float(np.quantile(size, 0.995)) if size.size else 0.0


def draw_signed(
    ax: Axes, derivative: np.ndarray, limit: float, unit: str, title: str, origin: tuple[int, int] = (0, 0)
) -> None:
    """Draw a derivative as its mean over the channels, blue where the picture darkens and red where it brightens.

    A few pixels at edges must not hide all the rest; but they may be what the derivative is made of: it is said how
    many lie beyond the colour scale, and how much of the squared norm is theirs where that is a good part.
    """
    mean = derivative.mean(axis=0)
    squares, beyond, said = mean**2, np.abs(mean) > limit, [f"mean of R, G, B per {unit}"]
    if beyond.any():
        said.append(f"{100 * np.mean(beyond[mean != 0]):.1g} % of its pixels are off the scale")
        if (fraction := squares[beyond].sum() / squares.sum()) >= 0.25:
            said.append(f"and make {100 * fraction:.0f} % of its sum of squares")
        row, column = np.unravel_index(np.argmax(squares), squares.shape)
        if (largest := squares[row, column] / squares.sum()) >= 0.1:
            said.append(f"({100 * largest:.0f} % pixel {origin[0] + column}, {origin[1] + row} alone)")
    ax.set_title(title, fontsize=11)
    ax.set_xlabel("\n".join(said), fontsize=9)
    draw_signed_values(ax, mean, limit, bool(beyond.any()), "")
