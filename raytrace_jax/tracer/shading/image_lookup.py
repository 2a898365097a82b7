import jax.numpy as jnp


def image_at(texels, u, v, filter, wrap, axes):
    _, h, w = texels.shape
    c, r = u * w - 0.5, (1 - v) * h - 0.5
    c0, r0 = jnp.floor(c), jnp.floor(r)
    fc, fr = c - c0, r - r0

    def at(i, j):
        return texels[:, jnp.clip(j, 0, h - 1).astype(jnp.int32), jnp.clip(i, 0, w - 1).astype(jnp.int32)]

    top = at(c0, r0) * (1 - fc) + at(c0 + 1, r0) * fc
    low = at(c0, r0 + 1) * (1 - fc) + at(c0 + 1, r0 + 1) * fc
    return top * (1 - fr) + low * fr
