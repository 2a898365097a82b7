"""Programs of a user's, compiled as the package compiles its own, are right also where JAX's own settings are not."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from raytrace_jax import RenderSettings, compiler_options, make_residual, parse_scene, render, set_parameters

ROWS = 19_200
SCENE = """
camera eye { pixeldim 96 64 worlddim 8 6 viewpoint 4 3 6 }
light lamp { location 6 5 4 emissivity 1 1 1 }
material board { ambient 1 2 3 diffuse 0.7 0.7 0.7 }
plane board { material board normal 0 0 1 point 0 0 -4 }
"""


@pytest.mark.parametrize(("shape", "dtype"), [((3, 3), "float64"), ((2, 5), "float64"), ((3, 3), "float32")])
def test_products_of_many_rows_are_right(shape, dtype):
    """Compiled by JAX 0.10.2's settings, rows from 16,384 on in float64 are wrong (jax#39103)."""
    random, count = np.random.default_rng(0), 32_769 if dtype == "float32" else ROWS
    matrix, rows = random.normal(size=shape).astype(dtype), random.normal(size=(count, shape[1])).astype(dtype)
    squares = jax.vmap(lambda row: jnp.sum((jnp.asarray(matrix) @ row) ** 2))
    found = jax.jit(squares, compiler_options=compiler_options())(rows)
    np.testing.assert_allclose(found, np.sum((rows @ matrix.T) ** 2, 1), rtol=1e-9 if dtype == "float64" else 1e-3)


def test_sums_of_a_whole_picture_are_right():
    """A step of Gauss and Newton, and a gradient, sum over 18,432 numbers of a residual."""
    scene, free = parse_scene(SCENE), ["board.diffuse", "lamp.location.z"]
    settings = RenderSettings(size=(96, 64), max_bounces=0)
    truth = {"board.diffuse": (0.5, 0.6, 0.8), "lamp.location.z": 4.5}
    picture = make_residual(scene, render(set_parameters(scene, truth), settings).image, free, settings)

    def difference(y):
        return jnp.ravel(jax.tree.leaves(picture.residual(y))[0])

    def sums(y):
        residual, jacobian = difference(y), jax.jacfwd(difference)(y)
        gradient = jax.grad(lambda y: 0.5 * jnp.sum(difference(y) ** 2))(y)
        return residual, jacobian, jacobian.T @ residual, jacobian.T @ jacobian, jnp.sum(jacobian**2, 0), gradient

    residual, jacobian, *found = map(np.asarray, jax.jit(sums, compiler_options=compiler_options())(picture.start))
    assert residual.shape == (18_432,) and np.all(np.any(jacobian, 0))
    slope = jacobian.T @ residual
    for ours, wanted in zip(found, (slope, jacobian.T @ jacobian, np.sum(jacobian**2, 0), slope), strict=True):
        np.testing.assert_allclose(ours, wanted, rtol=1e-9, atol=1e-9)


def test_products_of_rank_seven_do_not_crash():
    """JAX 0.10.2 and 0.11.0 end the process with a segmentation fault by their own settings (jax#39257)."""
    ones = jnp.ones((3, 1, 2, 2, 8, 8, 8), jnp.float32)
    summed = jax.jit(lambda a, b: jnp.sum(a * b, axis=3), compiler_options=compiler_options())
    np.testing.assert_array_equal(summed(ones, ones), 2)
