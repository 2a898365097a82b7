"""Edge-aware visibility: what the *area* that a ray stands for sees, rather than its one point.

What a camera sees is the mean `I = int C(x; theta) dx` of the colour over a pixel. Where C jumps across a curve Gamma
that moves with theta, Reynolds' transport theorem gives its derivative:

    dI/dtheta = int dC/dtheta dx + int_Gamma (C_near - C_far) v ds,

with v the speed at which the near side grows along the curve's normal. Point samples know the first term only. Li et
al. ("Differentiable Monte Carlo Ray Tracing through Edge Sampling", 2018) estimate the second one by samples on the
edges; Bangaru et al. ("Unbiased Warped-Area Sampling for Differentiable Rendering", 2020) turn it into an area integral
by the divergence theorem. Here it is integrated in closed form, one straight edge at a time.

Every ray carries a footprint, the parallelogram of rays around it, and each discontinuity is the zero of an *event
function* g of the ray, positive where the nearest surface is present:

    silhouette of a sphere that is seen from outside     (r^2 - (distance of its centre from the ray)^2) / 2r
    occlusion edge, where two surfaces are equally far    t_second - t_nearest (at a sphere's rim a smoother form)
    border of a rectangle                                 distance from it, within the rectangle
    crease or outline of a body, where two faces meet     F of the one that is grazed more, where the other one is hit
    the course's cut of planes at the image plane         -z of the hit point
    the limit of paths, in the course's classic model     longest path - length of the path

To first order g is linear over the footprint: the edge is a straight line at distance `g / |grad g|` from its centre,
and `coverage` gives the area A on either side and the centroids of both parts. The ray moves to the centroid of the
near part and hits the nearest surface there; a second ray goes on *past the edge* from the centroid of the far part,
ignoring the surface that it passed. Their colours blend as `A near + (1 - A) far`. Both parts become parallelograms
again, so edges nest. A mean of a linear function is its value at the centroid: the blend is exact for straight edges
between linearly shaded areas. Its derivative has the term `(near - far) A'(d) (dg/dtheta) / |grad g|`. A' is the length
of the edge inside of the footprint (`coverage`), and `(dg/dtheta) / |grad g|` is its speed v: the second term above.

The footprint is a constant to the parameter derivative. Summed over all rays that see an edge, the derivative of A does
not depend on the footprint's size. An approximate footprint therefore changes the blur, not the total. Only edges that
a footprint has outgrown lose some of their derivative (`coverage.edge_distance`). docs/edges.md has the derivation.
"""

import operator

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.lax import stop_gradient

from ...scene.scene import least_distance
from ...util.numerics import dot, materialize, safe_normalize, select, unstacked
from ..geometry import shapes as surfaces
from ..geometry.intersection import SurfaceInteraction, ends_in_time
from ..geometry.rays import NO_SHAPE, Flags, Integers, Number, Rays, Scalars, take
from ..geometry.shape_types import Index, by_type, fold_shapes, present_types
from ..geometry.shapes import GRAZING, Edge, Faces, Shapes, ShapeType, hit_distance
from ..geometry.solid import belongs, border, passed_face
from . import coverage


class Nearest(eqx.Module):
    t: Scalars
    # The index of the face or `NO_SHAPE` and, in the last bits, what `Sighting` has: in one number, so that a
    # comparison moves two numbers and not six. Four bits each have how far from the face the others are, plus 8.
    code: Integers

    @classmethod
    def of(cls, found: surfaces.Sighting, index: Index, seen: Flags) -> "Nearest":
        edges = (found.crease, found.far_edge)
        crease, far_edge = (jnp.where(other < 0, 0, other - found.face + 8) for other in edges)
        flags = 2 * found.outside.astype(jnp.int32) + found.centered.astype(jnp.int32)
        code = ((index + found.face) << 10) + (crease << 6) + (far_edge << 2) + flags
        return cls(jnp.where(seen, found.t, jnp.inf), code.astype(jnp.int32))

    @property
    def shape(self) -> Integers:
        return self.code >> 10

    @property
    def crease(self) -> Integers:
        """The index of the face of the same shape at the nearest crease; negative where there is none."""
        return self.neighbour(6)

    @property
    def far_edge(self) -> Integers:
        """The index of the face at the outline or, from inside, at a second crease; negative where there is none."""
        return self.neighbour(2)

    def neighbour(self, bits: int) -> Integers:
        offset = (self.code >> bits) & 15
        return jnp.where(offset > 0, self.shape + offset - 8, NO_SHAPE)

    @property
    def outside(self) -> Flags:
        return self.code & 2 != 0

    @property
    def centered(self) -> Flags:
        return self.code & 1 != 0


def find_two_nearest(shapes: Shapes, rays: Rays, live, may_pass, least: Number) -> tuple[Nearest, Nearest]:
    """The nearest surface that any part of each footprint sees, and the next one behind it that its centre sees.

    A ball whose silhouette the centre just misses counts at the first distance at which the footprint may meet it.
    """

    def spread(one):
        count = rays.path_length.shape
        return jnp.broadcast_to(one.reshape(one.shape + (1,) * len(count)), one.shape + count)

    # What one shape says: how far away a footprint meets it; infinity where it does not, or has gone past its edge.
    def ask(shape_type: ShapeType, faces: Faces, index: Index) -> Nearest:
        faces = jax.tree.map(spread, faces)
        found = shape_type.see(rays, faces, index, may_pass, least)
        past = [belongs(passed, index, shape_type.face_count) for passed in rays.footprint.passed]
        return Nearest.of(found, index, found.seen & ~past[0] & ~past[1] & faces[0].is_met)

    def nearer(found: Nearest, other: Nearest) -> Flags:
        # On a tie the first shape of the file wins; in a loop one type comes after the other.
        return (found.t < other.t) | ((found.t == other.t) & (found.shape < other.shape))

    # The two nearest of all shapes so far. Only the first may be seen in part: the ray that goes past the edge meets
    # what is behind it again.
    def put_in_order(two: tuple[Nearest, Nearest], found: Nearest) -> tuple[Nearest, Nearest]:
        nearest, second = two
        first = nearer(found, nearest)
        nearest, lost = select(first, (found, nearest), (nearest, found))
        return nearest, select(lost.centered & nearer(lost, second), lost, second)

    # At first both are at infinity. This is the code of no shape without flags.
    far = jnp.full_like(rays.path_length, jnp.inf)
    nothing = Nearest(far, jnp.full_like(rays.origin_shape, NO_SHAPE << 10))
    return fold_shapes(shapes, ask, put_in_order, (nothing, nothing), lambda all_: materialize(all_, live))


def look(
    shapes: Shapes, rays: Rays, live: Flags, may_pass: Flags, unit: Number
) -> tuple[SurfaceInteraction, Rays, Scalars, Flags, Rays, Flags]:
    """Find what each ray's footprint sees first, and split it at the edge of the smallest signed distance.

    Only rays that `may_pass`, which have a further level for what is past an edge, are split.

    Returns:
        The nearest surface at the centroid of the part that sees it; the rays moved to there, with the part as their
        footprint; the fraction of the footprint that it is; which are split, and the rays of the other part; which
        are at a corner.
    """
    # The nearest surface that any part of a footprint sees, the one behind it, and the edge between them.
    fixed_shapes, fixed_rays = stop_gradient((shapes, rays))
    nearest, second = materialize(
        find_two_nearest(fixed_shapes, fixed_rays, live, may_pass, least_distance(unit)), live
    )
    found = live & (nearest.shape != NO_SHAPE)
    behind_exists = found & (second.shape != NO_SHAPE)
    # Both at once, on an axis before the rays.
    two, exist = jax.tree.map(lambda *x: jnp.stack(x), (nearest, found), (second, behind_exists))
    twice = jax.tree.map(lambda x: jnp.broadcast_to(x[..., None, :], (*x.shape[:-1], 2, x.shape[-1])), rays)
    met = meet(twice, shapes, two, exist)
    surface, behind = (jax.tree.map(operator.itemgetter((..., k, slice(None))), met) for k in range(2))
    between = materialize(coverage.occlusion_edge(rays, surface, behind, behind_exists), live)
    # A sphere whose rim the centre just misses may lie behind the other surface wherever the footprint sees it.
    hidden = behind_exists & ~nearest.centered & ~surfaces.is_within(between)
    nearest, surface = select(hidden, (second, behind), (nearest, surface))

    # One edge, of the smallest signed distance, cuts the footprint in two; others are left to the rays of both parts.
    edges, t, near = list[Edge](), surface.t, surface.approach
    for number, shape_type in present_types(surface.shape):
        mine = surface.shape.type == number
        for edge in shape_type.edges(rays, surface.shape, nearest.outside, t, near):
            edges.append(eqx.tree_at(lambda e: e.exists, edge, edge.exists & mine))
    if shapes.settings.has_path_limit:
        # A path that becomes too long ends in black: what is left of it shrinks as fast as the distance grows.
        left = shapes.settings.path_limit - rays.path_length - t
        edges.append(Edge(left, -near.slope, near.fraction))
    edges.append(eqx.tree_at(lambda e: e.exists, between, behind_exists & ~hidden))
    central, passed, corner = coverage.most_central(edges), nearest.shape, jnp.zeros_like(found)
    if shapes.axis is not None:
        ends = [
            coverage.most_central([border_at(rays, surface, shapes, other, nearest.outside, is_outline)])
            for other, is_outline in ((nearest.far_edge, nearest.outside), (nearest.crease, False))
        ]
        # Where both cut it is a corner, which is better looked at in parts if it counts. 0.01 to 0.2 do the same.
        corner = found & may_pass & (rays.throughput > 0.1)
        for distance, direction, *_ in ends:
            corner &= jnp.abs(distance) < coverage.reach(direction)
        # What is past an edge is behind the whole shape, but past a crease it is another face of it.
        fold = passed_face(nearest.shape)
        for end, beyond in zip(ends, (jnp.where(nearest.outside, passed, fold), fold), strict=True):
            central, passed = select(end[0] < central[0], (end, beyond), (central, passed))
    distance, direction, fraction, step = materialize(central, live)
    # Where it does not cut, the centre decides alone. The distance 2 is beyond any footprint's reach: all is near.
    cuts = found & (jnp.abs(distance) < coverage.reach(direction)) & may_pass
    present = found & (cuts | (distance > 0))
    distance = jnp.where(cuts, distance, 2)
    cut = materialize(coverage.cut_pixel(distance, direction), live)

    # The ray of each part, through the part's centroid: the near one hits, the far one goes past the edge.
    near, far = materialize(move(rays, direction, fraction, cut, cuts), live)

    # Where the near ray hits.
    fixed_near, fixed_shape = stop_gradient((near, surface.shape))
    t = by_type(fixed_shape, lambda shape_type: shape_type.distance(fixed_near, fixed_shape, nearest.outside))
    t = jnp.where(cuts, t, nearest.t)
    if shapes.axis is not None:
        # A face that is seen along itself it may meet anywhere: what the linear distance does not tell is left out.
        moves = jnp.sum(jnp.abs(surface.approach.slope), 0)
        t = jnp.where(surface.curved | ((t > 0) & (jnp.abs(t - nearest.t) <= moves)), t, nearest.t)
    # Near a silhouette the hit lies as deep inside of it as the centroid of the near part, g = depth. As the half chord
    # is sqrt(2 r g), the cosine there is sqrt(2 depth / r). The shifted ray is only linear and may come closer to the
    # rim, where its derivative would run off to infinity: half of this cosine is the least to divide by.
    depth = jnp.where(cuts, (cut.shift[0] + distance) * step, 0)
    least_cos = jnp.maximum(jnp.sqrt(jnp.maximum(depth * fixed_shape.curvature / 2, 0)), GRAZING)
    least_cos = stop_gradient(least_cos)
    si = materialize(hit_surface(near, nearest.shape, surface, t, least_cos, present), live)

    # What goes past ignores this surface and the one passed before, and counts for what is left of the pixel.
    passed = jnp.stack([passed, rays.footprint.passed[0]])
    throughput = rays.throughput * stop_gradient(1 - cut.area)
    past = eqx.tree_at(lambda r: (r.footprint.passed, r.throughput), far, (passed, throughput))
    return si, near, jnp.where(cuts, cut.area, 1), cuts, past, corner


def border_at(
    rays: Rays,
    surface: coverage.SurfaceAhead,
    shapes: Shapes,
    other: Integers,
    outside: Flags,
    is_outline: Flags | bool,
) -> Edge:
    """`solid.border` with faces that are given by their indices; negative ones for none."""
    edge = border(rays, surface.shape, surface.t, outside, take(shapes, jnp.maximum(other, 0)), is_outline)
    return eqx.tree_at(lambda e: e.exists, edge, edge.exists & (other >= 0))


def hit_surface(
    rays: Rays, index: Integers, surface: coverage.SurfaceAhead, t: Scalars, least_cos: Scalars, present: Flags
) -> SurfaceInteraction:
    """The hit of each ray on the surface that it is known to meet."""
    shape, side = surface.shape, surface.side
    t = hit_distance(jnp.where(present, t, 1), rays.o, rays.d, shape, least_cos, side)
    p = rays.o + t * rays.d
    n = surfaces.surface_normal(p, shape)
    # A sphere keeps its side to the ray, also where the shifted ray only just misses it: rounding must not decide. What
    # the cosine lacks of its least value is added to the normal along the ray.
    n = safe_normalize(n)
    short = jnp.where(surface.curved, jnp.maximum(least_cos - side * dot(n, rays.d), 0), 0)
    n = safe_normalize(n + side * short * rays.d)
    path_length = rays.path_length + t
    valid = present & ends_in_time(path_length, shape.settings)
    return SurfaceInteraction(valid, t, p, n, jnp.maximum(index, 0), path_length)


def meet(rays: Rays, shapes: Shapes, nearest: Nearest, found: Flags) -> coverage.SurfaceAhead:
    shape = take(shapes, jnp.maximum(nearest.shape, 0))
    curved = shape.curvature > 0
    # For a ball by definition: where the ray only just touches it the cosine is 0, and rounding would choose its sign.
    flat = jnp.where(dot(shape.normal, rays.d) < 0, -1, 1)
    side = jnp.where(curved, jnp.where(nearest.outside, -1, 1), flat).astype(rays.o.dtype)
    t = hit_distance(jnp.where(found, nearest.t, 1), rays.o, rays.d, shape, GRAZING, side)
    return coverage.SurfaceAhead(shape, curved, t, side, surfaces.approach(rays, shape, t, side))


def move(rays: Rays, direction, fraction, cut: coverage.Cut, cuts) -> list[Rays]:
    """Rays at the centroids of the near and the far part of the footprints that are cut, which become their footprints.

    `direction` is the edge's unit normal in the footprint's own coordinates.
    """
    footprint = rays.footprint

    def part(shift: Scalars, width: Scalars):
        offset = jnp.where(cuts, direction * fraction * shift, 0)[:, None]
        o, d = rays.o + jnp.sum(offset * footprint.o, 0), rays.d + jnp.sum(offset * footprint.d, 0)
        # The part becomes a parallelogram again, of the part's variance across the edge: with J the footprint and n the
        # edge's normal it is J (1 - loss n n^T).
        lost = jnp.where(cuts, fraction * (1 - width), 0) * direction

        def narrow(axes):
            return axes - lost[:, None] * jnp.sum(direction[:, None] * axes, 0)

        return o, safe_normalize(d), *stop_gradient((narrow(footprint.o), narrow(footprint.d)))

    parts = unstacked(jax.vmap(part)(cut.shift, cut.width), 2)
    return [eqx.tree_at(lambda r: (r.o, r.d, r.footprint.o, r.footprint.d), rays, each) for each in parts]
