"""Drawings of a pixel's tree of rays from the side, with the shapes cut by the plane nearest to the rays."""

import jax
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from ..images import Transfer
from ..scene.parameters import Block, material_of, shape_blocks
from ..scene.scene import Scene
from ..scene.slabs import with_planes
from ..tracer.geometry.shape_types import SHAPE_TYPES, all_faces, shapes_of_numbers
from ..tracer.geometry.shapes import CuttingPlane, Section
from ..tracer.ray_tree import KINDS, RayNode, RayTree
from ..tracer.settings import RenderSettings, ResolvedSettings, resolve_settings
from ..util.numerics import TINY
from .films import screen_transfer
from .panels import as_pixels, drawable

COLOURS = {"camera": "#24292f", "reflected": "#d1570c", "transmitted": "#0a62c9"}


def fit_view(points: Float[np.ndarray, "points 3"], root: RayNode) -> CuttingPlane:
    """The plane nearest to the points, seen so that y is as upright as it can be and the camera's ray runs right."""
    center = points.mean(axis=0)
    spread = (points - center).T @ (points - center)
    vertical = np.array([0.0, 1.0, 0.0])
    # Of the planes through a single line the upright one is taken, of the upright ones y-z: a view in which y runs
    # upwards is preferred by a thousandth of the rays' spread.
    preference = np.outer(vertical, vertical) + np.diag([0, 0, 1e-3])
    _, axes = np.linalg.eigh(spread / max(np.trace(spread), TINY) + 1e-3 * preference)
    normal = axes[:, 0]
    up = vertical - (vertical @ normal) * normal
    if np.linalg.norm(up) < 0.3:  # A view from above: what is far away is up.
        up = np.array([0, 0, -1.0]) + normal[2] * normal
    up = up / np.linalg.norm(up)
    right = np.cross(up, normal)
    # From the side light runs to the right, from above x does; turned round, not mirrored.
    if right @ (root.d if abs(normal[1]) < 0.9 else np.array([1.0, 0, 0])) < 0:
        right, normal = -right, -normal
    return CuttingPlane(center, right, up, normal)


def sections(scene: Scene, view: CuttingPlane, reach: float, settings: ResolvedSettings) -> dict[str, Section]:
    """Each shape as a drawing shows it that reaches so far from the plane's centre, by name in the file's order."""
    shapes = jax.tree.map(np.asarray, shapes_of_numbers(scene, settings))
    every = zip(scene.shape_order, shapes.types, all_faces(shapes), strict=True)
    return {name: SHAPE_TYPES[kind].section(faces, view, reach) for name, kind, faces in every}


def window(
    tree: RayTree, shown: dict[str, Section], view: CuttingPlane
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower and upper corner of what is shown: the hits, the balls around transmitted rays, some of the first ray."""
    ends = [view.project(node.p) for node in tree.nodes if node.shape is not None]
    hit = {node.number: node.shape for node in tree.nodes}
    crossed = {hit[node.parent] for node in tree.nodes if node.parent is not None and node.kind == KINDS[1]}
    ends += [point for name, section in shown.items() if name in crossed for point in section.outline]
    root = tree.nodes[0]
    ends = ends or [view.project(root.o), view.project(root.o + root.d)]
    low, high = np.min(ends, axis=0), np.max(ends, axis=0)
    size = max(float(np.max(high - low)), 0.5 if root.shape is None else 0.5 * root.distance)
    if root.shape is not None:
        # The camera is far away: its ray is shown up to 0.35 of what all others take up.
        lead = view.project(root.p - min(0.35 * size, root.distance) * root.d)
        low, high = np.minimum(low, lead), np.maximum(high, lead)
    # The shorter side is at least 0.6 of the longer one, which title and labels need.
    middle, half = (low + high) / 2, (high - low) / 2 + 0.1 * size
    half = np.maximum(half, 0.6 * half.max())
    return middle - half, middle + half


def draw_tree(
    tree: RayTree, scene: Scene, title: str = "", settings: RenderSettings | None = None, least: float = 0.0
) -> Figure:
    """Draw the rays of a pixel, coloured by kind and as thick as they count, over the shapes that they meet.

    A shape is drawn where the plane of the drawing cuts it, a ball also by its outline (dotted). The number at the end
    of a ray is its number in the tree, on the colour that it brings back, as the picture's PNG has it. The first
    surfaces on the path that counts most have their normals (dashed) and angles; glass has its index beside its name.

    `settings` are those with which the rays were traced; None is what the scene's file says. Rays that count less than
    `least` in the pixel are left out.
    """
    # The plane of the drawing is the one nearest to the hits that are drawn, or to the way of a ray that hits nothing.
    scene, settings = with_planes(scene), resolve_settings(scene, settings)
    tree = tree._replace(nodes=tuple(node for node in tree.nodes if node.weight >= least))
    root = tree.nodes[0]
    hits = [node.p for node in tree.nodes if node.shape is not None]
    points = np.array([root.o, *(hits or [root.o + root.d])], np.float64)
    view = fit_view(points, root)
    # Outlines say how much there is to show, and that, how far lines have to reach.
    low, high = window(tree, sections(scene, view, 1.0, settings), view)
    size = float(np.max(high - low))
    shown = sections(scene, view, float(np.linalg.norm(high - low) + np.linalg.norm(low + high) / 2), settings)

    # The drawing's longer side is 8 inches; the legend goes beside it, the title above it. Their room is known, and
    # matplotlib's search for it draws all of it again.
    inches = 8.0 * (high - low) / size
    width, height = inches + np.array([2.8, 1.1])
    figure = Figure(figsize=(width, height), dpi=150)
    ax = figure.add_axes((0.8 / width, 0.55 / height, inches[0] / width, inches[1] / height))
    ax.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal")
    _draw_shapes(ax, scene, shown, {node.shape for node in tree.nodes}, list(view.project(points)))
    for node in tree.nodes:
        # A ray that hits nothing is a stub.
        _draw_ray(ax, node, view, 0.12 * size)
    written = _draw_angles(ax, tree, view, 0.06 * size)
    _draw_numbers(ax, tree, view, 0.02 * size, screen_transfer(settings), written)

    # The drawing is a projection: its axes are directions as the camera sees them, and what lies off its plane is said.
    upright = np.asarray(getattr(scene.camera, "up", (0, 1, 0)))
    across, upwards = (f"{_direction(axis, root.d, upright)} [world units]" for axis in (view.right, view.up))
    ax.set(xlabel=across, ylabel=upwards)
    off = float(np.abs((points - view.center) @ view.normal).max())
    note = f"points lie up to {off:.2g} world units before or behind the plane of the drawing"
    ax.set_title(f"{drawable(title, 110)}\n{note}", fontsize=10, loc="left", parse_math=False)
    _draw_legend(ax, tree)
    return figure


def transparent_shapes(scene: Scene) -> set[str]:
    """The names of the shapes that let light through."""
    # The weights of all models: a scene for one of them leaves the others' at 0.
    materials = {shape.name: material_of(scene, shape) for shape in shape_blocks(scene)}
    weights = "alpha", "transmission"
    return {name for name, block in materials.items() if any(block.read(scene, weight) > 0 for weight in weights)}


def _draw_shapes(
    ax: Axes, scene: Scene, shown: dict[str, Section], hit: set[str | None], busy: list[np.ndarray]
) -> None:
    """Draw and name all shapes, where there is room beside what is `busy`: the hits, and names."""
    low, high = ax.viewLim.get_points()
    glass = transparent_shapes(scene)
    for shape, (cut, is_area, outline) in zip(shape_blocks(scene), shown.values(), strict=True):
        name = shape.name
        if len(outline):
            ax.add_patch(Polygon(outline, fill=False, edgecolor="0.65", linestyle=":", linewidth=0.8))
        named = cut if len(cut) or not is_area else outline
        inside = named[np.all((named >= low) & (named <= high), axis=1)]
        if is_area and len(cut):
            face = "#dcecfb" if name in glass else "#e9e9e9"
            ax.add_patch(Polygon(cut, facecolor=face, edgecolor="0.4", linewidth=1.0, alpha=0.75))
        elif len(inside) and not is_area:
            ax.plot(*inside.T, color="0.4", linewidth=1.6, solid_capstyle="butt", zorder=1.5)
        if not len(inside) or (is_area and not len(cut) and name not in hit):
            continue
        points, room, words = inside[(np.linspace(0.1, 0.85, 16) * len(inside)).astype(int)], np.inf, ""
        rises = np.prod(inside[-1] - inside[0]) > 0
        if is_area:
            # The name of a body stands above what the drawing cuts of it, or above its outline; beside hits, lower.
            low_end, high_end = inside.min(axis=0), inside.max(axis=0)
            top = (low_end + high_end) / 2 * [1, 0] + high_end * [0, 1]
            points = np.array([top, *points[points[:, 1] > (low_end[1] + high_end[1]) / 2]])
            room = 0.04 * np.max(high - low)
            words = f", n = {_index(scene, material_of(scene, shape))}" if name in glass else ""
        point = max(points, key=lambda point: min(room, *(np.linalg.norm(point - other) for other in busy)))
        busy.append(point)
        _name(ax, drawable(name, 26) + words, point, bool(point[0] < points[0, 0] if is_area else rises))


def _name(ax: Axes, name: str, place: np.ndarray, rises: bool) -> None:
    """Write a name beside its place, within the drawing, to the left of a line that rises."""
    low, high = ax.viewLim.get_points()
    # A letter is a hundred-and-twentieth of the drawing's longer side, which is 8 inches.
    size = np.array([len(name) / 120, 0.025]) * np.max(high - low)
    right, up = place + size > high
    right |= rises and place[0] - size[0] > low[0]
    looks = {"color": "0.35", "fontsize": 8, "style": "italic", "annotation_clip": True, "clip_on": True}
    where = {"ha": "right" if right else "left", "va": "top" if up else "bottom", "textcoords": "offset points"}
    beside = (-3 if right else 3, -3 if up else 3)
    # A file's names may hold dollar signs.
    ax.annotate(name, tuple(place), parse_math=False, xytext=beside, **where, **looks)


def _draw_ray(ax: Axes, node: RayNode, view: CuttingPlane, stub: float) -> None:
    missed, color = node.shape is None, COLOURS[node.kind]
    start, end = view.project(node.o), view.project(node.o + node.d * stub if missed else node.p)
    style = {"linewidth": 0.7 + 3.3 * node.weight, "linestyle": (0, (2, 1.5)) if missed else "-", "alpha": 0.85}
    ax.plot(*zip(start, end, strict=True), zorder=3, solid_capstyle="round", color=color, **style)
    tip = start + (end - start) * (1.0 if missed else 0.55)
    arrow = {"arrowstyle": "-|>", "color": color, "alpha": 0.9, "mutation_scale": 8 + 5 * node.weight}
    ax.annotate("", tuple(tip), xytext=tuple(tip - (end - start) * 1e-2), arrowprops=arrow, zorder=3.5)


def least_drawn(settings: ResolvedSettings) -> float:
    """What a ray has to count at least in a pixel to be drawn where nobody says."""
    # A path through glass splits at every surface: of the 33 rays behind pixel 360 220 of `bubble` 18 count less,
    # too little to see in a picture.
    return 0.005 if settings.model == "physical" else 0.0


def main_path(tree: RayTree) -> list[RayNode]:
    """The first two rays that hit something: the camera's, or none, and the one of its own that counts most."""
    path, node = [], tree.nodes[0]
    while node is not None and node.shape is not None and len(path) < 2:
        path.append(node)
        children = [child for child in tree.nodes if child.parent == node.number and child.shape is not None]
        node = max(children, key=lambda child: child.weight, default=None)
    return path


def _draw_angles(ax: Axes, tree: RayTree, view: CuttingPlane, radius: float) -> list[np.ndarray]:
    """Draw the normals of the main path's surfaces with the angles to them; returned is where these are written."""
    written = []
    for node in main_path(tree):
        outward = node.n if node.entering else -node.n  # To the side that the ray comes from.
        point, normal = view.project(node.p), view.project(node.p + outward) - view.project(node.p)
        if (length := np.linalg.norm(normal)) < 0.5:  # The drawing's plane does not show its angles.
            continue
        normal = normal / length
        ends = point + 2.5 * radius * np.multiply.outer((-1, 1), normal)
        ax.plot(*ends.T, color="0.3", linewidth=0.8, linestyle=(0, (5, 3)), zorder=2.5)
        rays = [(-node.d, normal, f"{np.degrees(node.theta_i):.1f}°{', total' if node.total else ''}")]
        through = [child.d for child in tree.nodes if child.parent == node.number and child.kind == KINDS[1]]
        if node.theta_t is not None:
            rays += [(d, -normal, f"{np.degrees(node.theta_t):.1f}°") for d in through]
        for direction, axis, words in rays:
            side = view.project(node.p + direction) - point
            start = np.arctan2(axis[1], axis[0])
            turn = np.arctan2(axis[0] * side[1] - axis[1] * side[0], axis @ side)
            angles = start + np.linspace(0, turn, 20)
            arc = point + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1)
            ax.plot(*arc.T, color="0.3", linewidth=0.8, zorder=3.2)
            # Beyond the arc on the ray's other side of the normal, where neither of the two is crossed.
            away = start - np.sign(turn) * 0.3
            places = [point + far * radius * np.array([np.cos(away), np.sin(away)]) for far in (1.6, 2.3, 3.0)]
            free = (p for p in places if all(np.linalg.norm(p - other) > radius for other in written))
            place = next(free, places[0])
            box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
            ax.text(place[0], place[1], words, fontsize=8, ha="center", va="center", bbox=box, clip_on=True, zorder=4.5)
            written.append(place)
    return written


def _draw_numbers(
    ax: Axes, tree: RayTree, view: CuttingPlane, size: float, transfer: Transfer, written: list[np.ndarray]
) -> None:
    """Number each hit beside its point, where nothing is `written`, on the colour that a screen shows of its ray."""
    angles = np.arange(12) * np.pi / 6
    around = 1.5 * size * np.multiply.outer((1, 2, 3, 4), np.stack([np.cos(angles), np.sin(angles)], axis=1))
    occupied = list(written)
    for node in tree.nodes:
        if node.shape is None:
            continue
        point = view.project(node.p)
        ax.plot(*point, marker="o", markersize=2.5, color="0.1", zorder=4)
        spots = point + around.reshape(-1, 2)
        spot = next((s for s in spots if all(np.linalg.norm(s - t) > 1.7 * size for t in occupied)), point)
        occupied.append(spot)
        color = as_pixels(np.asarray(node.color)[:, None, None], transfer)[0, 0] / 255
        looks = {"fontsize": 7, "color": "white" if color @ [0.3, 0.6, 0.1] < 0.5 else "black"}
        circle = {"boxstyle": "circle,pad=0.25", "facecolor": tuple(color), "edgecolor": "0.3", "linewidth": 0.6}
        line = {"arrowstyle": "-", "color": "0.5", "linewidth": 0.5, "shrinkA": 0}
        where = {"xytext": tuple(spot), "ha": "center", "va": "center", "zorder": 5}
        ax.annotate(str(node.number), tuple(point), bbox=circle, arrowprops=line, **where, **looks)


def _draw_legend(ax: Axes, tree: RayTree) -> None:
    kinds = {node.kind for node in tree.nodes}
    lines = [Line2D([], [], color=color, linewidth=2.2, label=kind) for kind, color in COLOURS.items() if kind in kinds]
    if any(node.shape is None for node in tree.nodes):
        lines.append(Line2D([], [], color="0.4", linewidth=1.2, linestyle=(0, (2, 1.5)), label="hits nothing"))
    if tree.nodes[0].shape is not None:
        lines.append(Line2D([], [], color="0.3", linewidth=0.8, linestyle=(0, (5, 3)), label="normal of a surface"))
    title = "rays, as thick as they count;\nnumbers lie on the colour\nthat the ray brings back"
    looks = {"fontsize": 8, "title_fontsize": 8, "frameon": False, "alignment": "left"}
    # Below the title, which may be longer than the drawing.
    ax.legend(handles=lines, title=title, loc="upper left", bbox_to_anchor=(1, 1), **looks)


def _index(scene: Scene, material: Block) -> str:
    """The index of refraction of a material in words, from red to blue where it has dispersion."""
    ends = np.ravel(material.read(scene, "ior"))[[0, -1]]
    return "–".join(dict.fromkeys(f"{float(n):.4g}" for n in ends))


def _direction(axis: np.ndarray, forward: np.ndarray, up: np.ndarray) -> str:
    """A unit vector in words of who looks along `forward`: what makes a fifth of it or more, largest first."""
    up = up - (up @ forward) * forward
    up = up / max(float(np.linalg.norm(up)), TINY)
    right = np.cross(forward, up)
    named = {"to the right": right, "up": up, "away from the camera": forward}
    named |= {"to the left": -right, "down": -up, "towards the camera": -forward}
    parts = {words: float(axis @ direction) for words, direction in named.items()}
    shown = (words for words in parts if parts[words] > 0.2)
    return ", ".join(sorted(shown, key=lambda words: -parts[words]))
