"""Point lights of the course's model: diffuse light and highlights, without shadows, falling off with 1/r."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from raytrace_jax.scene.scene import PointLights
from raytrace_jax.tracer.geometry.intersection import Nodes
from raytrace_jax.tracer.shading.lights import LightSample, light_samples
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

    Returns:
        The sums with the diffuse weight and with the specular one.
    """

    def one_light(light: LightSample):
        cos, inverse_r, lobe = toward_light(nodes, light)
        lit = jnp.where((cos > 0) & (cos < 1), 1, 0).astype(cos.dtype)
        # Unlike diffuse light a highlight does not fade towards where the light sets: a footprint sees it in part.
        share = lit if nodes.single else positive_shares(cos)
        return mean(lit * inverse_r * cos), mean(share * inverse_r * lobe)

    samples = list(light_samples(lights, nodes.p))
    amounts = [one_light(light) for light in samples]
    if not nodes.single:  # Much to compute anew for each channel; of a single point it is little.
        amounts = materialize(amounts, valid)
    diffuse = specular = jnp.zeros((3, *valid.shape), nodes.p.dtype)
    for light, (diffuse_amount, specular_amount) in zip(samples, amounts, strict=True):
        emissivity = per_ray(light.emissivity, 1)
        diffuse += diffuse_amount * emissivity
        specular += specular_amount * emissivity
    return diffuse, specular


def toward_light(nodes: Nodes, light: LightSample) -> tuple[Float[Array, "*nodes rays"], ...]:
    """Cosine of a light's direction and the normal, the falloff 1/r, and the highlight's lobe `(R.V)^32`."""
    inverse_r = light.inverse_distance
    cos = dot(nodes.n, light.toward) * inverse_r
    # R.V with R = reflect(L, n) and V = -d, without building R.
    lobe = 2 * cos * dot(nodes.d, nodes.n) - dot(light.toward, nodes.d) * inverse_r
    for _ in range(5):
        lobe = lobe * lobe
    return cos, inverse_r, lobe
