"""The angle of refraction and its derivative, against the angle of incidence and against the index."""

import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.optics import critical_angle, snell_angle
from raytrace_jax.report.lessons.plotting import COLOURS, RED, derivative, label, legend, make_figure

TEXT = """Snell's law bends a ray towards the normal where it enters the denser medium; more for a larger index, and
more at a larger angle of incidence. A fit of the index uses the derivative of the angle by the index: it is zero at
normal incidence and largest at grazing incidence. On the way out (red, dashed) the ray bends away from the normal, and
towards the critical angle the derivative grows without limit. Lines are automatic derivatives, dots the closed form."""

DOTS = 25  # one dot for so many points of a line


def draw_snell() -> Figure:
    """Four panels: angle and derivative, against the angle of incidence and against the index."""
    figure, (angle, by_angle, index, by_index) = make_figure("Snell's law and its gradient", 2, 2, (11, 8))
    # Into glass, against the angle of incidence.
    theta = np.radians(np.linspace(0, 89.9, 400))
    for n, color in zip((1.1, 1.333, 1.5, 2.0), COLOURS, strict=True):
        theta_t = np.asarray(snell_angle(theta, n))
        slope = derivative(lambda n: snell_angle(theta, n), np.full_like(theta, n))
        angle.plot(np.degrees(theta), np.degrees(theta_t), color=color, label=f"n = {n:g}")
        by_angle.plot(np.degrees(theta), np.degrees(slope), color=color, label=f"n = {n:g}")
        closed = -np.tan(theta_t) / n
        by_angle.plot(np.degrees(theta[::DOTS]), np.degrees(closed[::DOTS]), ".", color=color, markersize=6)

    # Out of glass, up to the critical angle, in the same panels.
    inside = np.radians(np.linspace(0, np.degrees(critical_angle(1 / 1.5)) - 1e-3, 400))
    out = np.asarray(snell_angle(inside, 1 / 1.5))
    slope = derivative(lambda n: snell_angle(inside, 1 / n), np.full_like(inside, 1.5))
    angle.plot(np.degrees(inside), np.degrees(out), "--", color=RED, label="out of n = 1.5")
    by_angle.plot(np.degrees(inside), np.degrees(slope), "--", color=RED, label="out of n = 1.5")
    closed = np.tan(out) / 1.5
    by_angle.plot(np.degrees(inside[::DOTS]), np.degrees(closed[::DOTS]), ".", color=RED, markersize=6)
    by_angle.set_ylim(-50, 120)
    label(angle, "refraction against incidence", "angle of incidence [degrees]", "angle of refraction [degrees]")
    label(
        by_angle,
        "its derivative by the index",
        "angle of incidence [degrees]",
        r"d$\theta_t$/dn [degrees per unit of index]",
    )

    # Into glass, against the index.
    n = np.linspace(1.0, 2.5, 301)
    for degrees, color in zip((20.0, 45.0, 70.0, 85.0), COLOURS, strict=True):
        theta_i = np.radians(degrees)
        theta_t = np.asarray(snell_angle(theta_i, n))
        index.plot(n, np.degrees(theta_t), color=color, label=f"{degrees:g}°")
        slope = derivative(lambda n, theta_i=theta_i: snell_angle(theta_i, n), n)
        by_index.plot(n, np.degrees(slope), color=color, label=f"{degrees:g}°")
        by_index.plot(n[::DOTS], np.degrees(-np.tan(theta_t) / n)[::DOTS], ".", color=color, markersize=6)
    by_index.set_ylim(-150, 5)
    label(index, "refraction against the index", "index of refraction n", "angle of refraction [degrees]")
    label(
        by_index, "its derivative by the index", "index of refraction n", r"d$\theta_t$/dn [degrees per unit of index]"
    )
    for ax in (angle, by_angle):
        legend(ax, "into glass, and out of it")
    for ax in (index, by_index):
        legend(ax, "angle of incidence")
    return figure
