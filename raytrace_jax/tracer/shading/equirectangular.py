import jax.numpy as jnp

from raytrace_jax.tracer.shading.image_lookup import image_at


def equirectangular_at(texels, d, axes):
    u = jnp.arctan2(d[0], -d[2]) / (2 * jnp.pi) + 0.5
    v = 1 - jnp.arccos(d[1]) / jnp.pi
    return image_at(texels, u, v, "bilinear", "repeat", axes)
