"""Lessons on derivatives with pictures of a small scene and errors of its index, and the list of all lessons."""

import dataclasses
import importlib.resources
from collections.abc import Callable, Iterable

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ...images.filters import gaussian_blur
from ...optics.dispersion import CHANNEL_WAVELENGTHS, LINES, Numbers, abbe_number, formula_index
from ...scene.parameters import set_parameters
from ...scene.reader import parse_scene
from ...scene.scene import Scene
from ...tracer.rendering import picture_derivatives, render
from ...tracer.settings import RenderSettings
from .. import LessonName
from ..differences import correlation, finite_differences, relative_error
from ..panels import SIGNED, as_pixels, page_template, remove_ticks
from . import bodies, formulas
from .formulas import COLOURS, INDEX, RED, empty_figure, finish, make_figure


def read_lesson(name: str) -> Scene:
    file = importlib.resources.files("raytrace_jax.report.lessons") / name
    return parse_scene(file.read_text(encoding="utf-8"))


def draw_edges(size: tuple[int, int] = (160, 120), samples: int = 8) -> Figure:
    """The picture, and for each of two numbers three derivative pictures, the mean over R, G and B.

    The finite differences are of pictures with `samples` x `samples` rays a pixel.
    """
    scene, names, step = read_lesson("balls.txt"), ("glass.center.x", "glass.ior"), 0.006
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
    scene, settings = read_lesson("balls.txt"), RenderSettings(size=size, max_bounces=2)

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


SCHOTT = {
    "N-FK51A": (0.971247817, 0.00472301995, 0.216901417, 0.0153575612, 0.904651666, 168.68133),
    "N-BK7": (1.03961212, 0.00600069867, 0.231792344, 0.0200179144, 1.01046945, 103.560653),
    "N-BAK4": (1.28834642, 0.00779980626, 0.132817724, 0.0315631177, 0.945395373, 105.965875),
    "F2": (1.34533359, 0.00997743871, 0.209073176, 0.0470450767, 0.937357162, 111.886764),
    "N-SF11": (1.73759695, 0.013188707, 0.313747346, 0.0623068142, 1.89878101, 155.23629),
}
"""Sellmeier's coefficients B1, C1, B2, C2, B3, C3 of five glasses, C in square micrometres: Schott's data sheets."""


def schott_index(name: str, wavelength: Numbers) -> np.ndarray:
    """The index of a glass of `SCHOTT` at wavelengths in nanometres."""
    return formula_index(2, (0.0, *SCHOTT[name]), wavelength)


def draw_dispersion(size: int = 240, zoom: int = 5) -> Figure:
    """Index against wavelength of five glasses; a ball of the last one, without and with its dispersion, and its rim.

    Pictures have `size` x `size` pixels; that of the rim shows a `zoom`-th of the ball's.
    """
    figure = empty_figure("Dispersion: an index for each colour", (15, 8))
    curves, *shown = figure.subplot_mosaic("cab;cde", width_ratios=(1.35, 1, 1)).values()
    _draw_indices(curves)
    name = "N-SF11"
    by_channel = schott_index(name, CHANNEL_WAVELENGTHS)
    scene, corner = read_lesson("rim.txt"), np.array([0.66, 0.12])  # Of the enlarged part, in widths of the picture.
    settings = RenderSettings(size=(size, size), edges="aware")
    x, y = map(int, corner * zoom * size)
    near = dataclasses.replace(settings, size=(zoom * size, zoom * size), crop=(x, y, size, size))
    balls = {
        f"one index, {by_channel[1]:.4f}": (by_channel[1],) * 3,
        f"{name}: red {by_channel[0]:.4f}, blue {by_channel[2]:.4f}": by_channel,
    }
    for (whole, rim), (title, ior) in zip((shown[:2], shown[2:]), balls.items(), strict=True):
        ball = set_parameters(scene, {f"glass.ior.{channel}": float(n) for channel, n in zip("rgb", ior, strict=True)})
        for ax, wanted in ((whole, settings), (rim, near)):
            ax.imshow(as_pixels(render(ball, wanted).image, "srgb"), interpolation="nearest")
        whole.set_title(title, fontsize=11)
        rim.set_title("its rim", fontsize=11)
        whole.add_patch(Rectangle(tuple(corner * size), size / zoom, size / zoom, fill=False, edgecolor=RED))
        rim.spines[:].set_color(RED)
    remove_ticks(shown)
    return figure


def _draw_indices(ax: Axes) -> None:
    """The index of the glasses against the wavelength, with the lines F, d, C and the channels' wavelengths."""
    x = np.linspace(400, 700, 301)
    for name, color in zip(SCHOTT, (*COLOURS, RED), strict=True):
        n_d, n_f, n_c = (float(n) for n in schott_index(name, LINES))
        label = f"{name}: {n_d:.4f}, {abbe_number(n_d, n_f, n_c):.1f}"
        ax.plot(x, schott_index(name, x), color=color, label=label)
        ax.plot(LINES, (n_d, n_f, n_c), "o", color=color, markersize=4)
    top = {"transform": ax.get_xaxis_transform(), "ha": "center", "fontsize": 9}
    for letter, wavelength in zip("dFC", LINES, strict=True):
        ax.axvline(wavelength, color="0.5", linewidth=0.8, linestyle=":")
        ax.text(wavelength, 1.005, letter, **top)
    for channel, wavelength, color in zip(("red", "green", "blue"), CHANNEL_WAVELENGTHS, "rgb", strict=True):
        ax.axvspan(wavelength - 2, wavelength + 2, color=color, alpha=0.18, linewidth=0)
        ax.text(wavelength, 0.012, f"{channel}\n{wavelength:g}", **top)
    ax.set(xlim=(400, 700), ylim=(1.44, 1.88))
    ax.spines[["top", "right"]].set_visible(False)
    finish(
        ax, "", "wavelength [nm]", "index of refraction n", title="Schott's glasses: $n_d$, $V_d$", loc="upper right"
    )
    ax.set_title("index by wavelength", fontsize=11, pad=18)


LESSONS: dict[LessonName, Callable[[], Figure]] = {
    "ray": formulas.draw_ray,
    "snell": formulas.draw_snell,
    "fresnel": formulas.draw_fresnel,
    "critical": formulas.draw_critical,
    "half_disc": bodies.draw_half_disc,
    "prism": bodies.draw_prism,
    "lens": bodies.draw_lens,
    "ball": bodies.draw_ball,
    "dispersion": draw_dispersion,
    "total_reflection": formulas.draw_total_reflection,
    "edges": draw_edges,
    "cost": draw_cost,
}
"""What draws each lesson, in the order in which they build on each other."""

WORK: dict[LessonName, str] = {
    "dispersion": "four pictures",
    "edges": "derivatives, and pictures of 64 rays a pixel",
    "cost": "121 pictures",
}
"""What takes the time of those that need more than some seconds."""


def index_page(names: Iterable[str]) -> str:
    """A Markdown page with a heading, the figure `NAME.png` and a paragraph for each of some lessons."""
    return page_template("report/lessons/index.md.jinja").render(names=set(names))
