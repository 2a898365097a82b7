"""Light of several colours through glass that bends them differently: each channel is traced on its own."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.levels.wavefront import Stage, Trace, trace
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.shading.materials import LINE_CHANNEL
from raytrace_jax.tracer.world import World


def trace_channels(
    world: World, rays: Rays, live: Bool[Array, " rays"], stages: tuple[Stage, ...], settings: ResolvedSettings
) -> Trace:
    """As `wavefront.trace`; where glass has dispersion one channel after the other, which takes three times as long.

    What is not a colour is that of the green channel, but for rays and edges: what any channel wants or sees counts.
    """
    if world.channel_ior is None:
        return trace(world, rays, live, stages, settings)

    def trace_one(ior):
        one = eqx.tree_at(lambda w: w.materials.ior, world, ior)
        return trace(one, rays, live, stages, settings)

    each = jax.lax.map(jax.checkpoint(trace_one, prevent_cse=False), world.channel_ior)
    color = jnp.stack([each.color[channel, channel] for channel in range(3)])
    first, bounce_count = jax.tree.map(lambda x: x[LINE_CHANNEL], (each.first, each.bounce_count))
    wanted, sees_edge = jax.tree.map(lambda x: jnp.max(x, axis=0), (each.wanted, each.sees_edge))
    return Trace(color, first, bounce_count, wanted, sees_edge)
