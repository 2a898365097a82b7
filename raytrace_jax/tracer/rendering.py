"""From a scene to a picture: the one place where tracing is cut into tiles, spread over devices and compiled."""

import functools
from collections.abc import Callable, Hashable, Sequence
from typing import TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.geometry.rays import camera_rays
from raytrace_jax.tracer.plan import Plan, make_stages, plan_render, plan_window, tile_pixels
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.wavefront import Trace, prepare_world, trace
from raytrace_jax.util.compilation import jit

T = TypeVar("T")

BATCH = 1024
"""Pixels of a list that are traced at once, for each device."""

SAMPLED = 16
"""How many scenes are counted, at most, to plan for all of a sequence."""

_plans: dict = {}
"""The plan last used for each kind of scene and settings, so that a moved parameter does not plan anew."""


def render(scene: Scene, settings: RenderSettings = RenderSettings(), plan: Plan | None = None) -> Film:
    """Render a scene.

    Pure, and differentiable in forward and reverse mode with respect to every array of the scene. Under a
    transformation of JAX (`jit`, `grad`, `jvp`, `vmap`) the scene's values are not known while it is traced: make the
    plan first, `plan = plan_render(scene, settings)`, pass it, and see that `film.overflow` stays 0.

    Args:
        scene: the scene; its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render; one compile for each.
        plan: sizes for the tracer's arrays; None takes those that served last for such a scene, or makes new ones.

    Raises:
        ValueError: no plan although the scene is traced; a crop outside of the picture.
    """
    settings.window(scene.camera.pixeldim)
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene))
    if traced:
        if plan is None:
            raise ValueError("render() inside of a JAX transformation needs plan=plan_render(scene, settings)")
        film, _ = render_planned(scene, settings, plan)
        return film

    return run_remembered(lambda plan: _compiled(scene, settings, plan), scene, settings, plan)


def render_pixels(
    scene: Scene, pixels: Int[np.ndarray, "2 pixels"], settings: RenderSettings = RenderSettings()
) -> Float[np.ndarray, "3 pixels"]:
    """Some pixels of a picture, as `render` has them up to rounding; any number of them is one compile.

    Args:
        scene: the scene, with concrete values.
        pixels: columns and rows, counted in the whole picture from its top left, also where the settings have a crop.
        settings: what to render.
    """
    count, size = pixels.shape[1], jax.device_count() * BATCH
    image = np.zeros((3, count), scene.camera.viewpoint.dtype)
    batches = -(-count // size)
    for first in range(batches):
        # As a tile, a batch is spread over all the pixels; the last places of some are filled with others.
        places = np.arange(first, batches * size, batches) % count
        batch = jnp.asarray(pixels[:, places], jnp.int32)
        film = run_remembered(
            lambda plan, batch=batch: _compiled(scene, settings, plan, batch), scene, settings, pixels=batch
        )
        image[:, places] = film.image[:, 0]
    return image


def plan_ahead(scenes: Sequence[Scene], settings: RenderSettings) -> None:
    """Remember a plan that holds the rays of all these scenes, so that rendering them compiles once.

    At most `SAMPLED` of them are counted, spread evenly over the sequence; a scene that needs more room than these is
    planned anew, as ever. Where a plan for such scenes is remembered already, nothing changes.

    Args:
        scenes: one at least, all of one structure, with concrete values.
        settings: what will be rendered.
    """
    key = _kind(scenes[0], settings)
    if key not in _plans:
        places = np.unique(np.linspace(0, len(scenes) - 1, SAMPLED).round().astype(int))
        first, *others = (scenes[place] for place in places)
        _plans[key] = plan_render(first, settings, others=others)


def run_remembered(
    program: Callable[[Plan], tuple[T, Int[Array, " levels"]]],
    scene: Scene,
    settings: RenderSettings,
    plan: Plan | None = None,
    pixels: Int[Array, "2 pixels"] | None = None,
) -> T:
    """Run a program as `run_with_room`, with the plan that served such a scene last, and remember the one that serves.

    Args:
        program: as for `run_with_room`.
        scene: what is rendered, with concrete values.
        settings: how.
        plan: the first plan to try; None takes the one remembered, or makes a new one.
        pixels: those that are rendered, as for `render_planned`; None is the window.
    """
    key = _kind(scene, settings, None if pixels is None else pixels.shape)
    plan = plan or _plans.get(key) or plan_render(scene, settings, pixels=pixels)
    result, _plans[key] = run_with_room(program, plan, settings)
    return result


def _kind(scene: Scene, settings: RenderSettings, pixels: tuple[int, ...] | None = None) -> Hashable:
    """What scenes, settings and lists of pixels (of that shape) have in common that can share a plan."""
    return settings, jax.tree.structure(scene), scene.camera.viewpoint.dtype, jax.device_count(), pixels


def run_with_room(
    program: Callable[[Plan], tuple[T, Int[Array, " levels"]]], plan: Plan, settings: RenderSettings
) -> tuple[T, Plan]:
    """Run a program, with larger plans until no ray lacks room; its result and the plan that served.

    Args:
        program: from a plan to a result and the rays wanted at each level, as `render_planned`.
        plan: the first plan to try.
        settings: what is rendered.
    """
    while True:
        result, wanted = program(plan)
        if not too_many(plan, wanted):
            return result, plan
        # More rays than room: enlarge each level to what was wanted of it, later ones at least in proportion.
        plan = enlarge(plan, np.asarray(wanted), settings)


def enlarge(plan: Plan, wanted: Int[np.ndarray, " levels"], settings: RenderSettings) -> Plan:
    """A plan that holds what the largest tile wanted, and more at levels that an overflow has hidden."""
    old = np.zeros(len(wanted))
    old[: len(plan.capacities) - 1] = plan.capacities[1:]
    growth = np.maximum.accumulate(np.maximum(wanted / np.maximum(old, 1), 1) * (old > 0) + (old == 0))
    share = np.maximum(wanted, old * growth) / plan.tile_size
    return Plan(plan.tiles, plan.tile_size, make_stages(share, plan.tile_size, 1.06, settings))


def too_many(plan: Plan, wanted: Int[Array, " levels"]) -> Int[Array, ""]:
    """How many rays found no room, summed over levels, in the tile that wanted most."""
    capacities = jnp.asarray((*plan.capacities[1:], 0)[: wanted.shape[0]], jnp.int32)
    return jnp.sum(jnp.maximum(wanted - capacities, 0))


def render_planned(
    scene: Scene, settings: RenderSettings, plan: Plan, pixels: Int[Array, "2 pixels"] | None = None
) -> tuple[Film, Int[Array, " levels"]]:
    """The picture, and for each level the most rays that a tile wanted there. Pure, for use under transformations.

    Args:
        scene: the scene.
        settings: what to render.
        plan: sizes for the tracer's arrays.
        pixels: columns and rows in the whole picture of the pixels to render, as one row, instead of the window.
    """
    world = prepare_world(scene)
    window = plan_window(scene, settings, pixels)
    _, _, width, height = window
    dtype = scene.camera.viewpoint.dtype

    def trace_offset(tile, offset: Float[Array, "2"]) -> Trace:
        column, row, live = tile_pixels(tile, plan, window, pixels)
        rays = camera_rays(scene.camera, settings, column.astype(dtype) + offset[0], row.astype(dtype) + offset[1])
        return trace(world, rays, live, plan.stages, settings)

    def tile_color(tile):
        if settings.samples == 1:
            traced = trace_offset(tile, jnp.zeros(2, dtype))
            return traced.color, traced.wanted

        def add_sample(total, offset):
            traced = trace_offset(tile, offset)
            return total + traced.color, traced.wanted

        grid = (np.arange(settings.samples) + 0.5) / settings.samples - 0.5
        offsets = np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)
        black = jnp.zeros((3, plan.stages[0].capacity), dtype)
        total, wanted = jax.lax.scan(jax.checkpoint(add_sample, prevent_cse=False), black, jnp.asarray(offsets, dtype))
        return total / len(offsets), jnp.max(wanted, axis=0)

    def tile_aov(tile):
        traced = trace_offset(tile, jnp.zeros(2, dtype))
        first = traced.first
        values = {
            "depth": first.t,
            "normal": first.n,
            "position": first.p,
            "shape_index": first.shape,
            "bounce_count": traced.bounce_count,
        }
        missing = {"shape_index": -1}
        return {name: jnp.where(first.valid, values[name], missing.get(name, 0)) for name in settings.aov}

    def tile_outputs(tile):
        color, wanted = tile_color(tile)
        return color, wanted, tile_aov(tile) if settings.aov else {}

    color, wanted, aov = map_tiles(jax.checkpoint(tile_outputs, prevent_cse=False), plan.tiles)

    def to_image(tiles):
        pixels = jnp.moveaxis(tiles[..., : plan.tile_size], 0, -1)
        return pixels.reshape(*tiles.shape[1:-1], -1)[..., : width * height].reshape(*tiles.shape[1:-1], height, width)

    wanted = jnp.max(wanted, axis=0)
    overflow = too_many(plan, wanted)
    return Film(to_image(color), {name: to_image(values) for name, values in aov.items()}, overflow), wanted


def map_tiles(function, tiles: int):
    """`function(tile)` for every tile number, stacked; tiles are shared out evenly over all devices."""
    numbers = jnp.arange(tiles, dtype=jnp.int32)
    if jax.device_count() == 1:
        return jax.lax.map(function, numbers)
    mesh = jax.make_mesh((jax.device_count(),), ("tiles",), axis_types=(jax.sharding.AxisType.Auto,))
    shares = PartitionSpec("tiles")
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    share = jax.shard_map(
        functools.partial(jax.lax.map, function), mesh=mesh, in_specs=shares, out_specs=shares, check_vma=False
    )
    return share(numbers)


@functools.partial(jit, static_argnames=("settings", "plan"))
def _compiled(scene: Scene, settings: RenderSettings, plan: Plan, pixels: Int[Array, "2 pixels"] | None = None):
    return render_planned(scene, settings, plan, pixels)
