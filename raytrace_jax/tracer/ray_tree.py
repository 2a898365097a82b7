"""The rays of one pixel as a tree of nodes."""

import functools
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.errors import RaytraceError, SettingsError
from raytrace_jax.optics import refract
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.geometry.rays import NO_SHAPE, Rays, unpacked
from raytrace_jax.tracer.levels.compaction import BLOCK, Packing, pack_rays
from raytrace_jax.tracer.levels.integrator import (
    ChildResult,
    Level,
    RayRecord,
    combine,
    trace_level,
)
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.shading.model import materials_at
from raytrace_jax.tracer.shading.models import MODELS
from raytrace_jax.tracer.world import World, prepare_world
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import dot

RayKind = Literal["camera", "reflected", "transmitted"]
KINDS: tuple[RayKind, ...] = ("reflected", "transmitted")


class RayNode(NamedTuple):
    """A ray, what it hits, and the colour that it brings back.

    Args:
        number: its place in the tree; parents come before their children, and 0 is the camera's ray.
        bounce: how many rays lie before it on its path.
        weight: about how much its colour counts in the pixel's: the product of the weights along its path.
        o: where it starts, world units.
        shape: name of the shape that it hits; None if it hits nothing, and then what follows has no meaning but for
            the colour, which is black.
        distance: from `o` to `p`, world units.
        path_length: of the whole path from the viewpoint to `p`; ambient light falls off with it.
        entering: whether it comes from the side that the normal points to.
        theta_i: angle of incidence in radians, 0 to pi / 2.
        theta_t: angle of refraction in radians; None where nothing is transmitted.
        total: whether there is total internal reflection.
        reflect: weight of the reflected ray in this one's colour, of the largest channel; 0 if there is none.
        color: what the ray brings back, scene-linear RGB.
        medium: name of the shape whose glass it runs through; None in vacuum, in models without media, and where the
            ray hits nothing.
        absorbed: the share of its light that is absorbed there, the mean of the channels.
    """

    number: int
    parent: int | None
    kind: RayKind
    bounce: int
    weight: float
    o: Float[np.ndarray, "3"]
    d: Float[np.ndarray, "3"]
    shape: str | None
    p: Float[np.ndarray, "3"]
    n: Float[np.ndarray, "3"]
    distance: float
    path_length: float
    entering: bool
    theta_i: float
    theta_t: float | None
    total: bool
    reflect: float
    transmit: float
    color: Float[np.ndarray, "3"]
    medium: str | None = None
    absorbed: float = 0.0


class RayTree(NamedTuple):
    """All rays of one pixel.

    Args:
        pixel: column and row, from the top left of the picture.
        nodes: the rays, level by level; the first is the camera's and has the pixel's colour.
        dropped: how many more rays were wanted after the last bounce that the settings allow; they count as black.
    """

    pixel: tuple[int, int]
    nodes: tuple[RayNode, ...]
    dropped: int


MOST_RAYS = 64 * BLOCK
"""No level of a tree may hold more rays: the tree could not be read, and doubles with each further bounce."""


class TracedLevel(NamedTuple):
    """One level of the tree: its rays, what became of them, and where the next level's come from (None: nowhere)."""

    rays: Rays
    live: Bool[Array, " rays"]
    level: Level
    details: dict[str, Array]
    packing: Packing | None


def trace_tree(scene: Scene, pixel: tuple[int, int], settings: RenderSettings | None = None) -> RayTree:
    """Trace one pixel of a picture and keep every ray.

    The colour of the first ray is that of the pixel in `render(scene, settings)`, up to rounding.

    Args:
        pixel: column and row, counted in the whole picture from its top left, also where the settings have a crop.
        settings: what to render, one sample a pixel, without awareness of edges; None is what the scene's file says.

    Raises:
        SettingsError: a pixel outside of the picture or of the crop, a crop outside of the picture, or settings for
            which a pixel is not one ray.
        RaytraceError: more than 4096 rays after one number of bounces.
    """
    settings = resolve_settings(scene, settings)
    x, y, width, height = settings.window(scene.camera.pixeldim)
    column, row = pixel
    if not (x <= column < x + width and y <= row < y + height):
        columns, rows = f"{x} to {x + width - 1}", f"{y} to {y + height - 1}"
        raise SettingsError(
            f"pixel {column} {row} does not lie in the picture: columns are {columns}, rows are {rows}."
        )
    if settings.samples != 1:
        raise SettingsError(f"samples is {settings.samples}; a tree of rays is that of one sample.")
    if settings.edges == "aware":
        raise SettingsError(f"edges is {settings.edges!r}; a tree of rays is that of a point.")

    dtype = scene.camera.viewpoint.dtype
    world, rays = _start(scene, jnp.full(BLOCK, column, dtype), jnp.full(BLOCK, row, dtype), settings)
    levels = _descend(world, rays, settings)
    nodes, dropped = _as_nodes(levels, _colors(levels, settings), scene.shape_order)
    return RayTree((column, row), nodes, dropped)


@functools.partial(jit, static_argnames="settings")
def _start(
    scene: Scene, column: Float[Array, " rays"], row: Float[Array, " rays"], settings: ResolvedSettings
) -> tuple[World, Rays]:
    return prepare_world(scene, settings), camera_rays(scene.camera, settings, column, row)


def _descend(world: World, rays: Rays, settings: ResolvedSettings) -> list[TracedLevel]:
    """Trace level after level; arrays are padded, so that levels of up to 64 rays are one compiled program."""
    live = jnp.arange(BLOCK) == 0
    levels: list[TracedLevel] = []
    for bounce in range(settings.bounces + 1):
        level, details, below = _step_with_room(world, rays, live, bounce, settings)
        if below is None or bounce == settings.bounces or int(below[1].count) == 0:
            return [*levels, TracedLevel(rays, live, level, details, None)]
        levels.append(TracedLevel(rays, live, level, details, below[1]))
        rays, live = below[0], below[1].live
    return levels


def _step_with_room(world: World, rays: Rays, live: Bool[Array, " rays"], bounce: int, settings: ResolvedSettings):
    """`_step` with room for all rays of the next level."""
    capacity = BLOCK
    while True:
        found = _step(world, rays, live, jnp.full(live.shape, bounce, jnp.int32), settings, capacity)
        count = 0 if found[2] is None else int(found[2][1].count)
        if count <= capacity:
            return found
        if count > MOST_RAYS:
            wanted = f"{count} rays after {bounce + 1} bounces"
            raise RaytraceError(f"the tree has {wanted}, more than {MOST_RAYS}; allow fewer bounces.")
        capacity = -(-count // BLOCK) * BLOCK


@functools.partial(jit, static_argnames=("settings", "capacity"))
def _step(
    world: World,
    rays: Rays,
    live: Bool[Array, " rays"],
    number: Int[Array, " rays"],
    settings: ResolvedSettings,
    capacity: int,
) -> tuple[Level, dict[str, Array], tuple[Rays, Packing] | None]:
    """One level as the tracer has it, the angles and weights that it does not keep, and the next level's rays."""
    level = trace_level(world, rays, live, number, settings)
    if not level.children:  # An empty scene.
        return level, {}, None
    model, material = MODELS[settings.model], materials_at(world, level.si)
    d_dot_n = dot(rays.d, level.si.n)
    entering = d_dot_n < 0
    media = model.media(world, level.si, entering, settings)
    _, cos_theta_t, total = refract(rays.d, level.si.n, media.eta)
    reflect, transmit = model.child_weights(level.scattering.surface)
    transparent = level.si.valid & (model.transparency(material) > 0)
    wanted = jnp.stack([kind for kind, _ in level.children])
    details = {
        "entering": entering,
        "cos_theta_i": jnp.abs(d_dot_n),
        "cos_theta_t": cos_theta_t,
        "total": total & transparent,
        "refracted": transparent & ~total,
        "weights": jnp.where(wanted, jnp.stack([reflect, transmit]), 0),
    }
    if media.left is not None:
        details |= {"medium": media.front, "absorbed": 1 - jnp.mean(media.left, axis=0)}
    children, packing = pack_rays(level.children, capacity)
    return level, details, (unpacked(children), packing)


def _colors(levels: list[TracedLevel], settings: ResolvedSettings) -> list[np.ndarray]:
    """The colours that the rays of each level bring back, blended from the deepest level up."""
    color, colors = jnp.zeros_like(levels[-1].rays.o), []
    for traced in reversed(levels):
        color = _blend(settings, color, traced.level, traced.packing)
        colors.insert(0, np.asarray(color))
    return colors


@functools.partial(jit, static_argnames="settings")
def _blend(settings: ResolvedSettings, color, level: Level, packing: Packing | None):
    # The place after the last one is black: that of children which were not traced.
    below = ChildResult(jnp.pad(color, ((0, 0), (0, 1))), None, None)
    children = jnp.zeros((0, level.si.valid.size), jnp.int32) if packing is None else packing.slot
    return combine(settings, below, RayRecord.of(level, jnp.zeros(1, jnp.int32), children)).color


def _as_nodes(
    levels: list[TracedLevel], colors: list[np.ndarray], names: tuple[str, ...]
) -> tuple[tuple[RayNode, ...], int]:
    """The rays of all levels as nodes, and how many the last level wanted in vain."""
    nodes: list[RayNode] = []
    origins: list[tuple[int | None, RayKind]] = [(None, "camera")]
    dropped = 0
    for bounce, (traced, color) in enumerate(zip(levels, colors, strict=True)):
        # To numpy once a level: entries of arrays on a device are slow to take one by one.
        rays, si, details = jax.tree.map(np.asarray, (traced.rays, traced.level.si, traced.details))
        # A node for each ray of the level; its weight is its parent's times what the parent sends its way.
        first, slots = len(nodes), rays.o.shape[-1]
        for slot, (parent, kind) in enumerate(origins):
            above = None if parent is None else nodes[parent]
            weight = above.weight * (above.reflect if kind == "reflected" else above.transmit) if above else 1.0
            valid = bool(si.valid[slot])
            medium = int(details["medium"][slot]) if valid and "medium" in details else NO_SHAPE
            angle = _angle(details, "cos_theta_t", slot) if valid and details["refracted"][slot] else None
            nodes.append(
                RayNode(
                    number=len(nodes),
                    parent=parent,
                    kind=kind,
                    bounce=bounce,
                    weight=weight,
                    o=rays.o[:, slot],
                    d=rays.d[:, slot],
                    shape=names[si.shape[slot]] if valid else None,
                    p=si.p[:, slot],
                    n=si.n[:, slot],
                    distance=float(si.t[slot]),
                    path_length=float(si.path_length[slot]),
                    entering=valid and bool(details["entering"][slot]),
                    theta_i=_angle(details, "cos_theta_i", slot) if valid else 0.0,
                    theta_t=angle,
                    total=valid and bool(details["total"][slot]),
                    reflect=float(details["weights"][0, slot]) if valid else 0.0,
                    transmit=float(details["weights"][1, slot]) if valid else 0.0,
                    color=color[:, slot],
                    medium=None if medium == NO_SHAPE else names[medium],
                    absorbed=0.0 if medium == NO_SHAPE else float(details["absorbed"][slot]),
                )
            )
        # Whose child sits in which slot of the next level. The last level's children have none and are dropped.
        if traced.packing is not None:
            places = np.asarray(traced.packing.candidate)[: int(traced.packing.count)].tolist()
            origins = [(first + place % slots, KINDS[place // slots]) for place in places]
        elif traced.level.children:
            dropped = int(sum(np.sum(np.asarray(wanted)) for wanted, _ in traced.level.children))
    return tuple(nodes), dropped


def _angle(details: dict[str, np.ndarray], name: str, slot: int) -> float:
    return float(np.arccos(np.clip(details[name][slot], -1, 1)))
