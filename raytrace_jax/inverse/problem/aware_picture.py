"""Edge-aware pictures and their derivatives by what is free, in batches: two programs for pictures of any size.

They are of a scene's light, before the film.

All pixels are traced as whole areas first, which tells where one sees an edge (`tracer.programs.edge_pixels`); only
those are traced edge-aware, in batches of their own.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.inverse.problem.unknowns import Unknowns, moved_scene, values_and_slopes
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import with_texels, without_texels
from raytrace_jax.tracer.geometry.camera import rays_through
from raytrace_jax.tracer.points import GPU_BATCH, probe_points
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
from raytrace_jax.tracer.programs.plan import Plan, Shares, Wanted, make_plan
from raytrace_jax.tracer.programs.plan_cache import PLANS, scene_kind
from raytrace_jax.tracer.programs.planning import PROBE, count_levels, of_rays
from raytrace_jax.tracer.programs.tiles import most
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, WholeSettings
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.textures import prepare_pyramids
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit

SOME = 1e-9
"""Of a ray: a level with so many has a place in a plan."""

BATCH = 304
"""Pixels that are traced at once on a CPU. Every batch has room for a picture of edges, and a device takes whole ones:
the 6,500 pixels of POV-Ray's checker, 640 x 480, that see an edge take 1.9 s with 304, 2.0 with 608, 2.5 with 1216 and
3.3 with 2432, the 38,000 of the course's scene 1.5, 1.6, 1.9 and 2.1 s; whole areas take as long with all of them."""


class Places(NamedTuple):
    """Pixels of a picture.

    Args:
        places: their points, as `picture_place`.
        step: from one pixel to the next, as `pixel_step`.
    """

    places: Points
    step: Float[np.ndarray, "2"]


class Found(NamedTuple):
    """Of each pixel its colour; the derivatives of that by the unknowns; and whether it sees an edge."""

    color: Float[np.ndarray, "3 pixels"]
    columns: Float[np.ndarray, "parameters 3 pixels"]
    sees_edge: Bool[np.ndarray, " pixels"]


def differentiate_aware(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> Found:
    """Edge-aware colours and their derivatives at the unknowns `y`, in forward mode.

    Args:
        y: the unknowns.
        scene: gives all that is not free.
        pixels: which are looked at.
        unknowns: what is free.
        settings: the model's settings.
    """
    aware = of_rays(settings)
    whole = trace_listed(y, scene, pixels, unknowns, WholeSettings.of(aware))
    listed = np.flatnonzero(whole.sees_edge)
    some = trace_listed(y, scene, pixels._replace(places=pixels.places[:, listed]), unknowns, aware)
    for all_, new in zip(whole[:2], some[:2], strict=True):
        all_[..., listed] = new
    return whole


def prepare_aware(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> None:
    """Plan and compile what `differentiate_aware` will run for such pixels, and run nothing."""
    aware = of_rays(settings)
    for how in (WholeSettings.of(aware), aware):
        plan = PLANS.plan(batches_kind(scene, how), lambda how=how: plan_batches(y, scene, pixels, unknowns, how))
        batch = np.zeros((1, 2, size_of_batch()), y.dtype)
        differentiate_batches.prepare(*arguments(y, scene, batch, pixels.step), unknowns, how, plan)


def trace_listed(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> Found:
    """Colours and derivatives of some pixels, as whole areas or edge-aware, with a larger plan where rays lack room."""
    size, count = size_of_batch(), pixels.places.shape[1]
    dtype, places = np.dtype(y.dtype), spread_out(count, size)
    found = Found(np.zeros((3, count), dtype), np.zeros((len(y), 3, count), dtype), np.zeros(count, bool))
    most_batches, kind = BATCHES * jax.device_count(), batches_kind(scene, settings)

    def plan() -> Plan:
        return plan_batches(y, scene, pixels, unknowns, settings)

    for first in range(0, len(places), most_batches):
        some = places[first : first + most_batches]
        batches = pixels.places[:, some].swapaxes(0, 1).astype(dtype)
        given, slot = arguments(y, scene, batches, pixels.step), make_slots(len(batches)).slot
        trace = functools.partial(differentiate_batches, *given, unknowns, settings)
        traced = PLANS.run(trace, kind, plan, settings, recount=True)
        for all_, new in zip(found, traced, strict=True):
            for which, batch in zip(some, np.asarray(new)[slot], strict=True):
                all_[..., which] = batch
    return found


def arguments(y, scene: Scene, batches: Float[np.ndarray, "batches 2 pixels"], step: Float[np.ndarray, "2"]):
    """The arguments of `differentiate_batches` that are arrays, in order."""
    slots = make_slots(len(batches))
    return y, scene, batches[slots.source], slots.counts, steps_of_devices(step, batches.dtype)


@functools.partial(jit, static_argnames=("unknowns", "settings", "plan"))
def differentiate_batches(
    y: Float[Array, " parameters"],
    scene: Scene,
    batches: Float[Array, "batches 2 pixels"],
    counts: Array,
    steps: Float[Array, "devices 2"],
    unknowns: Unknowns,
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[tuple[Array, Array, Array], Wanted]:
    """Trace and differentiate batches of pixels, which are spread over devices.

    Args:
        y, scene, unknowns: as for `differentiate_aware`.
        batches: points of pixels.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: for each device, how far it is from one pixel to the next.
        settings: of whole areas, or edge-aware.
        plan: of one tile, as large as a batch.

    Returns:
        The fields of `Found` of each batch, and the most rays that one wanted at each level.
    """

    def trace_batch(common: tuple[Array, Scene, tuple[Pyramid, ...]], batch: Float[Array, "2 pixels"], step):
        y, scene, pyramids = common
        (u, v), live = in_front(plan, batch)
        size = batch.shape[1]

        def color(y):
            values = unknowns.values(y)
            moved = unknowns.scene(scene, values)
            rays = rays_through(moved.camera, settings, u, v, step)
            traced, wanted = trace_pixels(prepare_world(moved, settings, pyramids), rays, live, plan, settings)
            sees_edge = jnp.ones(size, bool) if traced.sees_edge is None else traced.sees_edge[:size]
            return traced.color[:, :size], (sees_edge, wanted)

        def derivative(direction):
            return jax.jvp(color, (y,), (direction,), has_aux=True)

        directions = jnp.eye(len(unknowns.names), dtype=y.dtype)
        image, columns, (sees_edge, wanted) = jax.vmap(derivative, out_axes=(None, 0, None))(directions)
        return image, columns, sees_edge, wanted

    common = y, without_texels(scene), prepare_pyramids(scene, settings.edges)
    *found, wanted = map_batches(trace_batch, common, batches, counts=counts, steps=steps)
    return tuple(found), most(wanted)


def size_of_batch() -> int:
    """How many pixels are traced at once."""
    return BATCH if jax.default_backend() == "cpu" else GPU_BATCH


def batches_kind(scene: Scene, settings: ResolvedSettings):
    """What batches of pixels have in common that can share a plan."""
    return "pixels", scene_kind(scene, settings), size_of_batch()


def plan_batches(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> Plan:
    """A plan for batches of pixels like these, in one run.

    Edge-aware ones may all see an edge, and those that do have most of the rays: they alone are counted. Slots without
    a ray cost little (`tracer.levels.compaction`), so that one plan is good for all pictures.
    """
    values, _ = values_and_slopes(y, unknowns)
    scene = with_texels(moved_scene(without_texels(scene), values, unknowns), scene)
    sample = jnp.asarray(
        pixels.places[:, np.linspace(0, pixels.places.shape[1] - 1, PROBE).round().astype(int)],
        scene.camera.viewpoint.dtype,
    )
    whole = WholeSettings.of(settings)
    probe = probe_points(scene, whole, sample, jnp.asarray(pixels.step, sample.dtype))
    share, sees_edge = count_levels(probe, whole)
    if settings.splits:
        probe = probe._replace(live=jnp.asarray(sees_edge)) if sees_edge.any() else probe
        share, _ = count_levels(probe, settings)
    # One run is a loop over levels, and one more without rays costs little: the deepest are never lacking.
    return make_plan(1, size_of_batch(), Shares(np.maximum(share, SOME)), ROOM, settings, 1)
