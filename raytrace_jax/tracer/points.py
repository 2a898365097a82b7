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
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import map_scenes, without_texels
from raytrace_jax.tracer.edge_pixels import trace_pixels
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.plan import FEW_RUNS, Plan, Wanted, make_plan, too_many
from raytrace_jax.tracer.plan_cache import PLANS, enlarge, scene_kind
from raytrace_jax.tracer.planning import PROBE, Probe, count_shares, of_rays
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.textures import prepare_pyramids
from raytrace_jax.tracer.tiles import most, share_out
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit

Points = Float[np.ndarray, "2 points"]
"""Where in the picture: from its left border, 0, to the right one, 1; and from its lower border to the upper one."""

BATCH, GPU_BATCH = 2432, 1 << 16
"""Points that are traced at once: on a CPU as few as stay in its cache, two batches a small picture of a search."""

BATCHES = 32
"""So many batches at most are one call, for each device: a call takes as long as some batches do."""

ROOM = 1.5
"""Room for more rays than were counted, as a factor: the same points of a moved scene need no other program. Of the
README's fit a search wants 1.25 times what its start does; with 1.3 to 1.6 it takes 2.6 s, with 2.5 4.1 s, and
compiling anew 3."""


def render_points(
    scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> Float[np.ndarray, "scenes 3 points"]:
    """What is seen at each of some points of the pictures of some scenes, as `render` has it up to rounding.

    Args:
        scenes: scenes of one structure, with concrete values, as `scene.stacked` has them.
        points: where to look.
        settings: what to render; what it says of pixels and their edges does not matter.
        step: how far `u` and `v` are from one pixel to the next, as `pixel_step`: then each point stands for the
            edge-aware pixel around it; if it is not given it is one ray's.
    """
    settings, size = of_points(settings, step), batch_size()
    scenes = map_scenes(np.asarray, scenes)
    viewpoint = scenes.camera.viewpoint
    count, batches = points.shape[1], -(-points.shape[1] // size)
    image = np.zeros((len(viewpoint), 3, count), viewpoint.dtype)
    places = spread_out(count, size)
    work = [(scene, batch) for scene in range(len(viewpoint)) for batch in range(batches)]
    most = BATCHES * jax.device_count()
    for first in range(0, len(work), most):
        scene, batch = np.array(work[first : first + most]).T
        call = make_call(scenes, scene, points[:, places[batch]].swapaxes(0, 1).astype(image.dtype), step)
        found = np.asarray(with_room(call, scenes, points, settings, step))[call.slot]
        for one, which, color in zip(scene, batch, found, strict=True):
            image[one][:, places[which]] = color
    return image


def with_room(
    call: "Call", scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None
) -> Float[Array, "batches 3 points"]:
    """The colours of a call, with the plan that served last or a larger one."""
    kind = points_kind(scenes, settings)

    def make_plan() -> Plan:
        return plan_points(map_scenes(lambda x: x[0], scenes), points, settings, step)

    plan = PLANS.plan(kind, make_plan)
    while True:
        colors, wanted = trace_batches(*call.arguments, settings, plan)
        if not too_many(plan, wanted):
            return colors
        # These points see more glass than those before: to count anew finds at once what levels hide from each other.
        counted = make_plan()
        plan = enlarge(plan, wanted, settings) if too_many(counted, wanted) else counted
        PLANS.keep(kind, plan)


def prepare_points(
    scene: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> None:
    """Plan and compile what `render_points` will run for such points, and run nothing."""
    settings = of_points(settings, step)
    scenes = map_scenes(lambda x: np.asarray(x)[None], scene)
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
    steps = np.tile(np.zeros(2) if step is None else step, (jax.device_count(), 1)).astype(points.dtype)
    return Call((chosen, points[slots.source], slots.counts, steps), slots.slot)


class Slots(NamedTuple):
    """How batches are laid into the slots of all devices.

    Args:
        source: the batch in each slot; the first one in those that stay empty.
        slot: of each batch.
        counts: how many batches each device has, in its first slots.
    """

    source: Int[np.ndarray, " slots"]
    slot: Int[np.ndarray, " batches"]
    counts: Int[np.ndarray, " devices"]


def make_slots(batches: int) -> Slots:
    """So many batches shared out evenly over the devices, of `BATCHES` slots each."""
    devices = jax.device_count()
    number = np.arange(batches)
    slot = number % devices * BATCHES + number // devices
    source = np.zeros(BATCHES * devices, int)
    source[slot] = number
    counts = (batches + devices - 1 - np.arange(devices)) // devices
    return Slots(source, slot, counts.astype(np.int32))


def spread_out(count: int, size: int) -> Int[np.ndarray, "batches size"]:
    """The points in each batch, so that each is spread over all of them; the last places of some have others again."""
    batches = -(-count // size)
    return np.arange(batches * size).reshape(size, batches).T % max(count, 1)


def in_front(plan: Plan, batch: Float[Array, "2 points"]) -> tuple[Float[Array, "2 slots"], Bool[Array, " slots"]]:
    """A batch in the first slots of a plan's first level, and which slots these are.

    A level has as many slots as the fullest one.
    """
    slots, size = plan.stages[0].capacity, batch.shape[1]
    return jnp.pad(batch, ((0, 0), (0, slots - size))), jnp.arange(slots, dtype=jnp.int32) < size


@functools.partial(jit, static_argnames=("settings", "plan"))
def trace_batches(
    scenes: Scene,
    points: Float[Array, "batches 2 points"],
    counts: Int[Array, " devices"],
    steps: Float[Array, "devices 2"],
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[Float[Array, "batches 3 points"], Wanted]:
    """The colours at batches of points, and the most rays wanted at each level; the batches are spread over devices.

    Args:
        scenes: of each batch, as `scene.stacked` has them.
        points: of each batch.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: for each device, how far it is from one pixel to the next.
        settings: what to render.
        plan: of one tile, as large as a batch.
    """

    def trace_batch(pyramids: tuple[Pyramid, ...], scene: Scene, batch: Float[Array, "2 points"], step):
        (u, v), live = in_front(plan, batch)
        rays = rays_through(scene.camera, settings, u, v, step)
        traced, wanted = trace_pixels(prepare_world(scene, settings, pyramids), rays, live, plan, settings)
        return traced.color[:, : batch.shape[1]], wanted

    def trace_some(pyramids: tuple[Pyramid, ...], scenes: Scene, points, counts, steps):
        def trace_next(number, found):
            one = trace_batch(pyramids, map_scenes(lambda x: x[number], scenes), points[number], steps[0])
            return jax.tree.map(lambda all_, new: all_.at[number].set(new), found, one)

        shapes = jax.eval_shape(trace_batch, pyramids, map_scenes(lambda x: x[0], scenes), points[0], steps[0])
        nothing = jax.tree.map(lambda x: jnp.zeros((len(points), *x.shape), x.dtype), shapes)
        return jax.lax.fori_loop(0, counts[0], trace_next, nothing)

    # Once for all batches: a loop would make them again for each.
    pyramids = prepare_pyramids(scenes, settings.edges)
    colors, wanted = share_out(trace_some, pyramids, without_texels(scenes), points, counts, steps)
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
