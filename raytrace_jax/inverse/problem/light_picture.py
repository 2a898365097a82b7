"""Pictures with their derivatives by what is free, and how those of a scene's light, before the film, are traced.

One program serves pictures of any size, by points or edge-aware. It traces batches of pixels. Pixels that see no edge
send on few rays, so more of them find room in a batch.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.stacked import without_texels
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
from raytrace_jax.tracer.programs.tiles import most, sample_offsets
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.pyramid import Pyramid
from raytrace_jax.tracer.shading.textures import prepare_pyramids
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import jit


class Picture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        image: the picture.
        columns: its derivative with respect to each of the unknowns.
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Trace.sees_edge`; else None.
    """

    image: Float[Array, "3 height width"]
    columns: Float[Array, "parameters 3 height width"]
    sees_edge: Bool[np.ndarray, "height width"] | None = None


class Places(NamedTuple):
    """Pixels of a picture.

    Args:
        points: where they are, as `picture_place`.
        step: distance from one pixel to the next, as `pixel_step`.
    """

    points: Points
    step: Float[np.ndarray, "2"]


class Found(NamedTuple):
    """Each pixel's colour, the colour's derivatives by the unknowns, and whether the pixel sees an edge."""

    color: Float[np.ndarray, "3 pixels"]
    columns: Float[np.ndarray, "parameters 3 pixels"]
    sees_edge: Bool[np.ndarray, " pixels"]


def differentiate_light(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> Found:
    """Colours and their derivatives at the unknowns `y`, in forward mode.

    Args:
        y: the unknowns.
        scene: gives all that is not free.
        pixels: the pixels that are looked at.
        unknowns: what is free.
        settings: the model's settings, how pixels are sampled, and how often in each direction.

    Returns:
        The colours and derivatives. Point samples see no edge.
    """
    offsets = sample_offsets(settings.samples) * pixels.step
    each = (
        trace_all(y, scene, pixels._replace(points=pixels.points + offset[:, None]), unknowns, of_rays(settings))
        for offset in offsets
    )
    total = functools.reduce(lambda all_, one: Found(*map(np.add, all_, one)), each)
    return Found(total.color / len(offsets), total.columns / len(offsets), total.sees_edge)


def prepare_light(y: Float[Array, " parameters"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings) -> None:
    """Compile what `differentiate_light` will run, and run nothing."""
    rays = of_rays(settings)
    plan = filling_of(batches_kind(scene, rays), rays).plan
    slots, one = fill_slots([Batch(0, np.zeros(1, int))], plan.tile_size), Places(np.zeros((2, 1)), np.zeros(2))
    differentiate_batches.prepare(*arguments(y, scene, slots, one), unknowns, rays, plan)


def trace_all(
    y: Float[Array, " parameters"], scene: Scene, pixels: Places, unknowns: Unknowns, settings: ResolvedSettings
) -> Found:
    """Colours and derivatives as of `differentiate_light`, from one point a pixel or from the area around it."""
    count, dtype = pixels.points.shape[1], np.dtype(y.dtype)
    found = Found(np.zeros((3, count), dtype), np.zeros((len(y), 3, count), dtype), np.zeros(count, bool))

    def trace(slots: Slots, plan: Plan):
        return differentiate_batches(*arguments(y, scene, slots, pixels), unknowns, settings, plan)

    for batch, new in in_batches(1, count, batches_kind(scene, settings), settings, trace):
        for all_, some in zip(found, new, strict=True):
            all_[..., batch.points] = some
    return found


def arguments(y, scene: Scene, slots: Slots, pixels: Places):
    """The arguments of `differentiate_batches` that are arrays, in order."""
    points = pixels.points[:, slots.points].swapaxes(0, 1).astype(y.dtype)
    return y, scene, points, slots.live, slots.counts, steps_of_devices(pixels.step, points.dtype)


@functools.partial(jit, static_argnames=("unknowns", "settings", "plan"))
def differentiate_batches(
    y: Float[Array, " parameters"],
    scene: Scene,
    points: Float[Array, "batches 2 pixels"],
    live: Int[Array, " batches"],
    counts: Int[Array, " devices"],
    steps: Float[Array, "devices 2"],
    unknowns: Unknowns,
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[tuple[Array, Array, Array], Wanted]:
    """Trace and differentiate batches of pixels, which are spread over devices.

    Args:
        y, scene, unknowns: as for `differentiate_light`.
        points: where the pixels of each batch are.
        live: how many of a batch's pixels are to be traced, its first ones.
        counts: how many of a device's batches are to be traced, its first ones.
        steps: for each device, how far it is from one pixel to the next.
        settings: the model's settings, with `edges` by points or edge-aware.
        plan: the sizes of the tracer's arrays for one tile, as large as a batch.

    Returns:
        The fields of `Found` of each batch, and the most rays that one wanted at each level.
    """

    def trace_batch(common: tuple[Array, Scene, tuple[Pyramid, ...]], batch: Float[Array, "2 pixels"], live, step):
        y, scene, pyramids = common
        (u, v), is_live = in_front(plan, batch, live)
        size = batch.shape[1]

        def color(y):
            values = unknowns.values(y)
            moved = unknowns.scene(scene, values)
            rays = rays_through(moved.camera, settings, u, v, step)
            traced = trace_channels(prepare_world(moved, settings, pyramids), rays, is_live, plan.stages, settings)
            sees_edge = jnp.zeros(size, bool) if traced.sees_edge is None else traced.sees_edge[:size]
            return traced.color[:, :size], (sees_edge, Wanted(traced.wanted))

        # Forward mode: the picture is traced once, and all derivatives ride along.
        def derivative(direction):
            return jax.jvp(color, (y,), (direction,), has_aux=True)

        directions = jnp.eye(len(unknowns.names), dtype=y.dtype)
        image, columns, (sees_edge, wanted) = jax.vmap(derivative, out_axes=(None, 0, None))(directions)
        return image, columns, sees_edge, wanted

    # Textures are filtered once for all batches.
    common = y, without_texels(scene), prepare_pyramids(scene, settings.edges)
    *found, wanted = map_batches(trace_batch, common, points, live, counts=counts, steps=steps)
    return tuple(found), most(wanted)


def batches_kind(scene: Scene, settings: ResolvedSettings):
    """The key under which the number of rays a batch needs is remembered: scenes of one kind need about as many."""
    return "pixels", scene_kind(scene, settings)
