"""The pure picture: its sizes are a matter of room only."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import set_parameters
from raytrace_jax.tracer.pure import Room, pure_picture
from raytrace_jax.tracer.run import Capacity

SETTINGS = resolved(size=(24, 18), max_bounces=1, edges="aware")
ROOMS = (Capacity(8192, 432), Capacity(1024, 48))


def picture(index, capacity):
    film = pure_picture(set_parameters(assignment_scene(), {"vitreous.ior": index}), SETTINGS, Room(capacity))
    return film.image, film.overflow


@pytest.mark.slow
def test_edge_aware_pictures_and_derivatives_do_not_depend_on_room_and_both_modes_agree():
    x, assert_near = jnp.asarray(1.36), np.testing.assert_allclose
    assignment_scene()  # It is kept, and must not be made while JAX traces.
    found = []
    for capacity in ROOMS:
        image = lambda x, capacity=capacity: picture(x, capacity)  # noqa: E731
        forward = jax.jit(lambda x, image=image: jax.jvp(image, (x,), (jnp.ones_like(x),), has_aux=True))(x)
        backward = jax.jit(jax.grad(lambda x, image=image: jnp.sum(image(x)[0] ** 2)))(x)
        assert forward[2] == 0
        assert_near(backward, 2 * jnp.sum(forward[0] * forward[1]), rtol=1e-9)
        found.append(forward)
    for one, other in zip(*found, strict=True):
        assert_near(one, other, rtol=1e-9, atol=1e-12)
