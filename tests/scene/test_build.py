"""Scenes built in Python: the same as from a file, with the same errors, and differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scenes import assert_same_scene

from raytrace_jax import ModelFileError, SceneError, build, format_scene, make_scene, parse_scene
from raytrace_jax.scene.table import BLOCK_TYPES

EYE = {"pixeldim": (4, 3), "viewpoint": (0, 0, 5), "lookat": (0, 0, 0), "fov": 40}
CAMERA = build.camera("eye", **EYE)
GLASS = build.material("glass", ior=1.5, alpha=1)
BOARD = build.rectangle("board", material="glass", center=(0, 0, -2), right=(1, 0, 0), up=(0, 1, 0))
BALL = build.sphere("ball", material="glass", center=(0, 0, 0), radius=1)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("model", ["classic", "additive"])
def test_a_built_scene_is_that_of_the_file(model, dtype):
    scene = make_scene(
        BALL,  # Before its material, as in a file.
        CAMERA,
        build.light("lamp", location=(2, 4, 3), emissivity=(1, 0.5, 1 / 3), energy=7),
        GLASS,
        build.material("board", ambient=[0.1, 0.2, 0.3], hardness=np.float32(20)),
        build.plane("floor", material="board", normal=(0, 1, 0), point=np.array([0, -1, 0])),
        build.rectangle("backdrop", material="board", center=(0, 0, -2.5), right=(6, 0, 0), up=jnp.array([0, 4.0, 0])),
        build.sphere("small.ball", material="glass", center=(1, 2, 3), radius=(0.25,)),
        dtype=dtype,
        model=model,
    )
    text = """
        sphere ball { material glass center 0 0 0 radius 1 }
        camera eye { pixeldim 4 3 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
        light lamp { location 2 4 3 emissivity 1 .5 0.3333333333333333 energy 7 }
        material glass { ior 1.5 alpha 1 }
        material board { ambient .1 .2 .3 hardness 20 }
        plane floor { material board normal 0 1 0 point 0 -1 0 }
        rectangle backdrop { material board center 0 0 -2.5 right 6 0 0 up 0 4 0 }
        sphere small.ball { material glass center 1 2 3 radius .25 }
        """
    assert_same_scene(scene, parse_scene(text, dtype=dtype, model=model))
    assert_same_scene(scene, parse_scene(format_scene(scene, model=model), dtype=dtype, model=model))
    assert scene.shape_order == ("ball", "floor", "backdrop", "small.ball")
    course = make_scene(build.camera("eye", pixeldim=np.array([4, 3]), worlddim=(8, 6), viewpoint=(4, 3, 6)))
    assert_same_scene(course, parse_scene("camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 }"))
    assert course.camera.pixeldim == (4, 3)


def test_every_keyword_has_a_constructor():
    assert set(dir(build)) == {"make_scene", *BLOCK_TYPES}
    for keyword, kinds in BLOCK_TYPES.items():
        constructor = getattr(build, keyword)
        assert constructor.__name__ == keyword and "make_scene" in constructor.__doc__
        assert all(attribute.name in constructor.__doc__ for kind in kinds for attribute in kind.attributes)
    assert "    radius takes 1 number, greater than 0; required" in build.sphere.__doc__
    assert "center takes 2 numbers (x y); default: the picture's middle" in build.camera.__doc__
    assert "ior takes 1 number, greater than 0; default: 1, 1.45 (additive), 1.5 (physical)" in build.material.__doc__
    with pytest.raises(AttributeError, match="no attribute 'cone'; there are make_scene, settings, camera"):
        build.cone  # noqa: B018


def test_blocks_can_be_used_more_than_once():
    one, other = (make_scene(CAMERA, GLASS, BALL, dtype=dtype) for dtype in (np.float32, np.float64))
    assert (one.spheres.radius.dtype, other.spheres.radius.dtype) == (np.float32, np.float64)
    assert make_scene(CAMERA, GLASS, BALL, model="additive").materials.diffuse[0, 0] > 0
    assert make_scene(CAMERA, GLASS, BALL).materials.diffuse[0, 0] == 0


@pytest.mark.parametrize(
    ("describe", "words"),
    [
        (lambda: [BALL, GLASS], ["no camera"]),
        (lambda: [CAMERA, CAMERA], ["second camera", "camera 'eye' comes before it"]),
        (lambda: [CAMERA, BALL], ["sphere 'ball' has the unknown material 'glass'", "in this scene: none"]),
        (lambda: [CAMERA, build.sphere("a b", radius=1)], ["name for this sphere", "'a b'", "one word"]),
        (lambda: [build.camera("eye", **EYE | {"pixeldim": (4.5, 3)})], ["2 whole numbers (x y)", "(4.5, 3)"]),
        (lambda: [CAMERA, build.material("m", ior="glass")], ["ior takes a number", "'glass'"]),
        (lambda: [CAMERA, build.material("m", ior=np.inf)], ["ior must be finite in float32", "inf"]),
        (lambda: [CAMERA, build.material("m", ambient=1)], ["ambient takes 3 numbers"]),
        (lambda: [CAMERA, build.sphere("s", material=3, center=(0, 0, 0), radius=1)], ["name of a material", "'3'"]),
    ],
)
def test_errors_name_the_block(describe, words):
    with pytest.raises(SceneError) as caught:
        make_scene(*describe(), dtype=np.float32)
    for word in words:
        assert word in str(caught.value)
    assert len(str(caught.value)) < 500


def test_messages_are_the_readers():
    """But for the place, which a file has and a program has not."""
    text = "camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 } sphere ball { radus 1 }"
    with pytest.raises(ModelFileError) as of_file:
        parse_scene(text, source="my.txt")
    with pytest.raises(SceneError) as of_python:
        build.sphere("ball", radus=1)
    assert str(of_file.value) == f"my.txt:1:72: {of_python.value}"


def test_values_may_be_traced():
    def described(x, radius, fov):
        eye = build.camera("eye", **EYE | {"fov": fov})
        ball = build.sphere("ball", material="glass", center=(x, 2 * x, -1.0), radius=radius)
        return make_scene(eye, GLASS, ball, BOARD)

    scene = jax.jit(described)(0.5, jnp.asarray([2.0]), 50.0)
    assert scene.spheres.center.T.tolist() == [[0.5, 1, -1]]
    assert (scene.spheres.radius.tolist(), float(scene.camera.fov)) == ([2], 50)
    slopes = jax.grad(lambda x: jnp.sum(described(x, 2.0, 50.0).spheres.center ** 2))(0.5)
    assert slopes == pytest.approx(2 * 0.5 + 8 * 0.5)
