"""Lessons on derivatives with pictures of a small scene and errors of its index, and the list of all lessons."""

import importlib.resources
from collections.abc import Callable, Iterable

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from ...images.filters import gaussian_blur
from ...scene.parameters import set_parameters
from ...scene.reader import parse_scene
from ...scene.scene import Scene
from ...tracer.rendering import picture_derivatives, render
from ...tracer.settings import RenderSettings
from .. import LessonName
from ..differences import correlation, finite_differences, relative_error
from ..panels import SIGNED, as_pixels, page_template, remove_ticks
from . import formulas
from .formulas import COLOURS, INDEX, finish, make_figure


def read_balls() -> Scene:
    text = importlib.resources.files("raytrace_jax.report.lessons").joinpath("balls.txt").read_text(encoding="utf-8")
    return parse_scene(text)


def draw_edges(size: tuple[int, int] = (160, 120), samples: int = 8) -> Figure:
    """The picture, and for each of two numbers three derivative pictures, the mean over R, G and B.

    The finite differences are of pictures with `samples` x `samples` rays a pixel.
    """
    scene, names, step = read_balls(), ("glass.center.x", "glass.ior"), 0.006
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


def draw_cost(size: tuple[int, int] = (160, 120), count: int = 121) -> Figure:
    """The target, a picture with another index, the cost against the index, and its derivative.

    Of the `count` indices from 1 to 2.2 one is 1.5 where there are 12 k + 1.
    """
    scene, settings = read_balls(), RenderSettings(size=size, max_bounces=2)

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
    finish(cost, "cost", "index of refraction n", "mean squared error [share of its largest]")
    finish(slope, "its slope: a descent goes against it", "index of refraction n", "slope [per unit of index]")
    return figure


LESSONS: dict[LessonName, Callable[[], Figure]] = {
    "snell": formulas.draw_snell,
    "fresnel": formulas.draw_fresnel,
    "critical": formulas.draw_critical,
    "ball": formulas.draw_ball,
    "total_reflection": formulas.draw_total_reflection,
    "edges": draw_edges,
    "cost": draw_cost,
}
"""What draws each lesson, in the order in which they build on each other."""


def index_page(names: Iterable[str]) -> str:
    """A Markdown page with a heading, the figure `NAME.png` and a paragraph for each of some lessons."""
    return page_template("report/lessons/index.md.jinja").render(names=set(names))
