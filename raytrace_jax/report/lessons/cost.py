"""What a search for the index walks on: the cost against the index, of sharp and of blurred pictures."""

import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

from raytrace_jax.images.filters import gaussian_blur
from raytrace_jax.report.lessons.plotting import COLOURS, label, legend, make_figure
from raytrace_jax.report.lessons.small_scene import INDEX, small_scene
from raytrace_jax.report.panels import as_pixels, remove_ticks
from raytrace_jax.scene.parameters import set_parameters
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.settings import RenderSettings

TEXT = """A picture of a glass ball of index 1.5, and how far pictures with another index are from it. Close to the
true index the cost of the sharp picture has a kink. The strips between the edges of the two pictures widen with the
error of the index, so that the slope jumps and does not tell the remaining distance. Far above the true index the cost
is almost flat, since what is seen through the ball no longer overlaps with what should be there. A blur rounds the
bottom to a parabola, which suits least-squares steps, and keeps a slope farther out: so a fit goes from coarse to fine.
No blur removes the second minimum near n = 1. There the ball is almost invisible, and that is nearer to the target than
a ball with a wrong picture in it. So a fit also scans for starts."""


def mean_square(error: np.ndarray, sigma: float) -> float:
    """The mean square of a picture of errors, blurred by a Gaussian of standard deviation `sigma` pixels."""
    return float(jnp.mean(gaussian_blur(jnp.asarray(error), jnp.asarray(sigma)) ** 2))


def draw_cost(size: tuple[int, int] = (160, 120), count: int = 121) -> Figure:
    """The target, a picture with another index, the cost against the index, and its derivative.

    Args:
        size: width and height of the pictures in pixels.
        count: how many indices from 1 to 2.2 are rendered; with 12 k + 1 of them 1.5 is one.
    """
    scene, settings = small_scene(), RenderSettings(size=size, max_bounces=2)

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
        values = np.array([mean_square(image - target, sigma) for image in images])
        cost.plot(indices, values / values.max(), color=color, label=name)
        slope.plot(indices, np.gradient(values / values.max(), indices), color=color, label=name)
    slope.axhline(0, color="0.4", linewidth=0.8)
    for ax in (cost, slope):
        ax.axvline(INDEX, color="0.6", linewidth=0.8, linestyle="--", label="the truth")
        legend(ax)
    label(cost, "cost", "index of refraction n", "mean squared error [share of its largest]")
    label(slope, "its slope: a descent goes against it", "index of refraction n", "slope [per unit of index]")
    return figure
