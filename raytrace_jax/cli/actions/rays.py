"""`rays`: from a scene file and a pixel to the drawing and the table of its rays."""

import dataclasses
import math
import sys

from raytrace_jax.cli.console import print_table, stderr_console
from raytrace_jax.cli.options.explanations import Rays
from raytrace_jax.cli.options.shared import as_usage_error
from raytrace_jax.cli.preparation import check_picture_path, picture_window, read_picture_scene
from raytrace_jax.report.ray_figure import draw_tree
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.ray_tree import RayNode, RayTree, trace_tree
from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.json_text import json_text
from raytrace_jax.util.session import jax_session

HEADERS = ("ray", "from", "kind", "hits", "distance", "path", "incident", "refracted", "reflect", "transmit", "color")

MEDIA = ("medium", "absorbed")

LEAST_DRAWN: dict[ModelName, float] = {"classic": 0.0, "additive": 0.0, "physical": 0.005}
"""Share of the pixel from which on rays are drawn. A path through glass splits at every surface: of the 33 rays behind
pixel 360 220 of `bubble` 18 count less, too little to see in a picture."""


def run_rays(command: Rays) -> int:
    """Trace the pixel's tree, write its drawing, print the drawing's path and the table."""
    # A tree is that of one ray, whatever the scene's file says; more samples that were asked for are refused.
    asked = dataclasses.replace(command.render, edges="point", samples=command.render.samples or 1)
    check_picture_path(command.output, (".svg", ".png"))
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, asked)
        picture_window(scene, settings)
        with as_usage_error():
            tree = trace_tree(scene, command.pixel, settings)
        column, row = tree.pixel
        color = " ".join(f"{value:.4f}" for value in tree.nodes[0].color)
        title = f"pixel {column} {row} of {command.scene.name}: {_count(len(tree.nodes))}, colour {color}"
        least = LEAST_DRAWN[settings.model] if command.least_drawn is None else command.least_drawn
        drawn = sum(node.weight >= least for node in tree.nodes)
        figure = draw_tree(tree, scene, title, settings, least)

    # The file is written before anything is said on stdout.
    with atomic_write(command.output) as temporary:
        # Without a date in it the same rays make the same file.
        metadata = {"Date": None} if command.output.suffix.lower() == ".svg" else None
        figure.savefig(temporary, bbox_inches="tight", metadata=metadata)
    if command.json:
        rays = [node._asdict() for node in tree.nodes]
        sys.stdout.write(
            json_text({"output": command.output, "pixel": tree.pixel, "rays": rays, "dropped": tree.dropped})
        )
    else:
        print(command.output)
        print_rays(tree)

    # What the drawing or the tree leaves out is said on stderr.
    console = stderr_console(quiet=command.quiet)
    if drawn < len(tree.nodes):
        console.print(
            f"{drawn} of {_count(len(tree.nodes))} are drawn, which count {least:g} or more; --least-drawn 0 draws all"
        )
    if tree.dropped:
        beyond = f"beyond --max-bounces {settings.bounces}"
        console.print(f"{_count(tree.dropped)} {beyond}, not traced and taken as black")
    return 0


def print_rays(tree: RayTree) -> None:
    """Print a line for each ray on stdout: lengths in world units, weights of the largest channel."""
    lines = [_line(node) for node in tree.nodes]
    headers = HEADERS
    if any(node.medium for node in tree.nodes):
        headers = (*HEADERS[:-1], *MEDIA, HEADERS[-1])
        lines = [(*line[:-1], *_medium(node), line[-1]) for line, node in zip(lines, tree.nodes, strict=True)]
    print_table("rays: angles in degrees", headers, lines)


def _medium(node: RayNode) -> tuple[str, str]:
    """What a ray runs through, and the share of its light that is absorbed there."""
    return node.medium or "-", f"{node.absorbed:.4f}" if node.absorbed else "-"


def _line(node: RayNode) -> tuple[str, ...]:
    parent = "-" if node.parent is None else str(node.parent)
    color = " ".join(f"{value:.4f}" for value in node.color)
    if node.shape is None:
        return (str(node.number), parent, node.kind, "nothing", *["-"] * 6, color)
    refracted = "total" if node.total else "-" if node.theta_t is None else f"{math.degrees(node.theta_t):.2f}"
    numbers = f"{node.distance:.4f}", f"{node.path_length:.4f}", f"{math.degrees(node.theta_i):.2f}", refracted
    weights = (f"{weight:.4f}" if weight else "-" for weight in (node.reflect, node.transmit))
    return (str(node.number), parent, node.kind, node.shape, *numbers, *weights, color)


def _count(rays: int) -> str:
    return "1 ray" if rays == 1 else f"{rays} rays"
