"""Edge-aware tracing of only those pixels that see an edge: mostly one or two of ten.

All camera rays are traced as whole areas first, with their footprints but without splitting any. That is exact where
no ray of a pixel's tree sees an edge or spreads widely, and tells where one does. Those pixels are packed into a list
and traced anew, edge-aware.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.levels.compaction import gather, pack, unpack
from raytrace_jax.tracer.levels.wavefront import Trace, trace_channels
from raytrace_jax.tracer.programs.plan import Plan, Wanted
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, WholeSettings
from raytrace_jax.tracer.world import World


def trace_pixels(
    world: World, rays: Rays, live: Bool[Array, " rays"], plan: Plan, settings: ResolvedSettings
) -> tuple[Trace, Wanted]:
    """Trace camera rays and all that they send on. Where the plan says so, only pixels that see an edge are split.

    Args:
        world: the scene.
        rays: one batch of camera rays, as many as the plan's first stage holds.
        live: which of them count; the others are black.
        plan: with `edges`, where pixels that see an edge are traced apart from the others.
        settings: the model's settings.

    Returns:
        The trace, whose `wanted` and `sees_edge` are those of whole areas where the plan has `edges`; and how many rays
        were to be traced.
    """
    if plan.edges is None:
        traced = trace_channels(world, rays, live, plan.stages, settings)
        return traced, Wanted(traced.wanted)
    whole = trace_channels(world, rays, live, plan.stages, WholeSettings.of(settings))
    sees_edge = whole.sees_edge
    assert sees_edge is not None
    listed = pack(sees_edge[None], plan.edges[0].capacity)
    some = jax.tree.map(lambda x: gather(x, listed.candidate), rays)
    aware = trace_channels(world, some, listed.live, plan.edges, settings)

    def put_back(all_: Array, some: Array) -> Array:
        (found,) = unpack(some.reshape(-1, some.shape[-1]), listed)
        return jnp.where(sees_edge, found.reshape(all_.shape), all_)

    parts = [(trace.color, trace.first, trace.bounce_count) for trace in (whole, aware)]
    color, first, bounce_count = jax.tree.map(put_back, *parts)
    wanted = Wanted(whole.wanted, jnp.concatenate([listed.count[None], aware.wanted]))
    return Trace(color, first, bounce_count, whole.wanted, sees_edge), wanted
