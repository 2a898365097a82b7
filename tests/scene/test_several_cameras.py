"""A scene with several cameras: which one is rendered, whose numbers are whose, and files, commands and errors."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from command_line import run
from scenes import assert_same_scene

from raytrace_jax import (
    ModelFileError,
    ParameterError,
    RenderSettings,
    SceneError,
    format_scene,
    list_parameters,
    load_scene,
    parse_scene,
    picture_derivatives,
    read_picture,
    render,
    set_parameters,
)
from raytrace_jax.scene.bundled import bundled_scenes

SMALL = RenderSettings(size=(24, 18), max_bounces=2)
TEXT = bundled_scenes()["two_views"].read_text()
FILMED = f"{TEXT} film right {{ gain 1 1 2 }}"


@pytest.fixture(scope="module")
def scene():
    return parse_scene(FILMED)


def test_the_first_camera_is_rendered_unless_another_is_asked_for(scene):
    assert scene.cameras == ("left", "right")
    other = scene.seen_by("right")
    assert other.camera.name == "right" and other.cameras == ("right", "left") and scene.seen_by("left") is scene
    left, right = (np.asarray(render(each, SMALL).image) for each in (scene, other))
    assert np.abs(left - right).max() > 0.1
    # A further view is no part of what is rendered; the film is its camera's.
    alone = np.asarray(render(other.alone(), SMALL).image)
    np.testing.assert_array_equal(right, alone)
    plain = np.asarray(render(parse_scene(TEXT).seen_by("right"), SMALL).image)
    np.testing.assert_allclose(right, plain * np.array([1, 1, 2])[:, None, None], rtol=1e-6)


def test_numbers_belong_to_their_camera(scene):
    assert {"left.fov", "right.fov", "right.gain"} <= set(list_parameters(scene))
    moved = set_parameters(scene, {"right.fov": 30.0, "right.gain.b": 3.0})
    assert float(moved["right.fov"]) == 30 and float(moved["left.fov"]) == 40
    np.testing.assert_array_equal(render(moved, SMALL).image, render(scene, SMALL).image)
    assert np.abs(np.asarray(render(moved.seen_by("right"), SMALL).image - render(scene, SMALL).image)).max() > 0.1


def test_derivatives_by_another_camera_s_numbers_are_zero(scene):
    left, *right = picture_derivatives(scene, ["left.fov", "right.fov", "right.gain.b"], SMALL).values
    assert np.abs(left).max() > 0 and not np.any(right)


def test_a_number_of_any_camera_moves_under_jit(scene):
    @jax.jit
    def mean(fov):
        return jnp.mean(render(set_parameters(scene, {"right.fov": fov}).seen_by("right"), SMALL).image)

    assert float(mean(30.0)) != float(mean(40.0))
    assert float(mean(40.0)) == pytest.approx(float(jnp.mean(render(scene.seen_by("right"), SMALL).image)), rel=1e-6)


def test_files_and_plain_values_keep_all_cameras(scene, tmp_path):
    assert_same_scene(parse_scene(format_scene(scene)), scene)
    scene.seen_by("right").save(tmp_path / "right.txt")
    assert load_scene(tmp_path / "right.txt").cameras == ("right", "left"), "the first of a file is rendered"
    assert_same_scene(type(scene).from_dict(scene.to_dict()), scene)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (TEXT.replace("camera right", "camera left"), "camera 'left' is a second camera of that name"),
        (f"{TEXT} film other {{ gain 1 1 2 }}", "film 'other' belongs to no camera: .* as film left"),
    ],
)
def test_what_no_scene_can_be_is_refused(text, words):
    with pytest.raises(ModelFileError, match=words):
        parse_scene(text)


def test_unknown_cameras_and_numbers_are_named(scene):
    with pytest.raises(SceneError, match=r"no camera 'rigth'\. Did you mean 'right'\? .*: left, right"):
        scene.seen_by("rigth")
    with pytest.raises(ParameterError, match=r"one is written block\.attribute, as left\.viewpoint"):
        scene["center.fov"]
    with pytest.raises(ParameterError, match=r"right\.fov.*less than 180 degrees"):
        set_parameters(scene, {"right.fov": 300.0})


def test_render_makes_a_picture_of_each_camera(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    small = ["--size", 24, 18, "--max-bounces", 2, "--edges", "point"]
    assert run("render", "two_views", "-o", "a.exr", *small) == 0
    assert "cameras left, right" in capsys.readouterr().err
    assert {path.name for path in tmp_path.iterdir()} == {
        f"a_{name}.{end}" for name in ("left", "right") for end in ("exr", "png")
    }
    assert run("render", "two_views", "--camera", "right", "-o", "b.exr", *small) == 0
    np.testing.assert_array_equal(read_picture("b.exr"), read_picture("a_right.exr"))
    assert run("render", "two_views", "--camera", "middle", "-o", "c.exr", *small) == 2
    assert "no camera 'middle'" in capsys.readouterr().err
    assert run("rays", "two_views", "--pixel", 12, 9, "-o", "rays.png", *small[:5]) == 0
    assert "cameras left, right: the picture is that of left; --camera NAME" in capsys.readouterr().err
