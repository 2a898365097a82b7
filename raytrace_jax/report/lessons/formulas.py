"""Lessons on refraction: formulas and their derivatives as curves."""

from collections.abc import Callable, Sequence

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ... import optics
from ...optics import critical_angle, snell_angle
from ...util.numerics import safe_sqrt

BLUE, ORANGE, GREEN, RED, PURPLE, GREY = "#0072b2", "#e69f00", "#009e73", "#c1121f", "#8b5a9f", "#666666"
"""Colours that people with any colour vision tell apart."""

COLOURS = (BLUE, ORANGE, GREEN, PURPLE)

INDEX = 1.5
"""The glass of these lessons."""


def empty_figure(title: str, size: tuple[float, float]) -> Figure:
    """A figure without panels; `size` is its width and height in inches."""
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    figure.suptitle(title, fontsize=14, fontweight="bold")
    return figure


def make_figure(title: str, rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure with panels, row by row; `size` is its width and height in inches."""
    figure = empty_figure(title, size)
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def critical_degrees() -> float:
    """The angle of incidence within the glass, in degrees, beyond which nothing leaves it."""
    return float(np.degrees(critical_angle(1 / INDEX)))


def finish(ax: Axes, heading: str, x: str, y: str, **legend) -> None:
    """Title, labels, a faint grid and the legend of a panel whose curves are drawn."""
    ax.set_title(heading, fontsize=11)
    ax.set(xlabel=x, ylabel=y)
    ax.grid(alpha=0.25)
    ax.legend(fontsize=8.5, title_fontsize=9, framealpha=0.9, **legend)


def derivative(function: Callable, x: np.ndarray) -> np.ndarray:
    """The derivative of an elementwise function at each of many places, by automatic differentiation."""
    return np.asarray(jax.jit(lambda x: jax.jvp(function, (x,), (jnp.ones_like(x),))[1])(x))


def draw_by_index(
    axes: Sequence[Axes],
    x: np.ndarray,
    function: Callable,
    n: np.ndarray,
    *style: str,
    jump: float | None = None,
    **looks,
) -> None:
    """Draw a function of the index `n` against `x` in one of two panels, its derivative by the index in the other.

    The derivative has no line across the place `jump`, if there is one.
    """
    value, slope = axes
    value.plot(x, np.asarray(function(n)), *style, **looks)
    change = derivative(function, n)
    slope.plot(*((x, change) if jump is None else interrupted(x, change, jump)), *style, **looks)


def interrupted(x: np.ndarray, y: np.ndarray, jump: float) -> tuple[np.ndarray, np.ndarray]:
    """A curve with a gap where it jumps: a line from one side to the other would look like values between them."""
    place = np.searchsorted(x, jump)
    return np.insert(x, place, jump), np.insert(y, place, np.nan)


def draw_ray() -> Figure:
    """Six panels: rays into glass, and out of it; the last one is reflected totally. Widths are shares of the light."""
    figure, axes = make_figure(f"A ray meets glass, n = {INDEX:g}", 2, 3, (14, 8.4))
    critical = critical_degrees()
    for ax, degrees in zip(axes, (20.0, 50.0, 80.0, 20.0, 40.0, 55.0), strict=True):
        out = ax in axes[3:]
        _draw_refraction(ax, degrees, out)
        ax.set_title(f"{'out of' if out else 'into'} the glass, at {degrees:g}°", fontsize=11)
    axes[-1].set_title(f"out of the glass, beyond the critical angle of {critical:.1f}°", fontsize=11)
    return figure


def _draw_refraction(ax: Axes, degrees: float, out: bool) -> None:
    """A ray that comes from the left, above the glass or within it, and what becomes of it; its length is one."""
    theta, eta, side = np.radians(degrees), 1 / INDEX if out else INDEX, -1 if out else 1
    reflected = float(optics.fresnel_dielectric(np.cos(theta), eta))
    refraction = float(snell_angle(theta, eta))
    ax.add_patch(Rectangle((-2, -2), 4, 2, facecolor="#dcecfb", edgecolor="none"))
    ax.plot([-2, 2], [0, 0], color="0.4", linewidth=1)
    ax.plot([0, 0], [-1.1, 1.1], "--", color="0.5", linewidth=0.9)
    rays = [("incident", -theta, side, 1.0, ORANGE), ("reflected", theta, side, reflected, RED)]
    if reflected < 1:
        rays.append(("refracted", refraction, -side, 1 - reflected, BLUE))
    for name, angle, above, share, color in rays:
        x, y = np.sin(angle), above * np.cos(angle)
        ax.plot([0, x], [0, y], color=color, linewidth=10 * share, solid_capstyle="butt", label=name)
        heading = np.degrees(np.arctan2(y, x)) + (90 if name == "incident" else -90)  # Of a triangle that points up.
        ax.plot(0.6 * x, 0.6 * y, marker=(3, 0, heading), markersize=8 + 9 * share, color=color)
        words = f"{name} {100 * share:.1f} %\n{abs(np.degrees(angle)):.1f}°"
        beside = ("right" if x < 0 else "left", "bottom" if y > 0 else "top")
        place = x - 0.15 * np.sign(x), y + 0.06 * np.sign(y)
        ax.text(*place, words, color=color, ha=beside[0], va=beside[1], fontsize=10)
    ax.text(-1.8, 0.04, "air", color="0.35", fontsize=9)
    ax.text(-1.8, -0.04, "glass", color="0.35", fontsize=9, va="top")
    ax.set(xlim=(-1.85, 1.85), ylim=(-1.4, 1.4), aspect="equal")
    ax.set_axis_off()


def draw_snell() -> Figure:
    """Four panels: angle and derivative, against the angle of incidence and against the index."""
    figure, axes = make_figure("Snell's law and its gradient", 2, 2, (11, 8))

    def draw(axes: Sequence[Axes], x: np.ndarray, theta_i, n, name: str, color: str, power: int = 1) -> None:
        # The angle of refraction into glass, or out of it (-1), and its derivative; a dot for 25 points of a line.
        def refracted(n):
            return jnp.degrees(snell_angle(theta_i, n**power))

        n = np.broadcast_to(n, x.shape)
        draw_by_index(axes, x, refracted, n, "-" if power == 1 else "--", color=color, label=name)
        closed = np.degrees(-power * np.tan(np.radians(refracted(n))) / n)
        axes[1].plot(x[::25], closed[::25], ".", color=color, markersize=6)

    degrees = np.linspace(0, 89.9, 400)
    for n, color in zip((1.1, 1.333, 1.5, 2.0), COLOURS, strict=True):
        draw(axes[:2], degrees, np.radians(degrees), n, f"n = {n:g}", color)
    inside = np.linspace(0, np.degrees(critical_angle(1 / 1.5)) - 1e-3, 400)
    draw(axes[:2], inside, np.radians(inside), 1.5, "out of n = 1.5", RED, -1)
    indices = np.linspace(1.05, 2.5, 301)
    for theta_i, color in zip((20.0, 45.0, 70.0, 85.0), COLOURS, strict=True):
        draw(axes[2:], indices, np.radians(theta_i), indices, f"{theta_i:g}°", color)
    axes[1].set_ylim(-120, 120)
    refraction, change = "angle of refraction [degrees]", r"d$\theta_t$/dn [degrees per unit of index]"
    rows = (
        ("incidence", "angle of incidence [degrees]", "into glass, and out of it"),
        ("the index", "index of refraction n", "angle of incidence"),
    )
    for k, (what, x, title) in enumerate(rows):
        finish(axes[2 * k], f"refraction against {what}", x, refraction, title=title)
        finish(axes[2 * k + 1], f"its derivative by the index, against {what}", x, change, title=title)
    return figure


def draw_fresnel() -> Figure:
    """Reflectance and its derivative by the index, above on the way into glass, below on the way out."""
    figure, axes = make_figure(f"Fresnel and Schlick, n = {INDEX:g}", 2, 2, (11, 8))
    critical = critical_degrees()
    ways = (("into the glass", np.linspace(0, 90, 501), 1), ("out of the glass", np.linspace(0, 60, 2001), -1))
    for row, (where, degrees, power) in enumerate(ways):
        value, slope = pair = axes[2 * row : 2 * row + 2]
        theta, n = np.radians(degrees), np.full_like(degrees, INDEX)

        def fresnel(n, theta=theta, power=power):
            return optics.fresnel_dielectric(jnp.cos(theta), n**power)

        def schlick(n, theta=theta, power=power):
            # Out of the glass of the transmitted angle, whose cosine is about 0 where there is total reflection.
            return optics.fresnel_schlick(jnp.cos(theta if power == 1 else snell_angle(theta, n**power)), n)

        parallel, perpendicular = optics.fresnel_amplitudes(np.cos(theta), INDEX**power)
        value.plot(degrees, np.asarray(perpendicular) ** 2, "--", color=GREY, linewidth=1, label="perpendicular")
        value.plot(degrees, np.asarray(parallel) ** 2, ":", color=GREY, linewidth=1.3, label="parallel")
        jump = critical if row else None
        draw_by_index(pair, degrees, fresnel, n, jump=jump, color=BLUE, label="Fresnel, unpolarised")
        draw_by_index(pair, degrees, schlick, n, jump=jump, color=RED, label="Schlick")
        finish(value, f"reflectance {where}", "angle of incidence [degrees]", "reflected share of the light")
        finish(slope, f"its derivative, {where}", "angle of incidence [degrees]", "dR/dn [per unit of index]")
        if row == 1:
            slope.set_ylim(-0.2, 6)
            for ax in pair:
                ax.set_xlim(15, 55)
                ax.axvspan(critical, 60, color="0.94", zorder=0)
                ax.text(48.5, 0.5, "total internal\nreflection", fontsize=9, color="0.35", ha="center", va="center",
                        transform=ax.get_xaxis_transform())  # fmt: skip
    return figure


MEDIA = {"water": 1.333, "glass": 1.5, "sapphire": 1.77, "diamond": 2.417}


def draw_critical() -> Figure:
    """Two panels: the angle, with some media, and its derivative."""
    figure, (angle, slope) = make_figure("The critical angle of total internal reflection", 1, 2, (11, 4.6))
    n = np.linspace(1.0, 2.6, 801)[1:]

    def inside(n):
        return jnp.degrees(critical_angle(1 / n))

    angle.plot(n, inside(n), color=BLUE, label=r"$\theta_c$ = arcsin(1/n)")
    angle.fill_between(n, inside(n), 90, color="0.93", label="total internal reflection")
    slope.plot(n, derivative(inside, n), color=RED, label="automatic derivative")
    closed = np.degrees(-1 / (n * np.sqrt(n * n - 1)))
    slope.plot(n[15::40], closed[15::40], ".", color="black", label="−1 / (n √(n² − 1))")
    for name, index in MEDIA.items():
        theta, change = float(inside(index)), float(jax.grad(inside)(index))
        marks = ((angle, theta, BLUE, f"{theta:.1f}°", (6, 5)), (slope, change, RED, f"{change:.0f}", (4, -14)))
        for ax, y, color, words, beside in marks:
            ax.plot(index, y, "o", color=color, markersize=5)
            words = f"{name} {words}".replace("-", "−")
            ax.annotate(words, (index, y), xytext=beside, textcoords="offset points", fontsize=9)
    angle.set_ylim(0, 90)
    slope.set_ylim(-250, 0)
    for ax in (angle, slope):
        ax.set_xlim(0.95, 2.9)
    change = r"d$\theta_c$/dn [degrees per unit of index]"
    finish(angle, "angle", "index of refraction n", "critical angle [degrees]")
    finish(slope, "its derivative by the index", "index of refraction n", change, loc="lower right")
    return figure


SQUARE_ROOTS: tuple[tuple[str, str, Callable], ...] = (
    ("plain", "sqrt(x)", jnp.sqrt),
    ("guarded output", "where(x > 0, sqrt(x), 0)", lambda x: jnp.where(x > 0, jnp.sqrt(x), 0)),
    ("guarded input", "where(x > 0, sqrt(where(x > 0, x, 1)), 0)", safe_sqrt),
)


def cosine_and_slopes(square_root: Callable, theta: np.ndarray, n: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cosine of refraction out of glass of index `n` at angles `theta`, and its derivative in either mode."""

    def cosine(n):
        return square_root(1 - (n * jnp.sin(theta)) ** 2)

    index = np.full_like(theta, n)
    with jax.debug_nans(False):  # Here NaN is the point.
        value, pull = jax.vjp(cosine, jnp.asarray(index))
        return np.asarray(value), derivative(cosine, index), np.asarray(pull(jnp.ones_like(value))[0])


def draw_total_reflection() -> Figure:
    """Draw the cosine of refraction and, below, its two derivatives: a column for each way to take the square root."""
    figure, axes = make_figure("Total internal reflection, as automatic differentiation sees it", 3, 3, (14, 10))
    critical = critical_degrees()
    degrees = np.linspace(0, 60, 1201)
    rows = (
        ("the value", "cos $\\theta_t$", BLUE, (-0.1, 1.1)),
        ("its derivative, forward mode", "d cos $\\theta_t$ / dn [per unit of index]", PURPLE, (-8, 1)),
        ("its derivative, reverse mode", "d cos $\\theta_t$ / dn [per unit of index]", RED, (-8, 1)),
    )
    for column, (name, formula, square_root) in enumerate(SQUARE_ROOTS):
        curves = cosine_and_slopes(square_root, np.radians(degrees), INDEX)
        for row, (curve, (what, unit, color, limits)) in enumerate(zip(curves, rows, strict=True)):
            ax = axes[3 * row + column]
            drawn = interrupted(degrees, curve, critical) if row else (degrees, curve)
            ax.plot(*drawn, color=color, linewidth=2, label=what)
            bad = degrees[~np.isfinite(curve)]
            if bad.size:
                ax.axvspan(bad.min(), bad.max(), facecolor="#fbe3dc", edgecolor=RED, hatch="//", linewidth=0)
                words = {"color": RED, "fontsize": 20, "fontweight": "bold"}
                box = {"facecolor": "white", "edgecolor": "none"}
                place = (bad.min() + bad.max()) / 2, 0.55
                ax.text(*place, "NaN", transform=ax.get_xaxis_transform(), ha="center", bbox=box, **words)
            ax.set_ylim(*limits)
            ax.axvline(critical, color="0.6", linewidth=0.8, linestyle=":", label=f"critical angle, {critical:.1f}°")
            title = f"{name}\n{formula}" if row == 0 else ""
            finish(ax, title, "angle of incidence [degrees]", unit, loc="lower left")
    return figure
