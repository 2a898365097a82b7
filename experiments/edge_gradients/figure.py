"""Draw docs/images/edges.png: one footprint cut by an edge, and one piece of a picture sampled in three ways.

python experiments/edge_gradients/figure.py -o docs/images/edges.png
"""

import argparse
import dataclasses
import pathlib
import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from cases import ASSIGNMENT

from raytrace_jax import RenderSettings, load_scene, render
from raytrace_jax.tracer.visibility.coverage import cut_pixel

CROP = (28, 58, 40, 40)


def draw_cut(axes) -> None:
    """A unit square, an edge through it, and the centroids of both parts."""
    distance, angle = 0.18, 0.5
    normal = np.array([np.cos(angle), np.sin(angle)])
    cut = cut_pixel(jnp.asarray(distance), jnp.asarray(normal))
    ends = -distance * normal + np.outer([-0.75, 0.75], [-normal[1], normal[0]])
    corners = np.array([[-0.5, -0.5], [-0.5, 0.5], [0.5, 0.5], [0.5, -0.5]])
    grid = (np.arange(400) + 0.5) / 400 - 0.5
    far = np.add.outer(grid * normal[1], grid * normal[0]) < -distance
    axes.imshow(
        np.where(far[..., None], (0.98, 0.87, 0.72), (0.81, 0.89, 0.97)), extent=(-0.5, 0.5, -0.5, 0.5), origin="lower"
    )
    axes.plot(*ends.T, color="black", linewidth=1.5)
    labels = ((cut.shift[0], "near: hits the surface", 8), (cut.shift[1], "far: goes\npast the edge", -26))
    for shift, label, up in labels:
        at = float(shift) * normal
        axes.plot(*at, "o", color="black")
        axes.annotate(label, at, textcoords="offset points", xytext=(0, up), ha="center", fontsize=8)
    axes.plot(0, 0, "+", color="black")
    axes.annotate("", xy=(0, 0), xytext=-distance * normal, arrowprops={"arrowstyle": "<->"})
    axes.annotate("d", -0.5 * distance * normal, textcoords="offset points", xytext=(-4, 5))
    axes.set(xlim=(-0.75, 0.75), ylim=(-0.62, 0.62), aspect="equal", title=f"A = {float(cut.area):.2f}")
    axes.plot(*np.vstack([corners, corners[:1]]).T, color="black", linewidth=1.5)
    axes.axis("off")


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    scene = load_scene(ASSIGNMENT)
    figure, panels = plt.subplots(1, 4, figsize=(11, 3.1), constrained_layout=True)
    draw_cut(panels[0])
    whole = RenderSettings(size=(160, 120), crop=CROP)
    kinds = (
        ("one point", whole),
        ("one area", dataclasses.replace(whole, edges="aware")),
        ("256 points", dataclasses.replace(whole, samples=16)),
    )
    for axes, (title, how) in zip(panels[1:], kinds, strict=True):
        image = render(scene, how).image
        axes.imshow(np.clip(np.moveaxis(np.asarray(image), 0, -1), 0, 1), interpolation="nearest")
        axes.set_title(title + " a pixel")
        axes.axis("off")
    figure.savefig(arguments.output, dpi=110)


if __name__ == "__main__":
    sys.exit(main())
