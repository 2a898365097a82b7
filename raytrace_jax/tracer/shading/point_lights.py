"""Point lights of the course's model: diffuse light and highlights, without shadows, falling off with 1/r."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.scene.scene import PointLights
from raytrace_jax.tracer.geometry.intersection import Nodes
from raytrace_jax.tracer.shading.lights import LightSample, sample
from raytrace_jax.tracer.shading.quadrature import mean, positive_shares
from raytrace_jax.util.numerics import dot, materialize, per_ray


def light_sums(
    nodes: Nodes, valid: Bool[Array, " rays"], lights: PointLights
) -> tuple[Float[Array, "3 rays"], Float[Array, "3 rays"]]:
    """Light that reaches each hit, weighted for the diffuse and for the specular colour: the mean over the nodes.

    The specular weight is `(R.V)^32`, an even power of a cosine that nothing keeps positive: the far side of the
    reflection lights up as well. That is the course's model.

    Args:
        nodes: of each hit.
        valid: which hits there are.
        lights: the scene's.
    """

    def one_light(k: int):
        cos, inverse_r, lobe = toward_light(nodes, sample(lights, k, nodes.p))
        lit = jnp.where((cos > 0) & (cos < 1), 1, 0).astype(cos.dtype)
        # Unlike diffuse light a highlight does not fade towards where the light sets: a footprint sees it in part.
        share = lit if nodes.single else positive_shares(cos)
        return mean(lit * inverse_r * cos), mean(share * inverse_r * lobe)

    def colored(k: int, amounts):
        emissivity = per_ray(lights.emissivity[:, k], 1)
        return tuple(amount * emissivity for amount in amounts)

    def add(a, b):
        return a[0] + b[0], a[1] + b[1]

    amounts = [one_light(k) for k in range(len(lights.names))]
    if not nodes.single:  # Much to compute anew for each channel; of a single point it is little.
        amounts = materialize(amounts, valid)
    none = jnp.zeros((3, *valid.shape), nodes.p.dtype)
    return functools.reduce(add, (colored(k, pair) for k, pair in enumerate(amounts)), (none, none))


def toward_light(nodes: Nodes, light: LightSample) -> tuple[Float[Array, "*nodes rays"], ...]:
    """Cosine of a light's direction and the normal, the falloff 1/r, and the highlight's lobe `(R.V)^32`."""
    inverse_r = light.inverse_distance
    cos = dot(nodes.n, light.toward) * inverse_r
    # R.V with R = reflect(L, n) and V = -d, without building R.
    lobe = 2 * cos * dot(nodes.d, nodes.n) - dot(light.toward, nodes.d) * inverse_r
    for _ in range(5):
        lobe = lobe * lobe
    return cos, inverse_r, lobe
