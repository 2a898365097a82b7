"""The critical angle and its derivative against the index."""

import jax
import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.optics import critical_angle
from raytrace_jax.report.lessons.plotting import BLUE, RED, derivative, label, legend, make_figure

TEXT = """From inside, light leaves a medium only at angles below the critical one, arcsin(1/n). It falls steeply just
above n = 1 and slowly for dense media, and so does the ring of total reflection that it draws into a picture: where
that ring lies says more about a small index than about a large one. Lines are automatic derivatives, dots the closed
form."""

MEDIA = {"water": 1.333, "glass": 1.5, "sapphire": 1.77, "diamond": 2.417}


def draw_critical() -> Figure:
    """Two panels: the angle, with some media, and its derivative."""
    figure, (angle, slope) = make_figure("The critical angle of total internal reflection", 1, 2, (11, 4.6))
    n = np.linspace(1.0, 2.6, 801)[1:]

    def inside(n):
        return critical_angle(1 / n)

    angle.plot(n, np.degrees(inside(n)), color=BLUE, label=r"$\theta_c$ = arcsin(1/n)")
    angle.fill_between(n, np.degrees(inside(n)), 90, color="0.93", label="total internal reflection")
    slope.plot(n, np.degrees(derivative(inside, n)), color=RED, label="automatic derivative")
    closed = np.degrees(-1 / (n * np.sqrt(n * n - 1)))
    slope.plot(n[15::40], closed[15::40], ".", color="black", label="−1 / (n √(n² − 1))")
    for name, index in MEDIA.items():
        theta = float(np.degrees(inside(index)))
        angle.plot(index, theta, "o", color=BLUE, markersize=5)
        angle.annotate(f"{name} {theta:.1f}°", (index, theta), xytext=(6, 5), textcoords="offset points", fontsize=9)
        change = float(np.degrees(jax.grad(inside)(index)))
        slope.annotate(f"{name} {change:.0f}".replace("-", "−"), (index, change), xytext=(4, -14),
                       textcoords="offset points", fontsize=9)  # fmt: skip
        slope.plot(index, change, "o", color=RED, markersize=5)
    angle.set_ylim(0, 90)
    slope.set_ylim(-250, 0)
    for ax in (angle, slope):
        ax.set_xlim(0.95, 2.9)
    label(angle, "angle", "index of refraction n", "critical angle [degrees]")
    label(slope, "its derivative by the index", "index of refraction n", r"d$\theta_c$/dn [degrees per unit of index]")
    legend(angle)
    legend(slope, loc="lower right")
    return figure
