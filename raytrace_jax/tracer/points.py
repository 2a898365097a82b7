"""The colours seen at points of pictures: one program for any number of points and of scenes, and any size.

It is all that a search, a look at how a target was sampled, a correction and the check of a model need, and compiles
once for all of them; once more where a check looks at edge-aware pixels.
"""

import dataclasses
import functools

import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import map_scenes, without_texels
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.levels.wavefront import trace_channels
from raytrace_jax.tracer.programs.batches import (
    Batch,
    Points,
    Slots,
    fill_slots,
    filling_of,
    in_batches,
    in_front,
    map_batches,
    steps_of_devices,
)
from raytrace_jax.tracer.programs.plan import Plan, Wanted
from raytrace_jax.tracer.programs.plan_cache import scene_kind
from raytrace_jax.tracer.programs.planning import of_rays
from raytrace_jax.tracer.programs.tiles import most
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.textures import prepare_pyramids
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit


def render_points(
    scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> Float[np.ndarray, "scenes 3 points"]:
    """What is seen at each of some points of the pictures of some scenes, as `render` has it up to rounding.

    It is the light that falls on the film, before the film's own effects.

    Args:
        scenes: scenes of one structure, with concrete values, as `scene.stacked` has them.
        points: where to look.
        settings: what to render; what it says of pixels and their edges does not matter.
        step: how far `u` and `v` are from one pixel to the next, as `pixel_step`: then each point stands for the
            edge-aware pixel around it; if it is not given it is one ray's.
    """
    settings = of_points(settings, step)
    scenes = map_scenes(np.asarray, dataclasses.replace(scenes, film=None))
    viewpoint, count = scenes.camera.viewpoint, points.shape[1]
    image = np.zeros((len(viewpoint), 3, count), viewpoint.dtype)

    def trace(slots: Slots, plan: Plan):
        colors, wanted = trace_batches(*arguments(scenes, slots, points, step), settings, plan)
        return (colors,), wanted

    for batch, (color,) in in_batches(len(viewpoint), count, points_kind(scenes, settings), settings, trace):
        image[batch.picture][:, batch.points] = color
    return image


def prepare_points(
    scene: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> None:
    """Compile what `render_points` will run for such points, and run nothing."""
    settings = of_points(settings, step)
    scenes = map_scenes(lambda x: np.asarray(x)[None], dataclasses.replace(scene, film=None))
    plan = filling_of(points_kind(scenes, settings), settings).plan
    slots = fill_slots([Batch(0, np.zeros(1, int))], plan.tile_size)
    trace_batches.prepare(*arguments(scenes, slots, points, step), settings, plan)


def arguments(scenes: Scene, slots: Slots, points: Points, step: Float[np.ndarray, "2"] | None):
    """The arguments of `trace_batches` that are arrays, in order."""
    chosen = map_scenes(lambda x: x[slots.picture], scenes)
    dtype = scenes.camera.viewpoint.dtype
    batches = points[:, slots.points].swapaxes(0, 1).astype(dtype)
    return chosen, batches, slots.live, slots.counts, steps_of_devices(step, dtype)


@functools.partial(jit, static_argnames=("settings", "plan"))
def trace_batches(
    scenes: Scene,
    points: Float[Array, "batches 2 points"],
    live: Int[Array, " batches"],
    counts: Int[Array, " devices"],
    steps: Float[Array, "devices 2"],
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[Float[Array, "batches 3 points"], Wanted]:
    """Trace batches of points, which are spread over devices.

    Args:
        scenes: of each batch, as `scene.stacked` has them.
        points: of each batch.
        live: how many of a batch's points are to be traced, its first ones.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: for each device, how far it is from one pixel to the next.
        settings: what to render.
        plan: of one tile, as large as a batch.

    Returns:
        The colours, and the most rays that a batch wanted at each level.
    """

    def trace_batch(pyramids: tuple[Pyramid, ...], scene: Scene, batch: Float[Array, "2 points"], live, step):
        (u, v), is_live = in_front(plan, batch, live)
        rays = rays_through(scene.camera, settings, u, v, step)
        traced = trace_channels(prepare_world(scene, settings, pyramids), rays, is_live, plan.stages, settings)
        return traced.color[:, : batch.shape[1]], Wanted(traced.wanted)

    # Once for all batches: a loop would make them again for each.
    pyramids = prepare_pyramids(scenes, settings.edges)
    arrays = without_texels(scenes), points, live
    colors, wanted = map_batches(trace_batch, pyramids, *arrays, counts=counts, steps=steps)
    return colors, most(wanted)


def of_points(settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None) -> ResolvedSettings:
    """The settings as far as they matter to points: all pictures of a scene have them in common."""
    return of_rays(dataclasses.replace(settings, edges="point" if step is None else "aware", samples=1))


def points_kind(scenes: Scene, settings: ResolvedSettings):
    """What lists of points have in common whose rays are as many."""
    return "points", scene_kind(scenes, settings)
