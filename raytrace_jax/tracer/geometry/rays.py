"""A batch of rays: where they are, what they stand for, and how they travel packed."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

NO_SHAPE = -1
"""The shape index of a ray that starts in free space, and of one that hits nothing."""


class Footprint(eqx.Module):
    """How a ray changes across the part of a pixel that it stands for: a parallelogram, the image of a unit square.

    Args:
        o: derivatives of the origin with respect to the square's two coordinates, which run from -1/2 to 1/2.
        d: derivatives of the direction with respect to these coordinates.
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
    """

    footprint: Footprint
    passed: Int[Array, "2 *rays"]
    bounce: Int[Array, " *rays"]
    subdivisions: Int[Array, " *rays"]


class Rays(eqx.Module):
    """Rays `o + t d`, with what decides exactly, without an epsilon, whether they can meet their own origin again.

    Args:
        o: origins, world units.
        d: directions of length one.
        path_length: length of the path from the viewpoint to the origin, world units.
        origin_shape: index of the shape on which the ray starts, or `NO_SHAPE`.
        inside: whether the ray leaves that shape's surface towards the side that its normal points away from.
        edge_beam: for tracing that is aware of edges, else None.
        pixel_weight: about how much the ray's colour counts in its camera ray's; not differentiable. None where nothing
            asks.
    """

    o: Float[Array, "3 *rays"]
    d: Float[Array, "3 *rays"]
    path_length: Float[Array, " *rays"]
    origin_shape: Int[Array, " *rays"]
    inside: Bool[Array, " *rays"]
    edge_beam: Beam | None = None
    pixel_weight: Float[Array, " *rays"] | None = None

    @property
    def weight(self) -> Float[Array, " *rays"]:
        """How much the ray counts in its pixel, where that is asked."""
        assert self.pixel_weight is not None
        return self.pixel_weight

    @property
    def beam(self) -> Beam:
        """The ray's beam, where tracing is aware of edges."""
        assert self.edge_beam is not None
        return self.edge_beam


INDEX_BITS = 12
"""An index of a shape takes so many bits of the numbers in which all that is discrete about rays travels."""

MOST_SHAPES = (1 << INDEX_BITS) - 2
"""Edge-aware tracing can tell so many shapes apart; one more number stands for none."""

COUNT_BITS = 3
"""The number of subdivisions takes so many bits."""


def pack_bits(rays: Rays) -> list[Int[Array, " *rays"]]:
    """All that is discrete about rays, in few numbers each: moving rays costs by the number of values."""
    numbers = [2 * rays.origin_shape + rays.inside.astype(jnp.int32)]
    if rays.edge_beam is not None:
        numbers[0] = (numbers[0] << COUNT_BITS) + rays.beam.subdivisions
        first, second = rays.beam.passed + 1
        numbers.append(first + (second << INDEX_BITS) + (rays.beam.bounce << 2 * INDEX_BITS))
    return numbers


def unpack_rays(
    o: Float[Array, "3 *rays"],
    d: Float[Array, "3 *rays"],
    path_length: Float[Array, " *rays"],
    footprint: Footprint | None,
    weight: Float[Array, " *rays"] | None,
    numbers: list[Int[Array, " *rays"]],
) -> Rays:
    """Rays from what is continuous about them (of a beam its footprint) and from `pack_bits` of them."""
    own, *others = numbers
    edge_beam = None
    if footprint is not None:
        (edges,) = others
        mask = (1 << INDEX_BITS) - 1
        passed = jnp.stack([edges & mask, (edges >> INDEX_BITS) & mask]) - 1
        edge_beam = Beam(footprint, passed, edges >> 2 * INDEX_BITS, own & ((1 << COUNT_BITS) - 1))
        own = own >> COUNT_BITS
    return Rays(o, d, path_length, own >> 1, (own & 1) == 1, edge_beam, weight)
