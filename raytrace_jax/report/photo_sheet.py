"""A sheet on which each step from a photograph to an index is seen: corners, outline, light, what counts."""

import textwrap
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from ..inverse.judge.model_check import Contradiction
from ..photo.flattened import AROUND, Flattened
from ..photo.geometry import Ball
from ..photo.locate import Located, PhotoResult
from ..photo.outline import Disc
from ..photo.photograph import Corners, PixelGrid
from .fit_report.summary import estimate_line
from .panels import SIGNED, letter_panels, remove_ticks

DIRECT, THROUGH, OUTLINE, MARKER = "#1f77b4", "#d62728", "#ff9d00", "#2ca02c"


def draw_photo_sheet(
    image: Float[np.ndarray, "3 height width"],
    located: Located,
    flat: Flattened | None,
    long: bool = False,
    otherwise: Sequence[Contradiction] = (),
) -> Figure:
    """Draw a scene-linear photograph with what was found in it, and what is made of it.

    `flat` is the photograph without the light of its room, None where that could not be told. `long` writes the index
    as 1.5187 ± 0.0011 in place of 1.5187(11). `otherwise` is what the photograph contradicts.
    """
    is_ball = isinstance(located.setup.glass, Ball)
    figure = Figure(figsize=(13.0, 8.2 if flat else 4.8), dpi=130, layout="constrained")
    axes = figure.subplot_mosaic("aab;cde" if flat else "aab", width_ratios=(1, 1, 1.1))
    discs = [Disc(*located.sight.outline)] if is_ball else []
    _draw_taken(axes, image, located.direct, located.through, discs)
    direct, through = len(located.direct.pixels), len(located.through.pixels)
    axes["a"].set_title(f"{direct} corners of the board (blue), scatter {located.sigma[0]:.3f} px", fontsize=9)
    what = "glass" if is_ball else "tank"
    axes["b"].set_title(f"{through} corners through the {what} (red), scatter {located.sigma[1]:.3f} px", fontsize=9)

    if flat:
        _draw_light(axes, located, flat)
    remove_ticks(axes[name] for name in axes if name != "c")
    letter_panels(axes.values())
    title = [f"index from the corners: {estimate_line(*located.ior, long)}"]
    title += [f"contradicted: {one.words}" for one in otherwise]
    figure.suptitle("\n".join(title), fontsize=12, color="#b00020" if otherwise else "black")
    return figure


def draw_refused(image: Float[np.ndarray, "3 height width"], result: PhotoResult) -> Figure:
    """Draw a scene-linear photograph that tells no index, with what was taken for what in it, and say why."""
    figure = Figure(figsize=(13.0, 5.6), dpi=130, layout="constrained")
    axes = figure.subplot_mosaic("aab" if result.discs else "a")
    _draw_taken(axes, image, result.direct, result.through, result.discs)
    axes["a"].add_collection(PolyCollection(list(result.markers), facecolor="none", edgecolor=MARKER, linewidth=0.8))
    direct, through, count = len(result.direct.pixels), len(result.through.pixels), len(result.discs)
    words = f"{len(result.markers)} markers decoded (green), {direct} corners of the board (blue)"
    axes["a"].set_title(words, fontsize=9)
    if result.discs:
        disc = "disc" if count == 1 else f"{count} discs"
        axes["b"].set_title(f"{disc} taken for the ball, {through} corners through it (red)", fontsize=9)
    remove_ticks(axes.values())
    letter_panels(axes.values())
    figure.suptitle(textwrap.fill(result.reason, 150), fontsize=10)
    return figure


def _draw_taken(axes: dict[str, Axes], image: np.ndarray, direct: Corners, through: Corners, discs: list[Disc]) -> None:
    """The photograph with corners and outlines, whole in panel a, and around the first outline in b."""
    shown = np.moveaxis(np.clip(image / max(float(np.percentile(image, 99.5)), 1e-9), 0, 1) ** (1 / 2.2), 0, -1)
    for ax in (axes[name] for name in "ab" if name in axes):
        ax.imshow(shown)
        ax.plot(*direct.pixels.T, "+", color=DIRECT, markersize=4, markeredgewidth=0.8)
        ax.plot(*through.pixels.T, "+", color=THROUGH, markersize=5, markeredgewidth=0.9)
        for number, (center, radius) in enumerate(discs):
            style = "--" if number else "-"
            ax.add_patch(Circle(tuple(center), radius, fill=False, color=OUTLINE, linewidth=1.0, linestyle=style))
    if "b" in axes:
        center, reach = (discs[0].center, AROUND * discs[0].radius) if discs else _middle_of(through.pixels)
        seen = PixelGrid.of((image.shape[2], image.shape[1]), 1).around(center, reach).window
        axes["a"].add_patch(Rectangle(seen[:2], *seen[2:], fill=False, color=OUTLINE, linewidth=0.7, linestyle=":"))
        axes["b"].set(xlim=(seen[0], seen[0] + seen[2]), ylim=(seen[1] + seen[3], seen[1]))


def _middle_of(pixels: Float[np.ndarray, "n 2"]) -> tuple[Float[np.ndarray, "2"], float]:
    """The middle of a square with a margin around all pixels, and half its side."""
    low, high = pixels.min(axis=0), pixels.max(axis=0)
    return (low + high) / 2, 0.55 * float(np.max(high - low))


def _draw_light(axes: dict[str, Axes], located: Located, flat: Flattened) -> None:
    """The light on the board, the photograph divided by it, and what is left of that beside the board."""
    (lit, divided, rest), half = (axes[name] for name in "cde"), located.board.half
    grid = np.stack(np.meshgrid(np.linspace(-1, 1, 80), np.linspace(1, -1, 60)), -1) * half
    light = flat.field.at(grid).mean(axis=0)
    light = light / light.max()
    extent, least = (-half[0], half[0], -half[1], half[1]), float(np.floor(20 * light.min()) / 20)
    bar = lit.imshow(light, cmap="magma", vmin=least, vmax=1, extent=extent)
    levels = np.linspace(least, 1, 11)[1:-1]
    lit.contour(grid[..., 0], grid[..., 1], light, levels, colors="white", linewidths=0.6)
    lit.figure.colorbar(bar, ax=lit, shrink=0.6)
    lit.set_title(f"light on the board, of its largest; {100 * flat.field.rest:.2g} % is left", fontsize=9)
    grey = np.full(flat.image.shape, 0.5)
    divided.imshow(np.moveaxis(np.clip(np.where(flat.counts, flat.image, grey), 0, 1), 0, -1))
    divided.set_title("divided by it; grey does not count", fontsize=9)
    off = np.where(flat.counts, (flat.image - flat.drawn).mean(axis=0), np.nan)
    bar = rest.imshow(off, cmap=SIGNED, vmin=-0.3, vmax=0.3)
    rest.figure.colorbar(bar, ax=rest, shrink=0.8)
    rest.set_title("photograph − board, without the camera's blur", fontsize=9)
