"""How large a scene is, to make numbers that mean lengths follow it."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene.scene import ImagePlaneCamera, Scene


def world_length(scene: Scene) -> Float[Array, ""]:
    """The order of magnitude of a scene's lengths: exactly a power of ten, without a derivative, also inside `jax.jit`.

    It is the power of ten that is nearest, in the logarithm, to what the camera shows: the diagonal of the image plane,
    or the distance from viewpoint to lookat. The course's scenes have 10 world units.
    """
    camera = scene.camera
    across = camera.worlddim if isinstance(camera, ImagePlaneCamera) else camera.lookat - camera.viewpoint
    across = jax.lax.stop_gradient(across)
    # By logarithms, because squares may overflow or vanish.
    exponents = jnp.log10(jnp.maximum(jnp.abs(across), jnp.finfo(across.dtype).tiny))
    largest = jnp.max(exponents)
    exponent = largest + jnp.log10(jnp.sum(10 ** (2 * (exponents - largest)))) / 2
    powers = _powers_of_ten(across.dtype)
    place = jnp.clip(jnp.round(exponent).astype(jnp.int32) - _least_exponent(across.dtype), 0, len(powers) - 1)
    return jnp.asarray(powers)[place]


def _least_exponent(dtype: np.dtype) -> int:
    """The exponent of the smallest power of ten that is a normal number."""
    return int(np.ceil(np.log10(np.finfo(dtype).tiny)))


def _powers_of_ten(dtype: np.dtype) -> np.ndarray:
    """All powers of ten, as exact as numbers can be: `10**x` of a float is not."""
    exponents = range(_least_exponent(dtype), int(np.log10(np.finfo(dtype).max)) + 1)
    return np.array([f"1e{exponent}" for exponent in exponents], np.float64).astype(dtype)
