"""The pure picture and its derivatives in both modes are those of the programs that render and differentiate."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assignment_scene, resolved

from raytrace_jax import picture_derivatives, set_parameters
from raytrace_jax.tracer.pure import Room, pure_picture
from raytrace_jax.tracer.run import Capacity

SETTINGS = resolved(size=(24, 18), crop=(1, 0, 22, 18), max_bounces=1, edges="aware")


@pytest.mark.slow
def test_edge_aware_pictures_and_derivatives_do_not_depend_on_room_and_both_modes_agree():
    scene, room = assignment_scene(), Room(Capacity(1024, 48))

    def picture(index):
        film = pure_picture(set_parameters(scene, {"vitreous.ior": index}), SETTINGS, room)
        return film.image, film.overflow

    @jax.jit
    def in_both_modes(index):
        image, change, overflow = jax.jvp(picture, (index,), (jnp.ones(()),), has_aux=True)
        return image, change, jax.grad(lambda index: jnp.sum(picture(index)[0] ** 2))(index), overflow

    image, change, backward, overflow = in_both_modes(jnp.asarray(1.36))
    assert overflow == 0
    np.testing.assert_allclose(backward, 2 * np.sum(image * change), rtol=1e-9)
    found = picture_derivatives(set_parameters(scene, {"vitreous.ior": 1.36}), ["vitreous.ior"], SETTINGS)
    np.testing.assert_allclose(image, found.image, atol=1e-11)
    np.testing.assert_allclose(change, found.values[0], rtol=1e-8, atol=1e-9)
