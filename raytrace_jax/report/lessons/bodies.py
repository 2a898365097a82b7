"""Lessons on glass that is not a ball: half a disc, a prism and a lens, with the rays as the tracer has them."""

from collections.abc import Sequence

import jax
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Polygon

from ... import optics
from ...scene import build
from ...scene.build import make_scene
from ...scene.rows import Description
from ...tracer.ray_tree import RayNode, trace_tree
from ...tracer.settings import RenderSettings
from ..rays import COLOURS as KINDS
from .formulas import BLUE, COLOURS, GREY, INDEX, ORANGE, RED, finish, make_figure

Point = Sequence[float] | np.ndarray


def trace(body: Description, start: Point, direction: Point) -> tuple[RayNode, ...]:
    """The rays that one becomes, in the plane z = 0, at a body of the material `glass`."""
    start, direction = (np.array([*point[:2], 0.0]) for point in (start, direction))
    scene = make_scene(
        build.settings("main", model="physical", max_bounces=2),
        build.camera("eye", pixeldim=(1, 1), viewpoint=start, lookat=start + direction, up=(0, 0, 1)),
        build.material("glass", transmission=1, ior=INDEX),
        body,
    )
    return trace_tree(scene, (0, 0), RenderSettings()).nodes


def through(nodes: Sequence[RayNode]) -> RayNode | None:
    """The ray behind a body, which was refracted twice."""
    inner = {node.number for node in nodes if node.kind == "transmitted" and node.bounce == 1}
    return next((node for node in nodes if node.kind == "transmitted" and node.parent in inner), None)


def unit(degrees: float) -> np.ndarray:
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))])


def degrees_of(vector: Point) -> float:
    return float(np.degrees(np.arctan2(vector[1], vector[0])))


def draw_rays(ax: Axes, nodes: Sequence[RayNode], stub: float, width: float = 3.0, arrow: float = 9.0) -> None:
    """Draw rays as wide as they count, with an arrow each; one that hits nothing has the length `stub`."""
    for node in nodes:
        if node.weight < 0.02:
            continue
        ends = np.stack([node.o, node.o + stub * node.d if node.shape is None else node.p])[:, :2]
        color = KINDS[node.kind]
        ax.plot(*ends.T, color=color, linewidth=width * max(node.weight, 0.15), solid_capstyle="round", zorder=3)
        if arrow:
            middle = ends.mean(axis=0)
            ax.plot(*middle, marker=(3, 0, degrees_of(node.d) - 90), color=color, zorder=3,
                    markersize=arrow * (0.5 + 0.5 * node.weight))  # fmt: skip


def draw_glass(ax: Axes, points: np.ndarray) -> None:
    ax.add_patch(Polygon(points, facecolor="#dcecfb", edgecolor="0.4"))
    ax.set_aspect("equal")
    ax.set_axis_off()


def draw_angle(ax: Axes, place: Point, start: float, stop: float, size: float, color: str, words: str = "") -> None:
    """An arc from one direction to another, in degrees, with its size written beside it."""
    low, high = sorted((start, start + (stop - start + 180) % 360 - 180))
    ax.add_patch(Arc((place[0], place[1]), 2 * size, 2 * size, theta1=low, theta2=high, color=color, zorder=4))
    x, y = np.asarray(place[:2]) + 1.28 * size * unit((low + high) / 2)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
    ax.text(x, y, f"{words}{high - low:.1f}°", color=color, fontsize=9.5, ha="center", va="center", bbox=box, zorder=5)


def draw_half_disc() -> Figure:
    """Three rays that meet the middle of the flat side from within, and angle and shares for all incidences."""
    figure, (*rays, curves) = make_figure(f"Half a disc of glass, n = {INDEX:g}", 2, 2, (11, 9.4))
    disc = build.cylinder("disc", material="glass", center=(0, 0, 0), axis=(0, 0, 0.2), radius=1, cut=(0, 1, 0))

    def nodes_at(degrees: float) -> tuple[RayNode, ...]:
        return trace(disc, -1.6 * unit(90 - degrees), unit(90 - degrees))

    critical = float(np.degrees(optics.critical_angle(1 / INDEX)))
    for ax, degrees in zip(rays, (25.0, 40.0, 50.0), strict=True):
        draw_glass(ax, np.array([unit(angle) for angle in range(180, 361)]))
        ax.plot([0, 0], [-0.95, 0.95], "--", color="0.5", linewidth=0.9)
        nodes = nodes_at(degrees)
        # What the round side sends straight back is left out.
        draw_rays(ax, [node for node in nodes if node.kind != "reflected" or node.bounce > 1], 1.3, 4)
        inner = next(node for node in nodes if node.kind == "transmitted")
        draw_angle(ax, (0, 0), -90, degrees_of(-inner.d), 0.55, ORANGE)
        draw_angle(ax, (0, 0), -90, degrees - 90, 0.55, KINDS["reflected"])
        if (beyond := through(nodes)) is not None:
            draw_angle(ax, (0, 0), 90, degrees_of(beyond.d), 0.42, BLUE)
        share = f"{100 * inner.reflect:.0f} % reflected"
        title = f"total: {share}" if inner.total else f"{share} within, {100 * inner.transmit:.0f} % leave"
        ax.set_title(title, fontsize=11)
        ax.set(xlim=(-1.5, 1.5), ylim=(-1.55, 1.1))
    incidence = np.linspace(0, 60, 61)
    met = [next(node for node in nodes_at(degrees) if node.kind == "transmitted") for degrees in incidence]
    angles = [np.nan if node.theta_t is None else np.degrees(node.theta_t) for node in met]
    curves.plot(incidence, angles, ".", color=BLUE, label="angle behind the flat side, traced [degrees]")
    fine = np.linspace(0, critical, 400)
    law = np.degrees(optics.snell_angle(np.radians(fine), 1 / INDEX))
    curves.plot(fine, law, color=BLUE, linewidth=1, label="Snell's law [degrees]")
    curves.plot(incidence, [100 * node.reflect for node in met], ".", color=RED, label="reflected within, traced [%]")
    curves.axvspan(critical, 60, color="0.94", zorder=0)
    curves.axvline(critical, color="0.5", linewidth=0.9, linestyle=":", label=f"critical angle, {critical:.1f}°")
    curves.set(xlim=(0, 60), ylim=(0, 104))
    finish(curves, "what a scale around the disc reads", "angle of incidence within [degrees]", "degrees, or %")
    return figure


READING = 0.1
"""How well the angle of a prism's telescope is read, in degrees."""


def draw_prism() -> Figure:
    """A ray in least deviation with its angles, two others, and the deviation against the angle of incidence."""
    apex = 60.0
    figure, (rays, curve) = make_figure("A prism in least deviation", 1, 2, (13, 5.8))
    side = unit(-90 - apex / 2)
    prism = build.prism("prism", material="glass", point=(0, 0, 0), axis=(0, 0, 0.5), down=(0, side[1], 0), apex=apex)

    def nodes_at(degrees: float) -> tuple[RayNode, ...]:
        # To the middle of the first face, from the base's side of its normal.
        d = unit(degrees - apex / 2)
        return trace(prism, side / 2 - 0.85 * d, d)

    def deviation(nodes: Sequence[RayNode]) -> float:
        last = through(nodes)
        return np.nan if last is None else degrees_of(nodes[0].d) - degrees_of(last.d)

    incidence = np.linspace(28, 89, 123)
    turns = np.array([deviation(nodes_at(degrees)) for degrees in incidence])
    # The curve is flat at its least: a parabola through the points about it.
    near = slice(max(int(np.nanargmin(turns)) - 3, 0), int(np.nanargmin(turns)) + 4)
    bend, slope, offset = np.polyfit(incidence[near], turns[near], 2)
    place, least = -slope / (2 * bend), offset - slope**2 / (4 * bend)
    index, by_angle = jax.value_and_grad(optics.prism_index)(np.radians(least), np.radians(apex))
    error = abs(float(by_angle)) * np.radians(READING)

    draw_glass(rays, np.array([[0, 0], side, [-side[0], side[1]]]))
    for degrees in (place - 14, place + 20):
        draw_rays(rays, [node for node in nodes_at(degrees) if node.kind != "reflected"], 0.8, 0.9, 0)
    nodes = nodes_at(place)
    draw_rays(rays, nodes, 0.85, 3.2)
    last, entry = through(nodes), nodes[0].p
    assert last is not None
    for point, normal in ((entry, 180 - apex / 2), (last.o, apex / 2)):
        ends = point[:2] + np.multiply.outer((-0.42, 0.42), unit(normal))
        rays.plot(*ends.T, "--", color="0.5", linewidth=0.9)
    draw_angle(rays, entry, 180 - apex / 2, degrees_of(-nodes[0].d), 0.27, KINDS["camera"])
    draw_angle(rays, last.o, apex / 2, degrees_of(last.d), 0.27, BLUE)
    draw_angle(rays, (0, 0), -90 - apex / 2, -90 + apex / 2, 0.16, GREY)
    # The turn, where the ways before and behind the prism cross.
    a, b = nodes[0].d[:2], last.d[:2]
    cross = entry[:2] + a * np.linalg.solve(np.stack([a, -b], axis=1), last.o[:2] - entry[:2])[0]
    rays.plot(*np.stack([entry[:2], cross + 0.95 * a]).T, ":", color=RED, linewidth=1.2)
    rays.plot(*np.stack([cross, last.o[:2]]).T, ":", color=RED, linewidth=1.2)
    draw_angle(rays, cross, degrees_of(a), degrees_of(b), 0.8, RED, "D = ")
    rays.set(xlim=(-1.15, 1.25), ylim=(-1.0, 0.3))
    rays.set_title(f"the ray of least deviation, and two others; n = {INDEX:g}", fontsize=11)

    curve.plot(incidence, turns, ".", color=BLUE, label="traced")
    known = incidence[~np.isnan(turns)]
    formula = np.degrees(optics.prism_deviation(np.radians(known), INDEX, np.radians(apex)))
    curve.plot(known, formula, color=BLUE, linewidth=1, label=r"$\theta_i + \theta_o - A$")
    curve.plot(place, least, "o", color=RED, markersize=8, zorder=4, label=f"least: D = {least:.2f}° at {place:.1f}°")
    curve.axhspan(least - READING, least + READING, color=RED, alpha=0.15, linewidth=0, label=f"read to ± {READING:g}°")
    words = f"n = sin((D + A)/2) / sin(A/2)\n   = {float(index):.4f} ± {error:.4f}"
    curve.text(0.5, 0.5, words, transform=curve.transAxes, fontsize=11, ha="center", va="center", color=RED)
    finish(curve, "the deviation", "angle of incidence [degrees]", "deviation [degrees]", loc="upper center")
    return figure


def draw_lens() -> Figure:
    """Parallel rays through a lens with its focus, and where rays cross the axis, of three lenses."""
    figure, (rays, curves) = make_figure(f"Parallel light through a lens, n = {INDEX:g}", 1, 2, (14, 5.2))
    bend, thickness, heights = 0.36, 0.8, np.linspace(-0.94, 0.94, 21)
    # Lengths are in radii of the rim.
    shapes = {
        "two round faces": (bend, -bend),
        "round face to the light": (2 * bend, 0.0),
        "flat face to the light": (0.0, -2 * bend),
    }

    def lens(curvatures: tuple[float, float]) -> Description:
        first, last = curvatures
        return build.lens("lens", material="glass", center=(0, 0, 0), axis=(1, 0, 0), curvature1=first,
                          curvature2=last, thickness=thickness, diameter=2)  # fmt: skip

    y = np.linspace(-1, 1, 101)
    sag = bend * y**2 / (1 + np.sqrt(1 - (bend * y) ** 2)) - thickness / 2
    draw_glass(rays, np.concatenate([np.stack([sag, y], axis=1), np.stack([-sag, y], axis=1)[::-1]]))
    for height in heights:
        nodes = trace(lens(shapes["two round faces"]), (-1.6, height), (1, 0))
        draw_rays(rays, [node for node in nodes if node.kind != "reflected"], 4.2, 1.0, 0 if abs(height) > 0.1 else 7)
    effective, back = (float(x) for x in optics.lensmaker_focal_length(bend, -bend, INDEX, thickness))
    focus = thickness / 2 + back
    rays.axhline(0, color="0.6", linewidth=0.8, linestyle="-.", zorder=0)
    rays.plot(focus, 0, "o", color=RED, markersize=7, zorder=5)
    words = f"focus for rays near the axis, by the lensmaker's equation:\nf = {effective:.3f}, from the back {back:.3f}"
    rays.annotate(words, (focus, 0), xytext=(focus - 0.5, -1.25), ha="center", fontsize=9.5, color=RED,
                  arrowprops={"arrowstyle": "-", "color": RED})  # fmt: skip
    rays.set(xlim=(-1.6, 4.2), ylim=(-1.45, 1.15))
    rays.set_title("the farther out, the nearer they cross the axis", fontsize=11)

    up = np.linspace(0.02, 0.94, 24)
    for (name, curvatures), color in zip(shapes.items(), COLOURS, strict=False):
        behind = [through(trace(lens(curvatures), (-1.6, height), (1, 0))) for height in up]
        crossings = [np.nan if ray is None else ray.o[0] - ray.o[1] * ray.d[0] / ray.d[1] for ray in behind]
        curves.plot(up, np.array(crossings) - thickness / 2, ".-", color=color, linewidth=1, label=name)
    near = [float(optics.lensmaker_focal_length(*each, INDEX, thickness).back) for each in shapes.values()]
    curves.plot(np.zeros(3), near, "o", color=RED, markersize=7, label="lensmaker's equation")
    finish(curves, "where a ray crosses the axis: spherical aberration", "height of the ray [radii]",
           "from the back of the lens [radii]", loc="lower left")  # fmt: skip
    return figure
