"""The block of a slab: what a file may say, who refuses it, and what is written of it."""

import numpy as np
import pytest
from command_line import run

import raytrace_jax as rj
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.indistinct import indistinct_glass

HEAD = "camera eye { pixeldim 8 6 viewpoint 0 0 5 lookat 0 0 0 } background sky { radiance 1 1 1 } "
WATER = "material water { transmission 1 ior 1.333 } "
TANK = "slab tank { material water point 0 0 1 normal 0 0 2 thickness 2 wall 0.1 wall_ior 1.49 }"


def parsed(text=TANK, model: ModelName = "physical"):
    return rj.parse_scene(HEAD + WATER + text, model=model, dtype=np.float64)


@pytest.mark.parametrize(
    ("said", "instead", "words"),
    [
        ("wall 0.1", "wall 1", "in slab 'tank', two walls of 1 must be less than the thickness, 2"),
        ("wall 0.1", "wall -1", "wall must be 0 or greater"),
        ("thickness 2", "thickness 0", "thickness must be greater than 0"),
        ("thickness 2", "", "slab 'tank' lacks thickness"),
        ("wall_ior 1.49", "wall_ior 0", "wall_ior must be greater than 0"),
        ("normal 0 0 2", "normal 0 0 0", "normal must be a vector other than 0 0 0"),
    ],
)
def test_bad_slabs_are_refused(said, instead, words):
    with pytest.raises(rj.ModelFileError, match=words):
        parsed(TANK.replace(said, instead))


def test_walls_stay_thinner_than_their_slab():
    with pytest.raises(rj.ParameterError, match=r"'tank.thickness': two walls of 0.1 must be less"):
        rj.set_parameters(parsed(), {"tank.thickness": 0.2})
    assert float(rj.set_parameters(parsed(), {"tank.thickness": 1, "tank.wall": 0.4})["tank.ior"]) == 1.333


@pytest.mark.parametrize("model", ["classic", "additive"])
def test_other_models_refuse_slabs(model):
    with pytest.raises(rj.SceneError, match=f"slab 'tank': the {model} model knows of no slabs"):
        rj.render(parsed(model=model))


def test_a_slab_is_written_as_it_was_read():
    text = rj.format_scene(parsed())
    assert rj.format_scene(rj.parse_scene(text, model="physical", dtype=np.float64)) == text
    assert "wall 0.1\n" in text and "wall" not in rj.format_scene(parsed(TANK.replace("wall 0.1 wall_ior 1.49", "")))


@pytest.mark.parametrize(("wall", "count"), [("0.1", 0), ("0", 0), ("1e-7", 2)])
def test_a_wall_too_thin_is_warned_of(wall, count):
    found = indistinct_glass(parsed(TANK.replace("wall 0.1", f"wall {wall}")))
    assert len(found) == count and all("the surfaces of tank " in sentence for sentence in found)


@pytest.mark.parametrize("to", ["pov", "mitsuba"])
def test_an_export_has_the_planes_of_a_slab(to, tmp_path):
    rj.export_scene(parsed(), tmp_path / "a", to)
    text = (tmp_path / "a").read_text()
    assert all(f"tank {part}" in text for part in ("air", "back", "inside", "front"))


def test_rays_name_the_planes_of_a_slab(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    text = rj.format_scene(parsed())
    (tmp_path / "a.txt").write_text("settings s { model physical } " + text)
    assert run("rays", "a.txt", "--pixel", "3", "2", "-o", "a.svg", "--max-bounces", "2") == 0
    told = capsys.readouterr().out
    assert "tank front" in told and "tank inside" in told and (tmp_path / "a.svg").is_file()
