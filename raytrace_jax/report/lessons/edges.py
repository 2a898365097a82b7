"""The derivative that a point-sampled tracer gives, beside the edge-aware one and the finite difference."""

import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.report.lessons.plotting import make_figure
from raytrace_jax.report.lessons.small_scene import small_scene
from raytrace_jax.report.panels import SIGNED, as_pixels, remove_ticks
from raytrace_jax.tracer.derivatives import correlation, finite_differences, picture_derivatives, relative_error
from raytrace_jax.tracer.settings import RenderSettings

TEXT = """The same picture, differentiated three times by two numbers: where the ball is, and its index. A tracer that
shoots one ray through each pixel's middle differentiates the colour at that point. The change at an edge that moves
across the pixel is not part of it: the rims of the ball and of all that is seen through it are missing. The edge-aware
derivative has them, and agrees with the finite difference of supersampled pictures, which needs no theory but hundreds
of rays a pixel. An optimiser that is given the first one walks in a wrong direction."""

NAMES = ("glass.center.x", "glass.ior")
STEP = 0.006


def draw_edges(size: tuple[int, int] = (160, 120), samples: int = 8) -> Figure:
    """The picture, and for each of two numbers three derivative pictures, the mean over R, G and B.

    Args:
        size: width and height of the pictures in pixels.
        samples: the finite differences are of pictures with `samples` x `samples` rays a pixel.
    """
    scene = small_scene()
    point, aware = (RenderSettings(size=size, max_bounces=2, edges=edges) for edges in ("point", "aware"))
    missing, seen = (picture_derivatives(scene, NAMES, settings) for settings in (point, aware))
    differences = finite_differences(scene, NAMES, point, STEP, samples)

    figure, axes = make_figure("A point does not see an edge move", len(NAMES), 4, (15, 6.6))
    for row, (name, unit) in enumerate(zip(NAMES, seen.units, strict=True)):
        picture, *panels = axes[4 * row : 4 * row + 4]
        image, title = (seen.image, "edge-aware picture") if row else (missing.image, "point-sampled picture")
        picture.imshow(as_pixels(image, "course"))
        picture.set_title(title, fontsize=10)
        columns = {
            "point-sampled": missing.values[row],
            "edge-aware": seen.values[row],
            "finite difference": differences[row],
        }
        limit = float(np.quantile(np.abs(differences[row].mean(axis=0)), 0.985))
        for ax, (title, values) in zip(panels, columns.items(), strict=True):
            ax.imshow(values.mean(axis=0), cmap=SIGNED, vmin=-limit, vmax=limit)
            ax.set_title(f"d/d {name}: {title}", fontsize=10)
            error, agreement = relative_error(values, differences[row]), correlation(values, differences[row])
            ax.set_xlabel(f"error {100 * error:.0f} %, correlation {agreement:.2f}", fontsize=10)
        panels[-1].set_xlabel(f"{samples} × {samples} rays a pixel, step ±{STEP:g}", fontsize=10)
        bar = figure.colorbar(panels[0].images[0], ax=panels, extend="both", fraction=0.02, pad=0.01)
        bar.set_label(f"change of the colour\nper {unit}")
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(True)
    remove_ticks(axes)
    return figure
