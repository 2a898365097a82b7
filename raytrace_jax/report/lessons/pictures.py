"""Lessons on derivatives with pictures of a small scene and errors of its index, and the list of all lessons."""

from collections.abc import Callable, Iterable
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.images.filters import gaussian_blur
from raytrace_jax.report.lessons import formulas
from raytrace_jax.report.lessons.formulas import COLOURS, INDEX, label, legend, make_figure
from raytrace_jax.report.panels import SIGNED, as_pixels, remove_ticks
from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.scene.reader import parse_scene
from raytrace_jax.tracer.derivatives import correlation, finite_differences, picture_derivatives, relative_error
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.settings import RenderSettings

BALLS = {
    "red": (-0.6, -0.8, (15, 1, 1)),
    "yellow": (4.2, -1.6, (14, 11, 1)),
    "lime": (9.0, -0.4, (5, 14, 1)),
    "orange": (-1.4, 3.4, (15, 6, 0)),
    "white": (4.4, 3.2, (13, 13, 13)),
    "violet": (9.2, 3.9, (8, 1, 15)),
    "cyan": (-0.2, 7.6, (0, 12, 13)),
    "pink": (3.9, 8.0, (16, 5, 9)),
    "blue": (8.4, 7.3, (1, 3, 17)),
}
"""Matt balls behind the glass: their x and y in world units, and their ambient colour, which falls off with the length
of the path (about 20 world units)."""


def scene_text() -> str:
    """The text of a scene's file, whose ball of glass is called `glass`."""
    blocks = [
        "camera eye { pixeldim 160 120 worlddim 8 6 viewpoint 4 3 8 }",
        "light left { location 1 7 4 emissivity 0.7 0.7 0.7 }",
        f"material clear {{ ambient 0.2 0.4 0.5 specular 0.1 0.1 0.1 alpha 0.95 ior {INDEX} }}",
        "material wall { ambient 4 4.6 5.8 diffuse 0.2 0.2 0.3 }",
        "plane back { material wall normal 0 0 1 point 0 0 -14 }",
    ]
    for name, (x, y, (red, green, blue)) in BALLS.items():
        blocks.append(f"material {name}paint {{ ambient {red} {green} {blue} diffuse 0.3 0.3 0.3 }}")
        blocks.append(f"sphere {name} {{ material {name}paint center {x} {y} -11 radius 1.4 }}")
    return "\n".join([*blocks, "sphere glass { material clear center 4 3 -1.5 radius 2.2 }"])


EDGES = """The same picture, differentiated three times by two numbers: where the ball is, and its index. A tracer that
shoots one ray through each pixel's middle differentiates the colour at that point. The change at an edge that moves
across the pixel is not part of it: the rims of the ball and of all that is seen through it are missing. The edge-aware
derivative has them, and agrees with the finite difference of supersampled pictures, which needs no theory but hundreds
of rays a pixel. An optimiser that is given the first one walks in a wrong direction."""


def draw_edges(size: tuple[int, int] = (160, 120), samples: int = 8) -> Figure:
    """The picture, and for each of two numbers three derivative pictures, the mean over R, G and B.

    The finite differences are of pictures with `samples` x `samples` rays a pixel.
    """
    scene, names, step = parse_scene(scene_text()), ("glass.center.x", "glass.ior"), 0.006
    point, aware = (RenderSettings(size=size, max_bounces=2, edges=edges) for edges in ("point", "aware"))
    missing, seen = (picture_derivatives(scene, names, settings) for settings in (point, aware))
    differences = finite_differences(scene, names, point, step, samples)

    figure, axes = make_figure("A point does not see an edge move", len(names), 4, (15, 6.6))
    for row, (name, unit) in enumerate(zip(names, seen.units, strict=True)):
        picture, *panels = axes[4 * row : 4 * row + 4]
        image, title = (seen.image, "edge-aware picture") if row else (missing.image, "point-sampled picture")
        picture.imshow(as_pixels(image, "course"))
        picture.set_title(title, fontsize=10)
        columns = {"point-sampled": missing.values, "edge-aware": seen.values, "finite difference": differences}
        limit = float(np.quantile(np.abs(differences[row].mean(axis=0)), 0.985))
        for ax, (title, values) in zip(panels, ((kind, each[row]) for kind, each in columns.items()), strict=True):
            ax.imshow(values.mean(axis=0), cmap=SIGNED, vmin=-limit, vmax=limit)
            ax.set_title(f"d/d {name}: {title}", fontsize=10)
            error, agreement = relative_error(values, differences[row]), correlation(values, differences[row])
            ax.set_xlabel(f"error {100 * error:.0f} %, correlation {agreement:.2f}", fontsize=10)
        panels[-1].set_xlabel(f"{samples} × {samples} rays a pixel, step ±{step:g}", fontsize=10)
        bar = figure.colorbar(panels[0].images[0], ax=panels, extend="both", fraction=0.02, pad=0.01)
        bar.set_label(f"change of the colour\nper {unit}")
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(True)
    remove_ticks(axes)
    return figure


COST = """A picture of a glass ball of index 1.5, and how far pictures with another index are from it. Close to the
true index the cost of the sharp picture has a kink. The strips between the edges of the two pictures widen with the
error of the index, so that the slope jumps and does not tell the remaining distance. Far above the true index the cost
is almost flat, since what is seen through the ball no longer overlaps with what should be there. A blur rounds the
bottom to a parabola, which suits least-squares steps, and keeps a slope farther out: so a fit goes from coarse to fine.
No blur removes the second minimum near n = 1. There the ball is almost invisible, and that is nearer to the target than
a ball with a wrong picture in it. So a fit also scans for starts."""


def draw_cost(size: tuple[int, int] = (160, 120), count: int = 121) -> Figure:
    """The target, a picture with another index, the cost against the index, and its derivative.

    Of the `count` indices from 1 to 2.2 one is 1.5 where there are 12 k + 1.
    """
    scene, settings = parse_scene(scene_text()), RenderSettings(size=size, max_bounces=2)

    def picture(index: float) -> np.ndarray:
        return np.asarray(render(set_parameters(scene, {"glass.ior": index}), settings).image)

    target = picture(INDEX)
    indices = np.linspace(1.0, 2.2, count)
    images = [picture(float(index)) for index in indices]
    figure, axes = make_figure("What a search for the index walks on", 2, 2, (11, 8))
    shown, other, cost, slope = axes
    for ax, image, title in ((shown, target, f"the target, n = {INDEX:g}"), (other, images[-1], "n = 2.2")):
        ax.imshow(as_pixels(image, "course"))
        ax.set_title(title, fontsize=11)
    remove_ticks((shown, other))
    for sigma, color in zip((0.0, 2.0, 6.0), COLOURS, strict=False):
        name = f"blurred, σ = {sigma:g} pixels" if sigma else "sharp"
        errors = (gaussian_blur(jnp.asarray(image - target), jnp.asarray(sigma)) for image in images)
        values = np.array([float(jnp.mean(error**2)) for error in errors])
        cost.plot(indices, values / values.max(), color=color, label=name)
        slope.plot(indices, np.gradient(values / values.max(), indices), color=color, label=name)
    slope.axhline(0, color="0.4", linewidth=0.8)
    for ax in (cost, slope):
        ax.axvline(INDEX, color="0.6", linewidth=0.8, linestyle="--", label="the truth")
        legend(ax)
    label(cost, "cost", "index of refraction n", "mean squared error [share of its largest]")
    label(slope, "its slope: a descent goes against it", "index of refraction n", "slope [per unit of index]")
    return figure


class Lesson(NamedTuple):
    """A figure, its heading, and a paragraph of Markdown on what it shows."""

    title: str
    text: str
    draw: Callable[[], Figure]


LESSONS = {
    "snell": Lesson("Snell's law and its gradient", formulas.SNELL, formulas.draw_snell),
    "fresnel": Lesson("Fresnel and Schlick", formulas.FRESNEL, formulas.draw_fresnel),
    "critical": Lesson("The critical angle", formulas.CRITICAL, formulas.draw_critical),
    "ball": Lesson("A ray through a ball", formulas.BALL, formulas.draw_ball),
    "total_reflection": Lesson(
        "Total internal reflection, as automatic differentiation sees it",
        formulas.TOTAL_REFLECTION,
        formulas.draw_total_reflection,
    ),
    "edges": Lesson("A point does not see an edge move", EDGES, draw_edges),
    "cost": Lesson("What a search for the index walks on", COST, draw_cost),
}
"""Lessons by their names, in the order in which they build on each other."""


def index_page(names: Iterable[str]) -> str:
    """A Markdown page with a heading, the figure `NAME.png` and a paragraph for each of some lessons."""
    parts = ["# Refraction and its derivatives", "Made by `raytrace-jax teach`; angles are counted from the normal."]
    for name in names:
        lesson = LESSONS[name]
        parts += [f"## {lesson.title}", f"![{lesson.title}]({name}.png)", lesson.text]
    return "\n\n".join(parts) + "\n"
