"""A batch of camera rays traced level by level to a fixed depth: down with the rays, up with the colours.

At each level all live rays are intersected and shaded, and the rays that they send on are packed into the arrays of
the next level, whose size is fixed by the plan. The course's model clamps colours at every surface; so the colours
are blended afterwards, from the deepest level up.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .compaction import Packing, gather, pack, unpack
from .geometry import Shapes, scene_shapes
from .intersection import Hits, intersect
from .rays import Rays
from .scene import PointLights, Scene
from .settings import RenderSettings
from .shading.classic import Children, ShapeMaterials, Surface, combine, shade, shape_materials


class World(eqx.Module):
    """What rays meet, laid out for tracing: shapes and their materials in the order of the file, and the lights."""

    shapes: Shapes
    materials: ShapeMaterials
    lights: PointLights


class Trace(eqx.Module):
    """What a wavefront returns for each camera ray.

    Args:
        color: the ray's colour, scene-linear RGB.
        first: the camera ray's own hit.
        bounce_count: the largest number of bounces after which a ray of the pixel's tree still hit something.
        wanted: for every level after the first, how many rays were to be traced there.
    """

    color: Float[Array, "3 rays"]
    first: Hits
    bounce_count: Int[Array, " rays"]
    wanted: Int[Array, " levels"]


def prepare_world(scene: Scene) -> World:
    """Lay a scene out for tracing."""
    return World(scene_shapes(scene), shape_materials(scene), scene.lights)


def trace_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], settings: RenderSettings
) -> tuple[Hits, Surface, Children]:
    """Intersect and shade one level of rays."""
    hits = intersect(world.shapes, rays, live, settings)
    if not world.shapes.is_sphere:  # An empty scene is black; there is no material to look up.
        nothing, black = jnp.zeros_like(hits.t), jnp.zeros_like(hits.p)
        surface = Surface(hits.valid, black, black, black, black, nothing, nothing, hits.valid)
        return hits, surface, Children(hits.valid, hits.valid, rays.d, rays.d, rays.o, nothing, hits.shape, hits.valid)
    surface, children = shade(hits, rays, world.materials, world.lights, settings)
    return hits, surface, children


def pack_children(children: Children, capacity: int) -> tuple[Rays, Packing]:
    """The wanted children as the rays of the next level: first all reflected, then all transmitted ones."""
    packing = pack(jnp.stack([children.reflect, children.transmit]), capacity)
    candidate = packing.candidate
    transmits = candidate >= children.reflect.shape[0]
    parent = jnp.where(transmits, candidate - children.reflect.shape[0], candidate)
    directions = jnp.concatenate([children.reflected, children.transmitted], axis=1)
    # What moves by the same indices moves together; shape and side as one number. (Concatenation also keeps XLA from
    # computing the values anew inside of the gather, one by one.)
    o_and_path_length = gather(jnp.concatenate([children.o, children.path_length[None]]), parent)
    shape_and_side = gather(2 * children.shape + children.entering.astype(jnp.int32), parent)
    return Rays(
        o=o_and_path_length[:3],
        d=gather(directions, candidate),
        path_length=o_and_path_length[3],
        origin_shape=shape_and_side // 2,
        # A reflected ray stays on the side that it came from, a transmitted one changes sides.
        inside=(shape_and_side % 2 == 1) == transmits,
    ), packing


def trace(
    world: World, rays: Rays, live: Bool[Array, " rays"], capacities: tuple[int, ...], settings: RenderSettings
) -> Trace:
    """Trace camera rays and everything that they send on.

    Args:
        world: the scene.
        rays: one batch of camera rays.
        live: which of them count; the others are black.
        capacities: how many rays each level after the first can hold, at most `settings.max_bounces` levels. Rays that
            find no room are black; compare `wanted` with the capacities to know.
        settings: the model's settings.
    """
    # Down: each level's children are the next level's rays.
    levels: list[tuple[Surface, Packing | None]] = []
    wanted = []
    first = None
    for capacity in (*capacities, None):
        hits, surface, children = trace_level(world, rays, live, settings)
        first = hits if first is None else first
        if capacity is None:
            if len(capacities) < settings.max_bounces:
                wanted.append(jnp.sum(children.reflect, dtype=jnp.int32) + jnp.sum(children.transmit, dtype=jnp.int32))
            levels.append((surface, None))
        else:
            rays, packing = pack_children(children, capacity)
            live = packing.live
            wanted.append(packing.count)
            levels.append((surface, packing))

    # Up: each surface blends what its children brought back.
    color = bounce_count = None
    for bounce, (surface, packing) in reversed(list(enumerate(levels))):
        if color is None or packing is None:
            black = jnp.zeros_like(surface.local)
            color = combine(surface, black, black)
            bounce_count = jnp.where(surface.valid, jnp.int32(bounce), 0)
        else:
            color = combine(surface, *unpack(color, packing))
            deepest = jnp.max(jnp.stack(unpack(bounce_count[None], packing)), axis=(0, 1))
            bounce_count = jnp.where(surface.valid, jnp.maximum(deepest, bounce), 0)
    wanted = jnp.stack(wanted) if wanted else jnp.zeros(0, jnp.int32)
    return Trace(color, first, bounce_count, wanted)
