"""How the figures look, and the derivative of a curve: shared by all lessons."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

BLUE, ORANGE, GREEN, RED, PURPLE, GREY = "#0072b2", "#e69f00", "#009e73", "#c1121f", "#8b5a9f", "#666666"
"""Colours that people with any colour vision tell apart."""

COLOURS = (BLUE, ORANGE, GREEN, PURPLE)


def make_figure(title: str, rows: int, columns: int, size: tuple[float, float]) -> tuple[Figure, list[Axes]]:
    """A figure with panels, row by row; `size` is its width and height in inches."""
    figure = Figure(figsize=size, dpi=150, layout="constrained")
    figure.suptitle(title, fontsize=14, fontweight="bold")
    axes = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for ax in axes:
        ax.spines[["top", "right"]].set_visible(False)
    return figure, axes


def label(ax: Axes, title: str, x: str, y: str) -> None:
    """Title and axis labels of a panel, and a faint grid."""
    ax.set_title(title, fontsize=11)
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.grid(alpha=0.25)


def legend(ax: Axes, title: str = "", **options) -> None:
    """The legend of a panel."""
    ax.legend(title=title or None, fontsize=8.5, title_fontsize=9, framealpha=0.9, **options)


def derivative(function: Callable, x: np.ndarray) -> np.ndarray:
    """The derivative of an elementwise function at each of many places, by automatic differentiation."""
    return np.asarray(jax.jvp(function, (jnp.asarray(x),), (jnp.ones_like(x),))[1])
