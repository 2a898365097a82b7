"""The colours seen at points of pictures: one program for any number of points and of scenes, and any size.

It is all that a search, a look at how a target was sampled and a correction need, and compiles once for all of them.
The check of a model needs it too, compiled once more where it looks at edge-aware pixels or mostly at glass.
"""

import dataclasses
import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import map_scenes, without_texels
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.programs.batches import (
    BATCHES,
    ROOM,
    Points,
    in_front,
    make_slots,
    map_batches,
    spread_out,
    steps_of_devices,
)
from raytrace_jax.tracer.programs.edge_pixels import trace_pixels
from raytrace_jax.tracer.programs.plan import FEW_RUNS, Plan, Wanted, make_plan
from raytrace_jax.tracer.programs.plan_cache import PLANS, scene_kind
from raytrace_jax.tracer.programs.planning import PROBE, Probe, count_shares, of_rays
from raytrace_jax.tracer.programs.tiles import most
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.textures import prepare_pyramids
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit

BATCH, GPU_BATCH = 2432, 1 << 16
"""Points that are traced at once: on a CPU as few as stay in its cache, two batches a small picture of a search."""


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
    settings, size = of_points(settings, step), batch_size()
    scenes = map_scenes(np.asarray, dataclasses.replace(scenes, film=None))
    kind = points_kind(scenes, settings)
    viewpoint = scenes.camera.viewpoint
    count, batches = points.shape[1], -(-points.shape[1] // size)
    image = np.zeros((len(viewpoint), 3, count), viewpoint.dtype)
    places = spread_out(count, size)

    def plan() -> Plan:
        return plan_points(map_scenes(lambda x: x[0], scenes), points, settings, step)

    work = [(scene, batch) for scene in range(len(viewpoint)) for batch in range(batches)]
    most = BATCHES * jax.device_count()
    for first in range(0, len(work), most):
        scene, batch = np.array(work[first : first + most]).T
        call = make_call(scenes, scene, points[:, places[batch]].swapaxes(0, 1).astype(image.dtype), step)
        trace = functools.partial(trace_batches, *call.arguments, settings)
        # These points may see more glass than those before.
        colors = PLANS.run(trace, kind, plan, settings, recount=True)
        for one, which, color in zip(scene, batch, np.asarray(colors)[call.slot], strict=True):
            image[one][:, places[which]] = color
    return image


def prepare_points(
    scene: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> None:
    """Plan and compile what `render_points` will run for such points, and run nothing."""
    settings = of_points(settings, step)
    scenes = map_scenes(lambda x: np.asarray(x)[None], dataclasses.replace(scene, film=None))
    batch = np.zeros((1, 2, batch_size()), scenes.camera.viewpoint.dtype)
    plan = PLANS.plan(points_kind(scenes, settings), lambda: plan_points(scene, points, settings, step))
    trace_batches.prepare(*make_call(scenes, np.zeros(1, int), batch, step).arguments, settings, plan)


class Call(NamedTuple):
    """The arguments of `trace_batches`, and in which slot each batch is."""

    arguments: tuple[Scene, np.ndarray, np.ndarray, np.ndarray]
    slot: Int[np.ndarray, " batches"]


def make_call(
    scenes: Scene,
    scene: Int[np.ndarray, " batches"],
    points: Float[np.ndarray, "batches 2 points"],
    step: Float[np.ndarray, "2"] | None,
) -> Call:
    """Some batches in the slots of all devices, shared out evenly.

    Args:
        scenes: all scenes.
        scene: which of them each batch is of.
        points: the batches.
        step: as for `render_points`.
    """
    slots = make_slots(len(scene))
    chosen = map_scenes(lambda x: x[scene[slots.source]], scenes)
    steps = steps_of_devices(step, points.dtype)
    return Call((chosen, points[slots.source], slots.counts, steps), slots.slot)


@functools.partial(jit, static_argnames=("settings", "plan"))
def trace_batches(
    scenes: Scene,
    points: Float[Array, "batches 2 points"],
    counts: Int[Array, " devices"],
    steps: Float[Array, "devices 2"],
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[Float[Array, "batches 3 points"], Wanted]:
    """Trace batches of points, which are spread over devices.

    Args:
        scenes: of each batch, as `scene.stacked` has them.
        points: of each batch.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: for each device, how far it is from one pixel to the next.
        settings: what to render.
        plan: of one tile, as large as a batch.

    Returns:
        The colours, and the most rays that a batch wanted at each level.
    """

    def trace_batch(pyramids: tuple[Pyramid, ...], scene: Scene, batch: Float[Array, "2 points"], step):
        (u, v), live = in_front(plan, batch)
        rays = rays_through(scene.camera, settings, u, v, step)
        traced, wanted = trace_pixels(prepare_world(scene, settings, pyramids), rays, live, plan, settings)
        return traced.color[:, : batch.shape[1]], wanted

    # Once for all batches: a loop would make them again for each.
    pyramids = prepare_pyramids(scenes, settings.edges)
    colors, wanted = map_batches(trace_batch, pyramids, without_texels(scenes), points, counts=counts, steps=steps)
    return colors, most(wanted)


def of_points(settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None) -> ResolvedSettings:
    """The settings as they are the same for points of all pictures."""
    return of_rays(dataclasses.replace(settings, edges="point" if step is None else "aware", samples=1))


def batch_size() -> int:
    """How many points are traced at once."""
    return BATCH if jax.default_backend() == "cpu" else GPU_BATCH


def points_kind(scenes: Scene, settings: ResolvedSettings):
    """What lists of points have in common that can share a plan."""
    return "points", scene_kind(scenes, settings), batch_size()


def plan_points(scene: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None) -> Plan:
    """A plan for batches of points like these, in few runs, which compile soon."""
    size = batch_size()
    places = np.linspace(0, points.shape[1] - 1, PROBE).round().astype(int)
    sample = jnp.asarray(points[:, places], scene.camera.viewpoint.dtype)
    pixel = jnp.asarray(np.zeros(2) if step is None else step, sample.dtype)
    shares = count_shares([probe_points(scene, settings, sample, pixel)], settings, points.shape[1])
    # Edge-aware levels are large programs: one is a loop over all of them.
    return make_plan(1, size, shares, ROOM, settings, FEW_RUNS if step is None else 1)


@functools.partial(jit, static_argnames="settings")
def probe_points(
    scene: Scene, settings: ResolvedSettings, points: Float[Array, "2 points"], step: Float[Array, "2"]
) -> Probe:
    """The world, and the rays through some points, as `planning.probe_camera` has those of a whole picture."""
    u, v = points
    rays = rays_through(scene.camera, settings, u, v, step)
    return Probe(prepare_world(scene, settings), rays, jnp.ones(points.shape[1], bool))
