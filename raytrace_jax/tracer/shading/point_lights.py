"""Point lights of the course's model: diffuse light and highlights, without shadows, falling off with 1/r."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import PointLights
from raytrace_jax.tracer.geometry.intersection import Hits
from raytrace_jax.tracer.shading.lights import LightSample, sample
from raytrace_jax.tracer.shading.quadrature import Nodes, mean, positive_shares
from raytrace_jax.util.numerics import dot, materialize, per_ray


def light_sums(nodes: Nodes, lights: PointLights) -> tuple[Float[Array, "3 *rays"], Float[Array, "3 *rays"]]:
    """Light that reaches each hit, weighted for the diffuse and for the specular colour: the mean over the nodes.

    The specular weight is `(R.V)^32`, an even power of a cosine that nothing keeps positive: the far side of the
    reflection lights up as well. That is the course's model.
    """

    def one_light(k: int):
        rays = [toward_light(hits, d, sample(lights, k, hits.p)) for hits, d in nodes]
        lit = [jnp.where((cos > 0) & (cos < 1), 1, 0).astype(cos.dtype) for cos, _, _ in rays]
        # Unlike diffuse light a highlight does not fade towards where the light sets: a footprint sees it in part.
        shares = positive_shares([cos for cos, _, _ in rays]) if len(nodes) > 1 else lit
        diffuse = mean([on * inverse_r * cos for on, (cos, inverse_r, _) in zip(lit, rays, strict=True)])
        specular = mean([share * inverse_r * lobe for share, (_, inverse_r, lobe) in zip(shares, rays, strict=True)])
        return diffuse, specular

    def colored(k: int, amounts):
        emissivity = per_ray(lights.emissivity[:, k], hits.t.ndim)
        return tuple(amount * emissivity for amount in amounts)

    def add(a, b):
        return a[0] + b[0], a[1] + b[1]

    hits = nodes[0][0]
    amounts = [one_light(k) for k in range(len(lights.names))]
    if len(nodes) > 1:  # Much to compute anew for each channel; of a single point it is little.
        amounts = materialize(amounts, hits.valid)
    none = jnp.zeros_like(hits.p)
    return functools.reduce(add, (colored(k, pair) for k, pair in enumerate(amounts)), (none, none))


def toward_light(hits: Hits, d: Float[Array, "3 *rays"], light: LightSample) -> tuple[Float[Array, " *rays"], ...]:
    """Cosine of a light's direction and the normal, the falloff 1/r, and the highlight's lobe `(R.V)^32`."""
    inverse_r = light.inverse_distance
    cos = dot(hits.n, light.toward) * inverse_r
    # R.V with R = reflect(L, n) and V = -d, without building R.
    lobe = 2 * cos * dot(d, hits.n) - dot(light.toward, d) * inverse_r
    for _ in range(5):
        lobe = lobe * lobe
    return cos, inverse_r, lobe
