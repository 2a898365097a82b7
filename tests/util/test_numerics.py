"""Loops that end with the last of many, and that reverse mode goes through."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from raytrace_jax.util.numerics import only_if, repeat


def power(x, n, reversible):
    """`x ** n` for n up to 6 by repeated products."""

    def step(state):
        product, left = state
        return jnp.where(left > 0, product * x, product), left - 1

    return repeat(step, (jnp.ones_like(x), n), lambda state: state[1] > 0, 6, reversible)[0]


@pytest.mark.parametrize("reversible", [False, True])
def test_a_loop_ends_with_the_last_of_many(reversible):
    x, counts = jnp.asarray(1.5), jnp.array([0, 3, 6, 1])
    many = jax.vmap(lambda n: power(x, n, reversible))(counts)
    np.testing.assert_allclose(many, 1.5 ** np.array([0, 3, 6, 1]), rtol=1e-15)
    # The condition is one of all: no choice between old and new values at each step.
    program = str(jax.make_jaxpr(jax.vmap(lambda n: power(x, n, reversible)))(counts))
    assert program.count("select_n") == 1  # The step's own.


def test_both_kinds_have_the_derivative():
    for n in range(7):
        slope = n * 1.5 ** (n - 1)
        forward = jax.jvp(lambda x, n=n: power(x, n, False), (jnp.asarray(1.5),), (jnp.asarray(1.0),))[1]
        reverse = jax.grad(lambda x, n=n: power(x, n, True))(jnp.asarray(1.5))
        np.testing.assert_allclose([forward, reverse], slope, rtol=1e-14)


def test_what_is_not_asked_is_zero():
    def rooted(x):
        return jnp.sqrt(x), {"same": x}

    for x, wanted in ((4.0, (2.0, 4.0)), (-1.0, (0.0, 0.0))):
        root, rest = only_if(jnp.asarray(x) > 0, rooted, jnp.asarray(x))
        assert (float(root), float(rest["same"])) == wanted
    slopes = jax.vmap(jax.grad(lambda x: only_if(jnp.asarray(True), rooted, x)[0]))(jnp.array([1.0, 4.0]))
    np.testing.assert_allclose(slopes, [0.5, 0.25])
