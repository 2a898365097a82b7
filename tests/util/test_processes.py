"""A renderer beside JAX's own ways: without jit, on another device, on shards, and in a process that was forked."""

import functools
import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.sharding import PartitionSpec

from raytrace_jax import RenderSettings, parse_scene, picture_derivatives, render, set_parameters

SCENE = """settings main { model physical max_bounces 2 }
camera eye { pixeldim 12 9 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
material board { emission 1 .5 .2 }
material crown { transmission 1 ior 1.5 }
rectangle backdrop { material board center 0 0 -2.5 right 1 0 0 up 0 1 0 }
sphere ball { material crown center 0.12 -0.07 0.15 radius 1 }
"""
POINTS = RenderSettings(edges="point")
several = pytest.mark.skipif(jax.device_count() < 2, reason="one device")


def test_without_jit_a_picture_is_the_same():
    scene = parse_scene(SCENE)
    wanted = render(scene, POINTS).image
    with jax.disable_jit():
        np.testing.assert_array_equal(render(scene, POINTS).image, wanted)


@several
def test_a_scene_on_another_device():
    scene = parse_scene(SCENE)
    there = jax.device_put(scene, jax.devices()[1])
    np.testing.assert_array_equal(render(there, POINTS).image, render(scene, POINTS).image)
    found, wanted = (picture_derivatives(one, ["crown.ior"], POINTS).values for one in (there, scene))
    np.testing.assert_array_equal(found, wanted)


@several
def test_a_renderer_on_shards():
    scene, mesh = parse_scene(SCENE), jax.make_mesh((2,), ("x",), axis_types=(jax.sharding.AxisType.Auto,))
    renderer, share = functools.partial(render, settings=POINTS), PartitionSpec("x")

    def one(index):
        return renderer(set_parameters(scene, {"crown.ior": index[0]})).image[None]

    found = jax.jit(jax.shard_map(one, mesh=mesh, in_specs=share, out_specs=share, check_vma=False))(
        jnp.array([1.4, 1.6])
    )
    wanted = [render(set_parameters(scene, {"crown.ior": index}), POINTS).image for index in (1.4, 1.6)]
    np.testing.assert_allclose(found, wanted, atol=1e-5)


FORKED = """
import os, signal, warnings
import raytrace_jax as package
warnings.simplefilter("ignore")
scene = package.parse_scene({text!r})
child = os.fork()
if child == 0:
    signal.alarm(40)
    for call in (lambda: package.render(scene), lambda: package.parse_scene({text!r})):
        try:
            call()
        except package.RaytraceError as error:
            print(error, flush=True)
    os._exit(0)
assert os.waitpid(child, 0)[1] == 0
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork")
def test_a_forked_process_is_refused():
    command = [sys.executable, "-c", FORKED.format(text=SCENE)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=100, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("this process was forked from one that had used JAX") == 2
