"""What a user finds on the objects themselves: a scene, a film and a result that save, show and answer by name."""

import dataclasses
import io
import json
from pathlib import Path

import jax
import numpy as np
import pytest
from command_line import run
from fake_fit import fake_result, full_result, two_views
from PIL import Image
from scenes import assert_same_scene, assignment_scene

import raytrace_jax as rj
from raytrace_jax.scene.bundled import bundled_scenes, scene_path

SMALL = rj.RenderSettings(size=(24, 18), max_bounces=2)
TEMPLATES = ["ball", "box", "prism", "tank", "tube"]
OTHERS = ["bench", "bubble", "checkpoints", "glass_on_board", "pov_ball", "two_balls", "two_views", "vitreous"]
NAMES = sorted(TEMPLATES + OTHERS)


@pytest.mark.parametrize("name", TEMPLATES)
def test_a_template_is_written_once(name, tmp_path, capsys):
    place = tmp_path / "new" / "scene.txt"
    assert run("new", name, "-o", place) == 0 and capsys.readouterr().out == f"{place}\n"
    text = place.read_text()
    assert rj.format_scene(rj.load_scene(place), comments=text) == text
    assert run("new", name, "-o", place) == 1 and "is not overwritten" in capsys.readouterr().err


@pytest.mark.parametrize("name", NAMES)
def test_plain_values_give_the_same_scene(name):
    path = bundled_scenes()[name]
    scene = rj.load_scene(path)
    values = json.loads(json.dumps(scene.to_dict()))
    assert_same_scene(rj.Scene.from_dict(values, folder=path.parent), scene)
    assert rj.format_scene(rj.Scene.from_dict(values, folder=path.parent)) == rj.format_scene(scene)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, '"blocks"'),
        ({"blocks": [], "light": 1}, "not light"),
        ({"blocks": [{"block": "spere", "name": "a"}]}, "sphere"),
        ({"blocks": [{"block": "sphere"}]}, "name for this sphere, got 'None'"),
        ({"blocks": [{"block": "sphere", "name": "a", "raduis": 1}]}, "radius"),
    ],
)
def test_bad_plain_values_are_refused(values, words):
    with pytest.raises(rj.SceneError, match=words):
        rj.Scene.from_dict(values)


def test_a_scene_saves_and_answers_by_name(tmp_path, monkeypatch):
    scene = assignment_scene()
    monkeypatch.chdir(tmp_path)
    scene.save("bubble")
    assert scene_path("bubble") == Path("bubble"), "a file comes before a bundled scene of its name"
    assert_same_scene(rj.load_scene("bubble"), scene)
    scene.save(tmp_path / "new" / "a.txt")
    assert_same_scene(rj.load_scene("new/a.txt"), scene)
    assert float(scene["vitreous.ior"]) == float(scene["cyan.ior"])
    with pytest.raises(rj.ParameterError, match="Did you mean 'ior'"):
        scene["vitreous.iro"]


def test_a_scene_is_shown_in_a_line():
    line = "Scene(physical, camera=640x480, checkers=1, images=1, materials=3, spheres=2, rectangles=1)"
    assert repr(rj.load_scene("two_balls")) == line
    seen = []
    jax.make_jaxpr(lambda scene: seen.append(repr(scene)) or scene["vitreous.ior"])(assignment_scene())
    assert seen == [repr(assignment_scene())]
    assert "classic" in repr(jax.tree.map(lambda leaf: None, assignment_scene()))


def test_a_film_saves_and_shows_itself(tmp_path):
    film = rj.render(assignment_scene(), rj.RenderSettings(size=(24, 18), max_bounces=2, aov=("depth",)))
    film.save(tmp_path / "a.exr")
    np.testing.assert_array_equal(rj.read_picture(tmp_path / "a.exr"), np.asarray(film.image, np.float32))
    assert set(rj.read_exr(tmp_path / "a.exr").channels) == {"R", "G", "B", "depth.Z"}
    film.save(tmp_path / "a.png")
    shown = np.asarray(film.show())
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "a.png").convert("RGB")), shown)
    np.testing.assert_array_equal(np.asarray(Image.open(io.BytesIO(film._repr_png_()))), shown)
    with pytest.raises(rj.PictureError, match=r"\.exr, \.png or \.ppm"):
        film.save(tmp_path / "a.jpg")


def test_pictures_are_written_from_arrays(tmp_path):
    image = np.asarray(rj.render(assignment_scene(), SMALL).image, np.float32)
    rj.write_exr(tmp_path / "a.exr", image)
    np.testing.assert_array_equal(rj.read_picture(tmp_path / "a.exr"), image)
    rj.write_png(tmp_path / "a.png", image)
    rj.write_png(tmp_path / "b.png", dict(zip("RGB", image, strict=True)))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(rj.PictureError, match="R, G and B are wanted, not R, G"):
        rj.write_png(tmp_path / "c.png", {"R": image[0], "G": image[1]})
    with pytest.raises(rj.PictureError, match=r"\(18, 24\)"):
        rj.write_exr(tmp_path / "c.exr", image[0])


def test_a_result_answers_by_name(tmp_path):
    result = fake_result()
    name = result.names[0]
    estimate = result[name]
    assert (estimate.value, estimate.error) == (result.value[0], result.total_error[0])
    low, high = estimate.interval
    assert low < estimate.value < high and high - low == pytest.approx(3.92 * estimate.error, rel=1e-3)
    assert name in result.summary() and result.summary().splitlines()[-1].startswith(result.status)
    assert repr(result).startswith(f"<FitResult {result.status}: {name} ") and len(repr(result)) < 500
    assert "<table>" in result._repr_html_()
    result.save(tmp_path / "out")
    assert (tmp_path / "out" / "result.json").is_file() and (tmp_path / "out" / "report.html").is_file()
    with pytest.raises(rj.ParameterError, match=name):
        result[name + "x"]


@pytest.mark.parametrize("make", [fake_result, full_result, two_views])
def test_a_saved_result_comes_back_exactly(make, tmp_path):
    result = make()
    result.save(tmp_path)
    again = rj.FitResult.load(tmp_path)
    # Texts of dataclasses have all their numbers; of large arrays only some, so these are compared on their own.
    arrays = [
        (getattr(part, field.name), getattr(other, field.name))
        for part, other in ((result.uncertainty, again.uncertainty), (result.check, again.check))
        for field in dataclasses.fields(part)
    ]
    arrays += [(getattr(result, name), getattr(again, name)) for name in ("target", "weights", "start_image", "image")]
    for field in dataclasses.fields(result):
        if field.name not in ("scene", "uncertainty", "check", "target", "weights", "start_image", "image"):
            assert repr(getattr(again, field.name)) == repr(getattr(result, field.name)), field.name
    for one, other in arrays:
        np.testing.assert_equal(other, one)
        assert type(other) is type(one) and getattr(other, "dtype", None) == getattr(one, "dtype", None)
    assert again.settings == result.settings and again.summary() == result.summary()
    assert_same_scene(again.scene, result.scene)


@pytest.mark.parametrize("damage", ["absent", "garbage", "version", "field"])
def test_what_is_no_saved_result_is_told(damage, tmp_path):
    fake_result().save(tmp_path)
    path = tmp_path / "result.npz"
    fields = str(np.load(path)["fields"])
    arrays = {key: array for key, array in np.load(path).items() if key != "fields"}
    path.unlink()
    if damage == "garbage":
        path.write_bytes(b"nonsense")
    elif damage != "absent":
        change = {"version": ('"version": "', '"version": "0.'), "field": ('"status"', '"state"')}[damage]
        np.savez(path, **arrays, fields=np.array(fields.replace(*change)))
    message = {"absent": "there is no such file", "version": "was written by version"}.get(damage, "is broken")
    with pytest.raises(rj.RaytraceError, match=f"result.npz: {message}"):
        rj.FitResult.load(tmp_path)


def test_a_saved_scene_takes_its_pictures(tmp_path):
    scene = rj.load_scene("glass_on_board")
    scene.save(tmp_path / "a" / "scene.txt")
    again = rj.load_scene(tmp_path / "a" / "scene.txt")
    assert sorted(path.name for path in (tmp_path / "a").iterdir()) == ["scene.evening.exr", "scene.txt"]
    np.testing.assert_array_equal(again.images.texels[0], scene.images.texels[0])
    written = (tmp_path / "a" / "scene.txt").read_bytes()
    again.save(tmp_path / "a" / "scene.txt")
    assert (tmp_path / "a" / "scene.txt").read_bytes() == written, "what lies there is not written once more"
    again.save(tmp_path / "a" / "other.txt")
    assert not (tmp_path / "a" / "other.evening.exr").exists()


@pytest.mark.fast_cases(2)
@pytest.mark.parametrize(
    ("arguments", "keys"),
    [
        (["info", "vitreous"], {"blocks", "parameters", "materials"}),
        (
            ["rays", "vitreous", "--pixel", "300", "150", "-o", "a.svg", "--max-bounces", "1"],
            {"output", "pixel", "rays"},
        ),
        (["grad", "vitreous", "--wrt", "cyan.ior", "-o", "a.exr", "--size", "8", "6", "--max-bounces", "1"], {"png"}),
    ],
)
def test_commands_print_json(arguments, keys, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run(*arguments, "--json") == 0
    told = json.loads(capsys.readouterr().out)
    assert keys <= set(told)
    if "rays" in told:
        assert told["rays"][0]["number"] == 0 and len(told["rays"][0]["color"]) == 3
    if "materials" in told:
        assert told["parameters"]["vitreous.center"] == [4.3, 2.3, -1.0] and told["materials"]["cyan"] == ["vitreous"]


def test_the_bundled_scenes_are_listed(capsys):
    assert list(bundled_scenes()) == NAMES
    assert_same_scene(rj.load_scene("vitreous"), rj.load_scene(bundled_scenes()["vitreous"]))
    assert run("scenes") == 0
    out = capsys.readouterr().out
    assert all(name in out for name in NAMES) and "A bubble of air" in out
    assert run("render", "two_bals", "-o", "a.exr") == 1
    assert "two_balls" in capsys.readouterr().err


def test_there_is_one_title_to_cite():
    root = Path(__file__).parents[2]
    readme = " ".join((root / "README.md").read_text(encoding="utf-8").split())
    report = (root / "raytrace_jax/report/fit_report/page.html.jinja").read_text(encoding="utf-8")
    for words in ("raytrace_jax: a differentiable Whitted ray tracer in JAX", "The raytrace_jax developers"):
        assert words in readme and words in report
    assert "The raytrace_jax developers" in (root / "LICENSE").read_text(encoding="utf-8")
    assert f"## {rj.__version__} (unreleased)" in (root / "CHANGELOG.md").read_text(encoding="utf-8")
