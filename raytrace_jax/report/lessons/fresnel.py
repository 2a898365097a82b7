"""Fresnel's reflectance, Schlick's approximation of it, and the derivatives of both by the index."""

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.optics import critical_angle, fresnel_amplitudes, fresnel_dielectric, fresnel_schlick, snell_angle
from raytrace_jax.report.lessons.plotting import BLUE, GREY, RED, derivative, label, legend, make_figure

TEXT = """Fresnel's equations say how much a surface reflects; Schlick's approximation replaces them by a fifth power.
As values the two agree to a few hundredths. Their derivatives by the index agree at normal incidence only: towards
grazing angles Fresnel's rises before it falls, Schlick's just falls. A fit that renders with one and is shown a
picture of the other therefore reads a slightly wrong index. On the way out both reach 1 at the critical angle, with a
slope that grows without limit; Schlick's does so because its cosine is that of the transmitted ray."""

INDEX = 1.5


def draw_fresnel() -> Figure:
    """Reflectance and its derivative by the index, above on the way into glass, below on the way out."""
    figure, axes = make_figure(f"Fresnel and Schlick, n = {INDEX:g}", 2, 2, (11, 8))
    critical = float(np.degrees(critical_angle(1 / INDEX)))
    ways = (
        ("into the glass", np.linspace(0, 90, 501), fresnel_entering, schlick_entering),
        ("out of the glass", np.linspace(0, 60, 2001), fresnel_leaving, schlick_leaving),
    )
    for row, (where, degrees, fresnel, schlick) in enumerate(ways):
        value, slope = axes[2 * row : 2 * row + 2]
        theta, n = np.radians(degrees), np.full_like(degrees, INDEX)
        eta = INDEX if row == 0 else 1 / INDEX
        parallel, perpendicular = fresnel_amplitudes(np.cos(theta), eta)
        value.plot(degrees, np.asarray(perpendicular) ** 2, "--", color=GREY, linewidth=1, label="perpendicular")
        value.plot(degrees, np.asarray(parallel) ** 2, ":", color=GREY, linewidth=1.3, label="parallel")
        for function, color, name in ((fresnel, BLUE, "Fresnel, unpolarised"), (schlick, RED, "Schlick")):
            value.plot(degrees, np.asarray(function(theta, n)), color=color, label=name)
            slope.plot(degrees, derivative(lambda n, f=function, t=theta: f(t, n), n), color=color, label=name)
        label(value, f"reflectance {where}", "angle of incidence [degrees]", "reflected share of the light")
        label(slope, f"its derivative, {where}", "angle of incidence [degrees]", "dR/dn [per unit of index]")
        if row == 1:
            slope.set_ylim(-0.2, 6)
            for ax in (value, slope):
                ax.set_xlim(15, 55)
                ax.axvline(critical, color="0.6", linewidth=0.8)
                ax.axvspan(critical, 60, color="0.94", zorder=0)
                ax.text(48.5, 0.5, "total internal\nreflection", fontsize=9, color="0.35", ha="center", va="center",
                        transform=ax.get_xaxis_transform())  # fmt: skip
        legend(value)
        legend(slope)
    return figure


def fresnel_entering(theta, n):
    """Fresnel's reflectance from air into glass of index `n`; angles in radians."""
    return fresnel_dielectric(jnp.cos(theta), n)


def schlick_entering(theta, n):
    """Schlick's, of the incident angle's cosine."""
    return fresnel_schlick(jnp.cos(theta), n)


def fresnel_leaving(theta, n):
    """Fresnel's reflectance from glass of index `n` into air."""
    return fresnel_dielectric(jnp.cos(theta), 1 / n)


def schlick_leaving(theta, n):
    """Schlick's, of the transmitted angle's cosine; 1 where there is none."""
    # Of the angle pi / 2 the cosine is not exactly 0 in floating point, but near enough for a figure.
    return fresnel_schlick(jnp.cos(snell_angle(theta, 1 / n)), n)
