"""A batch of camera rays traced level by level to a fixed depth: down with the rays, up with the colours.

At each level all live rays are intersected and shaded, and the rays that they send on are packed into the arrays of
the next level, whose size is fixed by the plan. The course's model clamps colours at every surface; so the colours
are blended afterwards, from the deepest level up.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .compaction import Packing, gather, pack, unpack
from .geometry import Shapes, scene_shapes
from .intersection import Hits, intersect, take
from .optics import reflect, refract
from .rays import NO_SHAPE, Beam, Footprint, Rays
from .scene import PointLights, Scene
from .settings import RenderSettings
from .shading.classic import Children, ShapeMaterials, Surface, combine, shade, shape_materials
from .visibility import look, transport


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


class Level(eqx.Module):
    """One level of rays after intersection and shading.

    Args:
        hits: where they hit.
        surface: what is kept until the children's colours are known.
        coverage: share of each ray's footprint that sees the hit; None in point-sampled tracing.
        children: the rays that are sent on, kind by kind (reflected, transmitted, past an edge), with those wanted.
    """

    hits: Hits
    surface: Surface
    coverage: Float[Array, " rays"] | None
    children: list[tuple[Bool[Array, " rays"], Rays]]


def trace_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], may_pass: bool, settings: RenderSettings
) -> Level:
    """Intersect and shade one level of rays; `may_pass` tells whether rays can be sent on past edges."""
    if not world.shapes.is_sphere:  # An empty scene is black; there is no material to look up.
        hits = intersect(world.shapes, rays, live, settings)
        nothing, black = jnp.zeros_like(hits.t), jnp.zeros_like(hits.p)
        return Level(hits, Surface(hits.valid, black, black, black, black, nothing, nothing, hits.valid), None, [])
    if settings.edges == "point":
        hits = intersect(world.shapes, rays, live, settings)
        surface, children = shade(hits, rays, world.materials, world.lights, settings)
        return Level(hits, surface, None, scattered_rays(children, None, None))

    view = look(world.shapes, rays, live, may_pass, settings)
    surface, children = shade(view.hits, view.rays, world.materials, world.lights, settings)
    may_bounce = view.rays.beam.bounce < settings.max_bounces
    children = eqx.tree_at(
        lambda c: (c.reflect, c.transmit), children, (children.reflect & may_bounce, children.transmit & may_bounce)
    )
    eta = jax.lax.stop_gradient(children.eta)
    o, reflected, transmitted = transport(
        view.rays,
        view.hits,
        take(world.shapes, view.hits.shape),
        lambda d, n: (reflect(d, n), refract(d, n, eta)[0]),
    )
    nothing = jnp.full_like(view.past.beam.passed, NO_SHAPE)
    beams = [Beam(Footprint(o, d), nothing, view.rays.beam.bounce + 1) for d in (reflected, transmitted)]
    rays_on = scattered_rays(children, *beams)
    return Level(view.hits, surface, view.coverage, [*rays_on, (view.passes, view.past)])


def scattered_rays(
    children: Children, reflected: Beam | None, transmitted: Beam | None
) -> list[tuple[Bool[Array, " rays"], Rays]]:
    """The reflected and the transmitted rays of all hits, with those that are wanted."""
    # A reflected ray stays on the side that it came from, a transmitted one changes sides.
    o, path_length, shape, entering = children.o, children.path_length, children.shape, children.entering
    return [
        (children.reflect, Rays(o, children.reflected, path_length, shape, ~entering, reflected)),
        (children.transmit, Rays(o, children.transmitted, path_length, shape, entering, transmitted)),
    ]


def pack_rays(kinds: list[tuple[Bool[Array, " rays"], Rays]], capacity: int) -> tuple[Rays, Packing]:
    """The wanted rays of all kinds as the rays of the next level, kind after kind."""
    packing = pack(jnp.stack([wanted for wanted, _ in kinds]), capacity)
    parent = packing.candidate % kinds[0][0].shape[0]

    def pick(*values):
        # What all kinds have in common is gathered by parent, once.
        if all(value is values[0] for value in values):
            return gather(values[0], parent)
        return gather(jnp.concatenate(values, axis=-1), packing.candidate)

    return jax.tree.map(pick, *(rays for _, rays in kinds)), packing


def trace(
    world: World, rays: Rays, live: Bool[Array, " rays"], capacities: tuple[int, ...], settings: RenderSettings
) -> Trace:
    """Trace camera rays and everything that they send on.

    Args:
        world: the scene.
        rays: one batch of camera rays.
        live: which of them count; the others are black.
        capacities: how many rays each level after the first can hold, at most `settings.levels` of them. Rays that find
            no room are black; compare `wanted` with the capacities to know.
        settings: the model's settings.
    """
    # Down: each level's children are the next level's rays.
    levels: list[tuple[Level, Packing | None, Int[Array, " rays"] | int]] = []
    wanted = []
    for number, capacity in enumerate((*capacities, None)):
        level = trace_level(world, rays, live, number < settings.levels, settings)
        bounce = number if rays.beam is None else rays.beam.bounce
        packing = None
        if capacity is not None:
            rays, packing = pack_rays(level.children, capacity)
            live = packing.live
            wanted.append(packing.count)
        elif number < settings.levels and level.children:
            wanted.append(sum(jnp.sum(kind, dtype=jnp.int32) for kind, _ in level.children))
        levels.append((level, packing, bounce))

    # Up: each surface blends what its children brought back.
    color = bounce_count = jnp.zeros(0)
    for level, packing, bounce in reversed(levels):
        black = jnp.zeros_like(level.surface.local)
        kinds = [black] * 3 if packing is None else unpack(color, packing)
        color = combine(level.surface, kinds[0], kinds[1])
        if level.coverage is not None:
            color = kinds[2] + level.coverage * (color - kinds[2])
        reached = jnp.where(level.surface.valid, jnp.int32(bounce), 0)
        deeper = [] if packing is None else unpack(bounce_count[None], packing)
        bounce_count = functools.reduce(jnp.maximum, (kind[0] for kind in deeper), reached)
    wanted = jnp.stack(wanted) if wanted else jnp.zeros(0, jnp.int32)
    return Trace(color, levels[0][0].hits, bounce_count, wanted)
