"""A batch of rays, and the camera's rays through given points of the picture."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Camera
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.numerics import dot, normalize

NO_SHAPE = -1
"""The shape index of a ray that starts in free space, and of one that hits nothing."""


class Footprint(eqx.Module):
    """How a ray changes across the part of a pixel that it stands for: a parallelogram, the image of a unit square.

    Args:
        o: derivatives of the origin with respect to the square's two coordinates, which run from -1/2 to 1/2.
        d: the same of the direction.
    """

    o: Float[Array, "2 3 *rays"]
    d: Float[Array, "2 3 *rays"]


class Beam(eqx.Module):
    """What a ray carries besides when it stands for an area and may pass the edge of a shape.

    Args:
        footprint: the area.
        passed: the last two shapes past whose edges the ray went since its origin, or `NO_SHAPE`; it ignores them.
        bounce: how often the path has bounced.
        subdivisions: how often its footprint has been cut into smaller ones.
        weight: about how much the ray's colour counts in its camera ray's; not differentiable.
    """

    footprint: Footprint
    passed: Int[Array, "2 *rays"]
    bounce: Int[Array, " *rays"]
    subdivisions: Int[Array, " *rays"]
    weight: Float[Array, " *rays"]


class Rays(eqx.Module):
    """Rays `o + t d`, with what decides exactly, without an epsilon, whether they can meet their own origin again.

    Args:
        o: origins, world units.
        d: directions of length one.
        path_length: length of the path from the viewpoint to the origin, world units.
        origin_shape: index of the shape on which the ray starts, or `NO_SHAPE`.
        inside: whether the ray leaves that shape's surface towards the side that its normal points away from.
        edge_beam: for tracing that is aware of edges, else None.
    """

    o: Float[Array, "3 *rays"]
    d: Float[Array, "3 *rays"]
    path_length: Float[Array, " *rays"]
    origin_shape: Int[Array, " *rays"]
    inside: Bool[Array, " *rays"]
    edge_beam: Beam | None = None

    @property
    def beam(self) -> Beam:
        """The ray's beam, where tracing is aware of edges."""
        assert self.edge_beam is not None
        return self.edge_beam


LABEL_BITS = 12
"""Bits that an index of a shape takes where labels travel in one number; scenes have fewer than 4095 shapes."""

COUNT_BITS = 3
"""Likewise the number of subdivisions."""


def labels(rays: Rays) -> list[Int[Array, " *rays"]]:
    """All that is discrete about rays, in one or two numbers each: moving rays costs by the number of values."""
    numbers = [2 * rays.origin_shape + rays.inside.astype(jnp.int32)]
    if rays.edge_beam is not None:
        numbers[0] = (numbers[0] << COUNT_BITS) + rays.beam.subdivisions
        first, second = rays.beam.passed + 1
        numbers.append(first + (second << LABEL_BITS) + (rays.beam.bounce << 2 * LABEL_BITS))
    return numbers


def from_labels(
    o: Float[Array, "3 *rays"],
    d: Float[Array, "3 *rays"],
    path_length: Float[Array, " *rays"],
    beam: tuple[Footprint, Float[Array, " *rays"]] | None,
    numbers: list[Int[Array, " *rays"]],
) -> Rays:
    """Rays from what is continuous about them (of a beam its footprint and weight) and from their `labels`."""
    if beam is None:
        return Rays(o, d, path_length, numbers[0] >> 1, (numbers[0] & 1) == 1, None)
    own, edges = numbers
    mask = (1 << LABEL_BITS) - 1
    passed = jnp.stack([edges & mask, (edges >> LABEL_BITS) & mask]) - 1
    footprint, weight = beam
    edge_beam = Beam(footprint, passed, edges >> 2 * LABEL_BITS, own & ((1 << COUNT_BITS) - 1), weight)
    own = own >> COUNT_BITS
    return Rays(o, d, path_length, own >> 1, (own & 1) == 1, edge_beam)


def film_points(
    camera: Camera, settings: RenderSettings, column: Float[Array, " *rays"], row: Float[Array, " *rays"]
) -> Float[Array, "3 *rays"]:
    """Points of the image plane z = 0 at which fractional pixel positions look.

    Args:
        camera: gives the extent of the image plane.
        settings: gives the size of the picture and the mapping.
        column: pixels (of those that are rendered: `binning`) from the left; whole numbers are their own points.
        row: pixels from the **top**; the course's y = 0 is the bottom row.
    """
    width, height = settings.picture_size(camera.pixeldim)
    if settings.binning > 1:
        column, row = (settings.binning * (x + 0.5) - 0.5 for x in (column, row))
    from_bottom = (height - 1) - row
    if settings.mapping == "center":
        u, v = (column + 0.5) / width, (from_bottom + 0.5) / height
    else:  # A picture of one pixel has no end points to include: it looks at the middle.
        u = column / (width - 1) if width > 1 else column + 0.5
        v = from_bottom / (height - 1) if height > 1 else from_bottom + 0.5
    return jnp.stack([u * camera.worlddim[0], v * camera.worlddim[1], jnp.zeros_like(u)])


def camera_rays(
    camera: Camera, settings: RenderSettings, column: Float[Array, " *rays"], row: Float[Array, " *rays"]
) -> Rays:
    """Rays from the viewpoint through fractional pixel positions, as in `film_points`.

    With `edges="aware"` each stands for a square around its position, as wide as the sub-pixel samples are apart.
    """
    target = film_points(camera, settings, column, row)
    o = jnp.broadcast_to(camera.viewpoint.reshape((3,) + (1,) * column.ndim), target.shape)
    d = normalize(target - o)
    beam = None
    if settings.edges == "aware":
        zero, one = jnp.zeros_like(column), jnp.ones_like(column)
        points = functools.partial(film_points, camera, settings)
        steps = jnp.stack(
            [jax.jvp(points, (column, row), tangent)[1] / settings.samples for tangent in ((one, zero), (zero, one))]
        )
        toward = steps / jnp.sqrt(dot(target - o, target - o))
        spread = toward - dot(jnp.moveaxis(toward, 1, 0), d[:, None])[:, None] * d
        footprint = jax.lax.stop_gradient(Footprint(jnp.zeros_like(spread), spread))
        nothing = jnp.full((2, *column.shape), NO_SHAPE, jnp.int32)
        none = jnp.zeros(column.shape, jnp.int32)
        beam = Beam(footprint, nothing, none, none, one)
    return Rays(
        o=o,
        d=d,
        path_length=jnp.zeros_like(column),
        origin_shape=jnp.full(column.shape, NO_SHAPE, jnp.int32),
        inside=jnp.zeros(column.shape, bool),
        edge_beam=beam,
    )
