"""Derivatives of a picture by the pixels of a texture and of an environment, which a scene has as arrays."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from raytrace_jax import (
    ParameterError,
    RenderSettings,
    build,
    compiler_options,
    make_scene,
    render,
    set_parameters,
)

PIXELS = np.random.default_rng(0).uniform(0.2, 0.9, (3, 6, 8))
SETTINGS = RenderSettings(size=(12, 9), max_bounces=2, edges="point")
STEP = 1e-4


def with_pixels(pixels, use):
    """A ball of glass before a painted board, or before the sky alone, which is painted."""
    board = [
        build.material("board", emission=(1, 1, 1), texture="paint"),
        build.rectangle("back", material="board", center=(0, 0, -1.5), right=(4, 0, 0), up=(0, 4, 0)),
    ]
    return make_scene(
        build.camera("eye", pixeldim=(12, 9), viewpoint=(0, 0, 5), lookat=(0, 0, 0), fov=36),
        build.texture("paint", kind="image", file=pixels),
        build.material("glass", transmission=1, ior=1.5),
        build.sphere("ball", material="glass", center=(0.1, -0.1, 0.5), radius=0.7),
        *(board if use == "board" else [build.background("sky", radiance=(1, 1, 1), texture="paint")]),
        model="physical",
    )


@pytest.mark.parametrize("use", ["board", "sky"])
def test_gradients_by_pixels_are_differences(use):
    """A picture is linear in them, so that a difference is exact but for rounding."""
    renderer = functools.partial(render, settings=SETTINGS)
    weights = np.random.default_rng(1).normal(size=(3, 9, 12))

    def loss(pixels):
        return jnp.sum(weights * renderer(with_pixels(pixels, use)).image)

    value = jax.jit(loss, compiler_options=compiler_options())
    gradient = np.asarray(jax.jit(jax.grad(loss), compiler_options=compiler_options())(jnp.asarray(PIXELS)))
    assert np.count_nonzero(gradient) > 12
    most = [np.unravel_index(k, gradient.shape) for k in np.argsort(-abs(gradient), axis=None)[:12:3]]
    for place in [*most, (0, 0, 0), (2, 3, 4)]:
        up, down = PIXELS.copy(), PIXELS.copy()
        up[place] += STEP
        down[place] -= STEP
        difference = (value(jnp.asarray(up)) - value(jnp.asarray(down))) / (2 * STEP)
        np.testing.assert_allclose(gradient[place], difference, rtol=1e-6, atol=1e-8)


def test_a_new_texture_is_a_new_scene():
    with pytest.raises(ParameterError, match=r"'paint.file' is not a continuous .* build.texture\(..., file=array\)"):
        set_parameters(with_pixels(PIXELS, "board"), {"paint.file": PIXELS})
