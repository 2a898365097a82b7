"""The side view of a pixel's tree of rays: shapes cut by the plane that lies nearest to the rays, rays projected."""

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle

from raytrace_jax.images.png import encode_course
from raytrace_jax.report.fit_report.text import drawable
from raytrace_jax.report.ray_view import View, fit_view, seen_points, window
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.shapes import scene_shapes
from raytrace_jax.tracer.ray_tree import RayNode, RayTree

LONGEST, MARGINS = 8.0, (2.9, 1.2)  # inches: the drawing's longer side, and what goes beside and below it
DPI = 150
COLOURS = {"camera": "#24292f", "reflected": "#d1570c", "transmitted": "#0a62c9"}
THINNEST, THICKEST = 0.7, 4.0
LONGEST_NAME, LONGEST_TITLE = 26, 110
STUB = 0.12
"""How long a ray that hits nothing is drawn, as a share of the view."""


def draw_tree(tree: RayTree, scene: Scene, title: str = "") -> Figure:
    """Draw all rays of a pixel, coloured by kind and as thick as they count, over the shapes that they meet.

    A shape is drawn where the plane of the drawing cuts it, a ball also by its outline (dotted). The number at the end
    of a ray is its number in the tree, on the colour that it brings back, as the course stores it (without gamma).
    The legend lies beside the drawing: save the figure with `bbox_inches="tight"`.

    Args:
        tree: the rays.
        scene: the scene in which they were traced.
        title: what stands above the drawing.
    """
    points = seen_points(tree)
    view = fit_view(points, tree.nodes[0])
    low, high = window(tree, scene, view)
    size = float(np.max(high - low))

    width, height = LONGEST * (high - low) / size + MARGINS
    figure = Figure(figsize=(width, height), dpi=DPI)
    ax = figure.subplots()
    busy = [view.project(p) for p in points]
    _draw_shapes(ax, scene, view, (low, high), {node.shape for node in tree.nodes}, busy)
    for node in tree.nodes:
        _draw_ray(ax, node, view, STUB * size)
    _draw_numbers(ax, tree, view, 0.02 * size)

    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])
    ax.set_aspect("equal")
    ax.set_xlabel(f"along {_vector(view.right)} [world units]")
    ax.set_ylabel(f"along {_vector(view.up)} [world units]")
    off = float(np.abs((points - view.center) @ view.normal).max())
    note = f"points lie up to {off:.2g} world units before or behind the plane of the drawing"
    ax.set_title(f"{drawable(title, LONGEST_TITLE)}\n{note}", fontsize=10, parse_math=False)
    _draw_legend(ax, tree)
    return figure


def _draw_shapes(
    ax: Axes,
    scene: Scene,
    view: View,
    corners: tuple[np.ndarray, np.ndarray],
    hit: set[str | None],
    busy: list[np.ndarray],
) -> None:
    """Draw and name all shapes; planes are named where they are farthest from what is `busy`, the hits and names."""
    shapes = scene_shapes(scene)
    used = dict(zip(scene.planes.names, scene.planes.material, strict=True))
    used |= dict(zip(scene.spheres.names, scene.spheres.material, strict=True))
    # The weights of either model: a scene for one of them leaves the other's at 0.
    through = np.maximum(*(np.asarray(weight) for weight in (scene.materials.alpha, scene.materials.transmission)))
    for index, name in enumerate(scene.shape_order):
        clear = through[used[name]] > 0
        position = np.asarray(shapes.position[:, index], np.float64)
        if shapes.is_sphere[index]:
            _draw_ball(ax, name, position, float(shapes.radius[index]), view, clear, name in hit)
        else:
            _draw_plane(ax, name, position, np.asarray(shapes.normal[:, index], np.float64), view, corners, busy)


def _draw_ball(ax: Axes, name: str, center: np.ndarray, radius: float, view: View, clear: bool, is_hit: bool) -> None:
    """A ball's outline, dotted, and its cut, filled; its name above or below, if it is cut or hit."""
    x, y = view.project(center)
    off = (center - view.center) @ view.normal
    ax.add_patch(Circle((x, y), radius, fill=False, edgecolor="0.65", linestyle=":", linewidth=0.8))
    cut = float(np.sqrt(max(radius**2 - off**2, 0.0)))
    if cut > 0:
        face = "#dcecfb" if clear else "#e9e9e9"
        ax.add_patch(Circle((x, y), cut, facecolor=face, edgecolor="0.4", linewidth=1.0, alpha=0.75))
    if cut > 0 or is_hit:
        _name(ax, name, (x, y + (cut or radius)))


def _draw_plane(
    ax: Axes,
    name: str,
    point: np.ndarray,
    normal: np.ndarray,
    view: View,
    corners: tuple[np.ndarray, np.ndarray],
    busy: list[np.ndarray],
) -> None:
    """The line in which a plane cuts the drawing, as far as it lies in view and behind the image plane."""
    across = np.array([normal @ view.right, normal @ view.up])
    steep = np.linalg.norm(across)
    low, high = corners
    if steep < 1e-6:
        return
    foot = across / steep**2 * ((point - view.center) @ normal)
    along = np.array([-across[1], across[0]]) / steep
    # The course's planes end at z = 0 (course model, 1.2): keep the part of the line that lies behind it.
    reach = np.linalg.norm(high - low) + np.linalg.norm(foot - (low + high) / 2)
    steps = np.linspace(-reach, reach, 2001)
    line = foot + steps[:, None] * along
    z = view.center[2] + line[:, 0] * view.right[2] + line[:, 1] * view.up[2]
    seen = (z <= 0) & np.all((line >= low) & (line <= high), axis=1)
    if not seen.any():
        return
    line = line[seen]
    ax.plot(line[:, 0], line[:, 1], color="0.4", linewidth=1.6, solid_capstyle="butt", zorder=1.5)
    places = line[(np.linspace(0.1, 0.85, 16) * len(line)).astype(int)]
    # A name runs to the right of its place and must not leave the drawing.
    inside = places[places[:, 0] < low[0] + 0.85 * (high - low)[0]]
    place = max(
        inside if len(inside) else places, key=lambda place: min(np.linalg.norm(place - other) for other in busy)
    )
    busy.append(place)
    _name(ax, name, place)


def _name(ax: Axes, name: str, place: np.ndarray | tuple[float, float]) -> None:
    ax.annotate(
        drawable(name, LONGEST_NAME),
        tuple(place),
        parse_math=False,  # A file's names may hold dollar signs.
        xytext=(3, 3),
        textcoords="offset points",
        color="0.35",
        fontsize=8,
        style="italic",
        annotation_clip=True,
        clip_on=True,
    )


def _draw_ray(ax: Axes, node: RayNode, view: View, stub: float) -> None:
    start = view.project(node.o)
    missed = node.shape is None
    end = view.project(node.o + node.d * stub) if missed else view.project(node.p)
    style = {
        "color": COLOURS[node.kind],
        "linewidth": THINNEST + (THICKEST - THINNEST) * node.weight,
        "linestyle": (0, (2, 1.5)) if missed else "-",
        "alpha": 0.85,
    }
    ax.plot(*zip(start, end, strict=True), zorder=3, solid_capstyle="round", **style)
    tip = start + (end - start) * (1.0 if missed else 0.55)
    ax.annotate(
        "",
        xy=tuple(tip),
        xytext=tuple(tip - (end - start) * 1e-2),
        arrowprops={"arrowstyle": "-|>", "color": style["color"], "alpha": 0.9, "mutation_scale": 8 + 5 * node.weight},
        zorder=3.5,
    )


def _draw_numbers(ax: Axes, tree: RayTree, view: View, size: float) -> None:
    """Number each hit beside its point, where no other number is."""
    taken: list[np.ndarray] = []
    for node in tree.nodes:
        if node.shape is None:
            continue
        place = view.project(node.p)
        ax.plot(*place, marker="o", markersize=2.5, color="0.1", zorder=4)
        rings = ((0, -1), *((ring, turn) for ring, turn in itertools.product((1, 2, 3, 4), range(12))))
        offsets = (
            1.5 * size * ring * np.array([np.cos(turn * np.pi / 6), np.sin(turn * np.pi / 6)]) for ring, turn in rings
        )
        spots = (place + offset for offset in itertools.islice(offsets, 1, None))
        spot = next((s for s in spots if all(np.linalg.norm(s - t) > 1.7 * size for t in taken)), place)
        taken.append(spot)
        color = np.asarray(encode_course(np.asarray(node.color)[:, None, None])).reshape(3) / 255
        dark = color @ [0.3, 0.6, 0.1] < 0.5
        ax.annotate(
            str(node.number),
            xy=tuple(place),
            xytext=tuple(spot),
            fontsize=7,
            color="white" if dark else "black",
            ha="center",
            va="center",
            bbox={"boxstyle": "circle,pad=0.25", "facecolor": tuple(color), "edgecolor": "0.3", "linewidth": 0.6},
            arrowprops={"arrowstyle": "-", "color": "0.5", "linewidth": 0.5, "shrinkA": 0},
            zorder=5,
        )


def _draw_legend(ax: Axes, tree: RayTree) -> None:
    kinds = [kind for kind in COLOURS if any(node.kind == kind for node in tree.nodes)]
    lines = [Line2D([], [], color=COLOURS[kind], linewidth=2.2, label=kind) for kind in kinds]
    if any(node.shape is None for node in tree.nodes):
        lines.append(Line2D([], [], color="0.4", linewidth=1.2, linestyle=(0, (2, 1.5)), label="hits nothing"))
    ax.legend(
        handles=lines,
        title="rays, as thick as they count;\nnumbers lie on the colour\nthat the ray brings back",
        loc="upper left",
        bbox_to_anchor=(1.01, 1),
        fontsize=8,
        title_fontsize=8,
        frameon=False,
        alignment="left",
    )


def _vector(v: np.ndarray) -> str:
    return "(" + ", ".join(f"{x + 0.0:.2f}".replace("-0.00", "0.00").replace("-", "−") for x in v) + ")"
