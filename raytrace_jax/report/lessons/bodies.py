"""Lessons on bodies of glass: half a disc, a prism, a lens and a ball, with the rays as the tracer has them."""

import jax
import jax.numpy as jnp
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
from .formulas import BLUE, COLOURS, GREY, INDEX, ORANGE, RED, critical_degrees, draw_by_index, finish, make_figure


def trace(body: Description, start: np.ndarray, direction: np.ndarray) -> list[RayNode]:
    """The rays that one becomes at a body of the material `glass`, but for what that reflects on the outside."""
    scene = make_scene(
        build.settings("main", model="physical", max_bounces=2),
        build.camera("eye", pixeldim=(1, 1), viewpoint=start, lookat=start + direction, up=(0, 0, 1)),
        build.material("glass", transmission=1, ior=INDEX),
        body,
    )
    nodes = trace_tree(scene, (0, 0), RenderSettings()).nodes
    return [node for node in nodes if node.kind != "reflected" or node.bounce > 1]


def path(nodes: list[RayNode]) -> list[RayNode]:
    """The ray before the body, within it and, if any leaves, behind it."""
    return [node for node in nodes if node.kind != "reflected"]


def unit(degrees: float) -> np.ndarray:
    """A direction in the plane z = 0, in which all is drawn."""
    return np.array([np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0])


def degrees_of(vector: np.ndarray) -> float:
    return float(np.degrees(np.arctan2(vector[1], vector[0])))


def draw_rays(ax: Axes, nodes: list[RayNode], stub: float, width: float) -> None:
    """Draw rays as wide as they count, with an arrow each; one that hits nothing has the length `stub`."""
    for node in nodes:
        way = stub * node.d if node.shape is None else node.p - node.o
        look = {"color": KINDS[node.kind], "zorder": 3}
        wide = width * max(node.weight, 0.15)
        ax.plot(*np.stack([node.o, node.o + way])[:, :2].T, linewidth=wide, solid_capstyle="round", **look)
        arrow = (3, 0, degrees_of(way) - 90)
        ax.plot(*(node.o + 0.38 * way)[:2], marker=arrow, markersize=3.5 + 1.8 * wide, **look)


def draw_glass(ax: Axes, points: np.ndarray, title: str) -> None:
    ax.add_patch(Polygon(points[:, :2], facecolor="#dcecfb", edgecolor="0.4"))
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set_title(title, fontsize=11)


def draw_normal(ax: Axes, node: RayNode, length: float) -> None:
    """The normal of the surface that a ray hits, to either side."""
    ends = node.p + np.multiply.outer((-length, length), node.n)
    ax.plot(*ends[:, :2].T, "--", color="0.5", linewidth=0.9)


def draw_angle(
    ax: Axes, place: np.ndarray, start: np.ndarray, stop: np.ndarray, size: float, color: str, words: str = ""
) -> None:
    """An arc from one direction to another, with the angle written beside it."""
    turn = (degrees_of(stop) - degrees_of(start) + 180) % 360 - 180
    low, high = sorted((degrees_of(start), degrees_of(start) + turn))
    ax.add_patch(Arc((place[0], place[1]), 2 * size, 2 * size, theta1=low, theta2=high, color=color, zorder=4))
    x, y, _ = place + 1.28 * size * unit((low + high) / 2)
    box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 0.8}
    ax.text(x, y, f"{words}{high - low:.1f}°", color=color, fontsize=9.5, ha="center", va="center", bbox=box, zorder=5)


def draw_half_disc() -> Figure:
    """Three rays that meet the middle of the flat side from within, the last one beyond the critical angle."""
    words = f"Half a disc of glass, n = {INDEX:g}: the critical angle is {critical_degrees():.1f}°"
    figure, axes = make_figure(words, 1, 3, (14, 5.2))
    disc = build.cylinder("disc", material="glass", center=(0, 0, 0), axis=(0, 0, 0.2), radius=1, cut=(0, 1, 0))
    for ax, degrees in zip(axes, (25, 40, 50), strict=True):
        nodes = trace(disc, -1.6 * unit(90 - degrees), unit(90 - degrees))
        _, inner, *beyond = path(nodes)
        share = f"{100 * inner.reflect:.0f} % reflected"
        title = f"total: {share}" if inner.total else f"{share} within, {100 * inner.transmit:.0f} % leave"
        draw_glass(ax, np.array([unit(angle) for angle in range(180, 361)]), title)
        draw_rays(ax, nodes, 1.3, 4)
        draw_normal(ax, inner, 0.95)
        draw_angle(ax, inner.p, -inner.n, -inner.d, 0.55, ORANGE)
        draw_angle(ax, inner.p, -inner.n, unit(degrees - 90), 0.55, KINDS["reflected"])
        for node in beyond:
            draw_angle(ax, inner.p, inner.n, node.d, 0.42, BLUE)
        ax.set(xlim=(-1.5, 1.5), ylim=(-1.55, 1.1))
    return figure


READING = 0.1
"""How well the angle of a prism's telescope is read, in degrees."""


def draw_prism() -> Figure:
    """A ray in least deviation with its angles, and the deviation against the angle of incidence."""
    apex = 60.0
    figure, (rays, curve) = make_figure("A prism in least deviation", 1, 2, (13, 5.8))
    side = unit(-90 - apex / 2)
    prism = build.prism("prism", material="glass", point=(0, 0, 0), axis=(0, 0, 0.5), down=(0, side[1], 0), apex=apex)

    def nodes_at(degrees: float) -> list[RayNode]:
        # To the middle of the first face, from the base's side of its normal.
        d = unit(degrees - apex / 2)
        return trace(prism, side / 2 - 0.85 * d, d)

    incidence = np.linspace(28, 89, 123)
    ways = [path(nodes_at(degrees)) for degrees in incidence]
    turns = np.array([degrees_of(way[0].d) - degrees_of(way[-1].d) for way in ways])
    # The curve is flat at its least: a parabola through the points about it.
    near = np.argsort(turns)[:7]
    parabola = np.poly1d(np.polyfit(incidence[near], turns[near], 2))
    place = parabola.deriv().roots[0]
    least = parabola(place)
    index, by_angle = jax.value_and_grad(optics.prism_index)(np.radians(least), np.radians(apex))
    error = abs(float(by_angle)) * np.radians(READING)

    nodes = nodes_at(place)
    entry, inner, last = path(nodes)
    draw_glass(rays, np.array([0 * side, side, side * (-1, 1, 0)]), f"the ray of least deviation; n = {INDEX:g}")
    draw_rays(rays, nodes, 0.85, 3.2)
    for node in (entry, inner):
        draw_normal(rays, node, 0.42)
    draw_angle(rays, entry.p, entry.n, -entry.d, 0.27, KINDS["camera"])
    draw_angle(rays, inner.p, inner.n, last.d, 0.27, BLUE)
    draw_angle(rays, 0 * side, side, side * (-1, 1, 0), 0.16, GREY)
    # The way that the ray would have gone on.
    rays.plot(*np.stack([inner.p, inner.p + 0.8 * entry.d])[:, :2].T, ":", color=RED, linewidth=1.2)
    draw_angle(rays, inner.p, entry.d, last.d, 0.6, RED, "D = ")
    rays.set(xlim=(-1.15, 1.25), ylim=(-1.0, 0.3))

    curve.plot(incidence, turns, ".", color=BLUE, label="traced")
    formula = np.degrees(optics.prism_deviation(np.radians(incidence), INDEX, np.radians(apex)))
    curve.plot(incidence, formula, color=BLUE, linewidth=1, label=r"$\theta_i + \theta_o - A$")
    curve.plot(place, least, "o", color=RED, markersize=8, zorder=4, label=f"least: D = {least:.2f}° at {place:.1f}°")
    curve.axhspan(least - READING, least + READING, color=RED, alpha=0.15, linewidth=0, label=f"read to ± {READING:g}°")
    words = f"n = sin((D + A)/2) / sin(A/2)\n   = {float(index):.4f} ± {error:.4f}"
    curve.text(0.5, 0.5, words, transform=curve.transAxes, fontsize=11, ha="center", va="center", color=RED)
    finish(curve, "the deviation", "angle of incidence [degrees]", "deviation [degrees]", loc="upper center")
    return figure


def draw_beam(ax: Axes, body: Description, outline: np.ndarray, back: float, length: optics.FocalLength) -> None:
    """Parallel rays through a body whose back is at x = `back`, with the focus for rays near the axis."""
    draw_glass(ax, outline, f"parallel light through glass, n = {INDEX:g}")
    for height in np.linspace(-0.9, 0.9, 15):
        draw_rays(ax, path(trace(body, np.array([-1.9, height, 0]), unit(0))), 4.0, 1.0)
    focus = back + float(length.back), 0
    ax.axhline(0, color="0.6", linewidth=0.8, linestyle="-.", zorder=0)
    ax.plot(*focus, "o", color=RED, markersize=7, zorder=5)
    words = f"focus for rays near the axis:\nf = {length.effective:.3f}, from the back {length.back:.3f}"
    line = {"arrowstyle": "-", "color": RED}
    ax.annotate(words, focus, xytext=(focus[0] - 1.2, -1.4), ha="center", fontsize=9.5, color=RED, arrowprops=line)
    ax.set(xlim=(-1.9, focus[0] + 1.4), ylim=(-1.5, 1.15))


def draw_lens() -> Figure:
    """Parallel rays through a lens with its focus; lengths are in radii of the rim."""
    figure, (ax,) = make_figure("A lens, and the lensmaker's equation", 1, 1, (12, 5.6))
    bend, thickness = 0.36, 0.8
    form = {"curvature1": bend, "curvature2": -bend, "thickness": thickness, "diameter": 2}
    lens = build.lens("lens", material="glass", center=(0, 0, 0), axis=(1, 0, 0), **form)
    y = np.linspace(-1, 1, 101)
    sag = bend * y**2 / (1 + np.sqrt(1 - (bend * y) ** 2)) - thickness / 2
    outline = np.concatenate([[sag, y], [-sag, -y]], axis=1).T
    draw_beam(ax, lens, outline, thickness / 2, optics.lensmaker_focal_length(bend, -bend, INDEX, thickness))
    return figure


def draw_ball() -> Figure:
    """Three panels: rays through a glass ball, deviation by a drop, and its derivative by the index."""
    figure, (rays, turn, slope) = make_figure("A ray through a ball", 1, 3, (15, 5))
    water = 1.333
    glass = build.sphere("ball", material="glass", center=(0, 0, 0), radius=1)
    outline = np.array([unit(angle) for angle in range(360)])
    draw_beam(rays, glass, outline, 1, optics.lens_focal_length(1.0, INDEX))
    distance = np.linspace(0, 0.9999, 600)
    theta = np.arcsin(distance)
    for k, name in enumerate(("straight through", "one reflection inside", "two reflections inside")):
        color = COLOURS[k]

        def deviation(n, theta=theta, k=k):
            return jnp.degrees(optics.sphere_deviation(theta, n, k))

        draw_by_index((turn, slope), distance, deviation, np.full_like(theta, water), color=color, label=name)
        closed = 2 * (k + 1) * np.tan(np.arcsin(distance / water)) / water
        slope.plot(distance[::40], np.degrees(closed)[::40], ".", color=color)
        if k:
            incidence = optics.rainbow_incidence(water, k)
            degrees = float(deviation(water, np.asarray(incidence)))
            least = float(np.sin(incidence)), degrees
            turn.plot(*least, "o", color=color)
            words = f"rainbow: least, {degrees:.1f}°"
            turn.annotate(words, least, xytext=(-6, -14), textcoords="offset points", ha="right", fontsize=9)
    turn.set_ylim(0, 370)
    title, distance_words = f"deviation by a drop of water, n = {water:g}", "distance from the axis [radii]"
    finish(turn, title, distance_words, "deviation [degrees]", loc="upper right")
    change = "dD/dn [degrees per unit of index]"
    finish(slope, "its derivative by the index", distance_words, change, loc="upper left")
    return figure
