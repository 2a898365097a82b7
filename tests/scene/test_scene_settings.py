"""What is not asked for comes from the scene's file, and else from the model as which the scene was loaded."""

import dataclasses

import numpy as np
import pytest

import raytrace_jax as rj
from raytrace_jax.scene.structs import FileSettings
from raytrace_jax.tracer.settings import ResolvedSettings, resolve_settings

BOARD = """
settings main { model physical max_bounces 1 edges point samples 1 }
camera eye { pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
material lit { emission 0.2 0.5 0.8 }
material glass { transmission 1 }
rectangle board { material lit center 0 0 -2 right 6 0 0 up 0 6 0 }
"""
PLAIN = BOARD.split("\n", 2)[2]
SMALL = rj.RenderSettings(size=(4, 3))


@pytest.fixture(scope="module")
def board():
    return rj.parse_scene(BOARD)


def test_unset_settings_come_from_the_file(board):
    seen = np.asarray(rj.render(board, SMALL).image)
    assert seen.shape == (3, 3, 4)
    np.testing.assert_allclose(seen, np.broadcast_to(np.reshape([0.2, 0.5, 0.8], (3, 1, 1)), seen.shape))
    np.testing.assert_array_equal(rj.render(board, SMALL).image, seen)
    np.testing.assert_array_equal(rj.picture_derivatives(board, ["lit.emission.r"], SMALL).image, seen)


def test_every_setting_can_be_overridden(board):
    of_file = {field.name for field in dataclasses.fields(FileSettings)} - {"name"}
    assert of_file <= {field.name for field in dataclasses.fields(rj.RenderSettings)}
    assert all(getattr(rj.RenderSettings(), name) is None for name in of_file)
    assert resolve_settings(board) == ResolvedSettings(model="physical", max_bounces=1, edges="point")
    more = rj.RenderSettings(
        max_bounces=3, edges="aware", samples=2, mapping="corner", path_limit=9.0, least_weight=0.1
    )
    wanted = ResolvedSettings(
        model="physical", max_bounces=3, edges="aware", samples=2, mapping="corner", path_limit=9.0, least_weight=0.1
    )
    assert resolve_settings(board, more) == wanted
    assert resolve_settings(board, wanted) is wanted
    a_row = rj.RenderSettings(size=[32, 24], crop=np.array([0, 1, 2, 3]), aov=["depth"])
    assert a_row == rj.RenderSettings(size=(32, 24), crop=(0, 1, 2, 3), aov=("depth",))


def test_a_scene_is_rendered_as_its_model(tmp_path):
    path = tmp_path / "plain.txt"
    path.write_text(PLAIN)
    loaded = rj.load_scene(path, model="physical")
    made = rj.make_scene(
        rj.build.camera("eye", pixeldim=(8, 6), viewpoint=(0, 0, 5), lookat=(0, 0, 0), fov=40),
        rj.build.material("lit", emission=(0.2, 0.5, 0.8)),
        rj.build.material("glass", transmission=1),
        rj.build.rectangle("board", material="lit", center=(0, 0, -2), right=(6, 0, 0), up=(0, 6, 0)),
        model="physical",
    )
    for scene in (loaded, made):
        assert scene.model == "physical" and resolve_settings(scene, SMALL).model == "physical"
        assert "ior 1.5" in rj.format_scene(scene)
    assert resolve_settings(rj.load_scene(path)).model == "classic"


@pytest.mark.parametrize(
    ("given", "words"),
    [
        (
            {"model": "fysical"},
            "model is 'fysical'; wanted one of classic, additive, physical. Did you mean 'physical'?",
        ),
        ({"size": 32}, "size is 32; wanted (width, height), each 1 to 32768 pixels."),
        ({"crop": (1, 2, 3)}, "crop is (1, 2, 3); wanted (x, y, width, height)"),
        ({"samples": 1.5}, "samples is 1.5; wanted a whole number from 1 to 64."),
        ({"aov": "depth"}, "aov is 'depth'; wanted names among depth, normal"),
        ({"mapping": "middle"}, "wanted one of corner, center."),
        ({"max_bounces": -1}, "from 0 to 64"),
        (
            {"aov": ("depht",)},
            "aov is ('depht',); wanted names among depth, normal, position, shape_index, bounce_count. Did",
        ),
        (
            {"model": "physical", "reflectance": "none"},
            "reflectance is 'none', which has a meaning only in the classic model.",
        ),
    ],
)
def test_impossible_settings_are_an_error(given, words):
    with pytest.raises(rj.SettingsError) as caught:
        rj.RenderSettings(**given)
    assert isinstance(caught.value, rj.RaytraceError) and isinstance(caught.value, ValueError)
    assert words in str(caught.value)
