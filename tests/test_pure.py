"""The pure picture: its sizes are a matter of room only."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import set_parameters
from raytrace_jax.tracer.pure import Room, pure_picture
from raytrace_jax.tracer.run import Capacity

SETTINGS = resolved(size=(24, 18), max_bounces=1, edges="aware")


@functools.partial(jax.jit, static_argnums=1)
def in_both_modes(index, capacity):
    """A picture, its derivative by an index, the derivative of the sum of its squares in reverse mode, and overflow."""

    def picture(index):
        film = pure_picture(set_parameters(assignment_scene(), {"vitreous.ior": index}), SETTINGS, Room(capacity))
        return film.image, film.overflow

    image, change, overflow = jax.jvp(picture, (index,), (jnp.ones(()),), has_aux=True)
    return image, change, jax.grad(lambda index: jnp.sum(picture(index)[0] ** 2))(index), overflow


@pytest.mark.slow
def test_edge_aware_pictures_and_derivatives_do_not_depend_on_room_and_both_modes_agree():
    assignment_scene()  # It is kept, and must not be made while JAX traces.
    many, few = (in_both_modes(jnp.asarray(1.36), capacity) for capacity in (Capacity(8192, 432), Capacity(1024, 48)))
    assert many[3] == few[3] == 0
    np.testing.assert_allclose(many[2], 2 * np.sum(many[0] * many[1]), rtol=1e-9)
    for one, other in zip(many[:3], few[:3], strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-12)
