"""Rays through a transparent ball: where they focus, how far they turn, and how that answers to the index."""

import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle

from raytrace_jax.optics import lens_focal_length, rainbow_incidence, refract, sphere_deviation
from raytrace_jax.report.lessons.plotting import BLUE, COLOURS, GREY, RED, derivative, label, legend, make_figure

TEXT = """Left: parallel rays through a glass ball. Those near the axis meet at the focal length of a ball lens, those
farther out before it; that is why the picture within the ball is upside down and its rim is crowded. Middle: the angle
by which a ray has turned when it leaves a drop of water, straight through or after one or two reflections inside.
Where this angle is least, many rays leave together: these are the two rainbows. Right: the derivative of the angle
by the index, zero in the middle of the ball and largest at its rim."""

GLASS, WATER = 1.5, 1.333
HEIGHTS = np.linspace(-0.9, 0.9, 13)


def draw_ball() -> Figure:
    """Three panels: rays through a glass ball, deviation by a drop, and its derivative by the index."""
    figure, (rays, turn, slope) = make_figure("A ray through a ball", 1, 3, (15, 5))
    _draw_rays(rays)
    distance = np.linspace(0, 0.9999, 600)
    theta = np.arcsin(distance)
    for k, color in zip(range(3), COLOURS, strict=False):
        name = ("straight through", "one reflection inside", "two reflections inside")[k]
        turn.plot(distance, np.degrees(sphere_deviation(theta, WATER, k)), color=color, label=name)
        change = derivative(lambda n, k=k: sphere_deviation(theta, n, k), np.full_like(theta, WATER))
        slope.plot(distance, np.degrees(change), color=color, label=name)
        theta_t = np.arcsin(distance / WATER)
        closed = 2 * (k + 1) * np.tan(theta_t) / WATER
        slope.plot(distance[::40], np.degrees(closed)[::40], ".", color=color)
        if k:
            at = rainbow_incidence(WATER, k)
            degrees = float(np.degrees(sphere_deviation(at, WATER, k)))
            turn.plot(np.sin(at), degrees, "o", color=color)
            turn.annotate(
                f"rainbow: least, {degrees:.1f}°", (float(np.sin(at)), degrees), xytext=(-6, -14),
                textcoords="offset points", ha="right", fontsize=9,
            )  # fmt: skip
    turn.set_ylim(0, 370)
    label(turn, f"deviation by a drop of water, n = {WATER:g}", "distance from the axis [radii]", "deviation [degrees]")
    label(slope, "its derivative by the index", "distance from the axis [radii]", "dD/dn [degrees per unit of index]")
    legend(turn, loc="upper right")
    legend(slope, loc="upper left")
    return figure


def _draw_rays(ax: Axes) -> None:
    """Parallel rays refracted twice, by `refract` itself; the ball has radius one."""
    ax.add_patch(Circle((0, 0), 1, facecolor="#dcecfb", edgecolor="0.4"))
    n = jnp.asarray(np.stack([-np.sqrt(1 - HEIGHTS**2), HEIGHTS, 0 * HEIGHTS]))
    d = jnp.zeros_like(n).at[0].set(1)
    within, _, _ = refract(d, n, jnp.full_like(n[0], GLASS))
    end = n - 2 * jnp.sum(n * within, axis=0) * within
    beyond, _, _ = refract(within, end, jnp.full_like(n[0], 1 / GLASS))
    path = np.stack([jnp.stack([jnp.full_like(n[0], -1.9), n[1], n[2]]), n, end, end + 4 * beyond])[:, :2]
    lines = ax.plot(path[:, 0], path[:, 1], color=BLUE, linewidth=0.9)
    lines[0].set_label("rays")
    effective, back = (float(length) for length in lens_focal_length(1.0, GLASS))
    ax.plot(effective, 0, "o", color=RED, markersize=6, zorder=3)
    ax.annotate(
        f"focus for rays near the axis:\n{effective:g} R from the centre,\n{back:g} R from the back",
        (effective, 0),
        xytext=(-1.75, -1.85),
        fontsize=9,
        arrowprops={"arrowstyle": "-", "color": GREY},
    )
    ax.set_xlim(-1.9, 2.8)
    ax.set_ylim(-2, 2)
    ax.set_aspect("equal")
    label(ax, f"parallel light through a glass ball, n = {GLASS:g}", "along the axis [radii]", "from the axis [radii]")
    legend(ax, loc="upper left")
