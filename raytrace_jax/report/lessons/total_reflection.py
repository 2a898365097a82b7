"""What automatic differentiation sees at total internal reflection, with and without a guarded square root."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from raytrace_jax.optics import critical_angle
from raytrace_jax.report.lessons.plotting import BLUE, PURPLE, RED, derivative, label, legend, make_figure
from raytrace_jax.util.numerics import safe_sqrt

TEXT = """The cosine of the refracted ray is a square root, and beyond the critical angle its argument is negative.
Taken as it stands (left) value and derivative are NaN there, and one such ray makes the gradient of a whole picture
NaN. Replacing the result by 0 (middle) mends the value, and the derivative in forward mode, which selects a branch as
the value does. Reverse mode goes through both branches: it multiplies the one that was not taken by zero, and zero
times NaN is NaN. Guarding the *argument* (right) leaves all of it finite. This is how the tracer does it. The
derivative still grows without limit as the critical angle comes near: that is physics."""

INDEX = 1.5


def plain(radicand):
    """The square root as it stands."""
    return jnp.sqrt(radicand)


def guarded_output(radicand):
    """The square root, with its NaN replaced."""
    return jnp.where(radicand > 0, jnp.sqrt(radicand), 0)


SQUARE_ROOTS: tuple[tuple[str, str, Callable], ...] = (
    ("plain", "sqrt(x)", plain),
    ("guarded output", "where(x > 0, sqrt(x), 0)", guarded_output),
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
    critical = float(np.degrees(critical_angle(1 / INDEX)))
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
            _draw_curve(ax, degrees, curve, color, what)
            label(ax, f"{name}\n{formula}" if row == 0 else "", "angle of incidence [degrees]", unit)
            ax.set_ylim(*limits)
            ax.axvline(critical, color="0.6", linewidth=0.8, label=f"critical angle, {critical:.1f}°")
            legend(ax, loc="lower left")
    return figure


def _draw_curve(ax: Axes, degrees: np.ndarray, values: np.ndarray, color: str, name: str) -> None:
    """A curve, and a hatched area where it is not finite."""
    ax.plot(degrees, values, color=color, linewidth=2, label=name)
    bad = degrees[~np.isfinite(values)]
    if bad.size:
        ax.axvspan(bad.min(), bad.max(), facecolor="#fbe3dc", edgecolor=RED, hatch="//", linewidth=0)
        ax.text(
            (bad.min() + bad.max()) / 2, 0.55, "NaN", color=RED, fontsize=20, fontweight="bold", ha="center",
            transform=ax.get_xaxis_transform(), bbox={"facecolor": "white", "edgecolor": "none"},
        )  # fmt: skip
