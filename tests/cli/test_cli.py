"""The command line: what it writes, what it prints, its exit codes, and that bad input never shows a traceback."""

import dataclasses
import json
from typing import get_args

import numpy as np
import pytest
from command_line import run
from fake_fit import VITREOUS, fake_result
from PIL import Image

import raytrace_jax
from raytrace_jax import (
    FitOptions,
    RenderSettings,
    format_scene,
    load_scene,
    picture_derivatives,
    read_exr,
    render,
    set_parameters,
    write_png,
)
from raytrace_jax.cli.options import RenderOptions
from raytrace_jax.images.transfer import encode_srgb
from raytrace_jax.inverse.result import Status
from raytrace_jax.report.differences import finite_differences
from raytrace_jax.tracer.rendering import PictureDerivatives
from raytrace_jax.tracer.settings import AOVS, AovName, ResolvedSettings, resolve_settings

SMALL = ["--size", "40", "30", "--max-bounces", "2"]
SMALL_SETTINGS = ResolvedSettings(size=(40, 30), max_bounces=2, edges="point")
SHARED = """camera eye { pixeldim 4 3 worlddim 8 6 viewpoint 4 3 6 } material glass { alpha 0.5 ior 1.5 }
sphere left { material glass center 0 0 -3 radius 1 } sphere right { material glass center 3 0 -3 radius 1 }"""


@pytest.fixture
def shared(tmp_path):
    (tmp_path / "shared.txt").write_text(SHARED)
    return tmp_path / "shared.txt"


def test_render_writes_the_librarys_picture(tmp_path, capsys):
    out = tmp_path / "new" / "a.exr"
    aovs = tuple(AOVS)
    code = run("render", VITREOUS, "-o", out, *SMALL, "-D", "vitreous.center=4.2,2.3,-1", "--aov", *aovs)
    captured = capsys.readouterr()
    assert code == 0
    assert captured.out.split() == [str(out), str(out.with_suffix(".png"))]
    assert "40 x 30" in captured.err

    settings = dataclasses.replace(SMALL_SETTINGS, aov=aovs)
    scene = set_parameters(load_scene(VITREOUS), {"vitreous.center": (4.2, 2.3, -1)})
    film = render(scene, settings)
    picture = read_exr(out)
    assert set(picture.channels) == {"R", "G", "B"}.union(*(row.channels for row in AOVS.values()))
    for name, expected in zip("RGB", np.asarray(film.image), strict=True):
        np.testing.assert_array_equal(picture.channels[name], expected.astype(np.float32))
    np.testing.assert_array_equal(picture.channels["normal.Z"], np.asarray(film.aov["normal"][2], np.float32))
    np.testing.assert_array_equal(picture.channels["shape_index.I"], np.asarray(film.aov["shape_index"]))
    assert picture.metadata["scene"] == format_scene(scene)
    assert picture.metadata["settings"] == json.loads(json.dumps(dataclasses.asdict(settings)))
    assert picture.metadata["version"] == raytrace_jax.__version__
    with Image.open(out.with_suffix(".png")) as png:
        np.testing.assert_array_equal(np.moveaxis(np.asarray(png), -1, 0), np.floor(255 * np.asarray(film.image)))


def test_derivatives_name_a_bad_pixel(tmp_path, capsys, replace_work):
    broken = np.ones((1, 3, 12, 16))
    broken[..., 2, 3] = np.nan
    found = PictureDerivatives(np.full((3, 12, 16), 0.5), ("vitreous.ior",), broken, ("",))
    replace_work("pictures.picture_derivatives", lambda *_: found)
    assert run("grad", VITREOUS, "--wrt", "vitreous.ior", "-o", tmp_path / "a.exr", *SMALL, "--quiet") == 1
    assert "1 pixel is NaN or infinite: row 2, column 3, in the picture or a derivative." in capsys.readouterr().err
    channels = read_exr(tmp_path / "a.exr").channels
    assert channels["d.vitreous.ior.R"][2, 3] == 0 and channels["d.vitreous.ior.R"].sum() == 12 * 16 - 1


def test_render_writes_one_file_if_asked(tmp_path, capsys):
    image = np.asarray(render(load_scene(VITREOUS), SMALL_SETTINGS).image)
    assert run("render", VITREOUS, "-o", tmp_path / "a.png", *SMALL, "--png-transfer", "srgb", "--quiet") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.png"] and capsys.readouterr().err == ""
    with Image.open(tmp_path / "a.png") as png:
        np.testing.assert_array_equal(np.moveaxis(np.asarray(png), -1, 0), encode_srgb(image))
    (tmp_path / "a.png").unlink()
    assert run("render", VITREOUS, "-o", tmp_path / "a.exr", *SMALL, "--half", "--no-png") == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.exr"]
    np.testing.assert_array_equal(read_exr(tmp_path / "a.exr").channels["R"], image[0].astype(np.float16))


def test_render_options_reach_the_settings(replace_work, tmp_path):
    """No option is parsed and then forgotten: each has a value other than its default."""
    seen = []

    def record(scene, settings):
        seen.append((scene, settings))
        raise MemoryError  # There is no need for a picture.

    replace_work("scenes.render", record)
    options = "--reflectance none --eta physical --max-bounces 3 --samples 2 --mapping center --size 40 30"
    options += " --crop 1 2 3 4 --no-total-internal-reflection --no-second-root --no-reflection --precision 32"
    options += " --edges aware --binning 2 --path-limit 50"
    run("render", VITREOUS, "-o", tmp_path / "a.exr", *options.split(), "--aov", "depth", "--aov", "normal", "depth")
    [(scene, settings)] = seen
    given = {"size": (40, 30), "crop": (1, 2, 3, 4), "samples": 2, "mapping": "center", "reflectance": "none"}
    given |= {"eta": "physical", "max_bounces": 3, "path_limit": 50.0, "edges": "aware", "binning": 2}
    given |= dict.fromkeys(["total_internal_reflection", "second_root", "reflection"], False)
    expected = ResolvedSettings(**given, aov=("depth", "normal"))
    assert settings == expected
    default = ResolvedSettings()
    # Two of them are other models': they come on their own. Two are for transformations of JAX.
    others = ("model", "least_weight", "rays_per_pixel", "throw")
    names = [field.name for field in dataclasses.fields(expected) if field.name not in others]
    assert all(getattr(expected, name) != getattr(default, name) for name in names)
    assert scene.camera.viewpoint.dtype == np.float32
    run("render", VITREOUS, "-o", tmp_path / "a.exr", "--model", "additive")
    run("render", VITREOUS, "-o", tmp_path / "a.exr", "--model", "physical", "--least-weight", "1e-3")
    assert seen[1][1] == ResolvedSettings(model="additive")
    assert seen[2][1] == ResolvedSettings(model="physical", least_weight=1e-3)
    # Its defaults are the library's.
    given = RenderOptions()
    assert {n: getattr(given, n) for n in vars(RenderSettings())} == vars(RenderSettings())
    assert resolve_settings(load_scene(VITREOUS), given) == default and get_args(AovName) == tuple(AOVS)


@pytest.mark.parametrize("form", [["-D", "{}"], ["-D{}"], ["--define", "{}"]])
def test_assignments_in_every_form(form, capsys):
    """What `format` printed is the scene with two of its parameters changed."""
    scene = set_parameters(load_scene(VITREOUS), {"vitreous.center": (-4, 2.5, -1), "cyan.alpha": 0.25})
    for further in ("-Dcyan.alpha=0.25", "cyan.alpha=0.25"):
        assert run("format", VITREOUS, *(part.format("vitreous.center=-4,2.5,-1") for part in form), further) == 0
        expected = format_scene(scene, comments=VITREOUS.read_text(encoding="utf-8"))
        assert capsys.readouterr() == (expected, "")


def test_shared_materials_are_told(shared, capsys):
    assert run("format", shared, "-D", "left.ior=1.3") == 0
    captured = capsys.readouterr()
    assert captured.err.startswith("warning: left.ior") and "right" in captured.err
    assert "ior 1.3" in captured.out
    assert run("format", shared, "-D", "glass.ior=1.3") == 0
    assert capsys.readouterr().err == ""
    shared.write_text(SHARED.replace("worlddim", "worldim"))
    assert run("format", shared) == 0
    captured = capsys.readouterr()
    assert captured.err.startswith(f"warning: {shared}:1:") and captured.err.count("\n") == 1
    assert "worlddim 8 6" in captured.out


def test_info_lists_values_and_materials(shared, capsys):
    shared.write_text(SHARED.replace("radius 1", "radius 1.2345678901234567", 1))
    assert run("info", shared) == 0
    out = capsys.readouterr().out
    assert out.isascii()
    lines = [line.split() for line in out.splitlines()]
    assert ["left.radius", "1.2345678901234567"] in lines
    assert ["right.center", "3,0,-3"] in lines
    assert ["glass", "left", "right"] in lines
    assert ["camera", "eye", "pixeldim", "4", "3"] in lines


@pytest.mark.slow
def test_grad_writes_layers_sheet_and_check(tmp_path, capsys):
    out = tmp_path / "new" / "g.exr"
    options = ["--size", 24, 18, "--max-bounces", 2, "--edges", "point", "-D", "vitreous.ior=1.4"]
    arguments = ["grad", VITREOUS, "--wrt", "vitreous.ior", "--wrt", "vitreous.center", "-o", out, *options]
    assert run(*arguments, "--check", "--check-samples", 2) == 0
    captured = capsys.readouterr()
    lines = captured.out.splitlines()
    assert lines[:2] == [str(out), str(out.with_suffix(".png"))]
    names = ["vitreous.ior", *(f"vitreous.center.{letter}" for letter in "xyz")]
    assert [line.split()[0] for line in lines[4:8]] == names
    assert [line.split(": ")[0] for line in lines[8:]] == names
    assert all(line.split(": ")[1].startswith(("agree", "disagree", "undecided")) for line in lines[8:])
    assert sum("derivative" in line for line in captured.err.splitlines()) == 1, "they come together"

    scene = set_parameters(load_scene(VITREOUS), {"vitreous.ior": 1.4})
    settings = ResolvedSettings(size=(24, 18), max_bounces=2, edges="point")
    found = picture_derivatives(scene, names, settings)
    picture = read_exr(out)
    layers = [f"{what}.{name}" for what in ("d", "difference") for name in names]
    assert set(picture.channels) == {*"RGB"} | {f"{layer}.{letter}" for layer in layers for letter in "RGB"}
    how = picture.metadata["differences"]
    assert how["samples"] == 2 and list(how["steps"]) == names
    step = how["steps"]["vitreous.center.x"]
    (expected,) = finite_differences(scene, ["vitreous.center.x"], settings, step, 2)
    stored = np.stack([picture.channels[f"difference.vitreous.center.x.{letter}"] for letter in "RGB"])
    np.testing.assert_array_equal(stored, expected.astype(np.float32))
    for name, derivative in zip(names, found.values, strict=True):
        stored = np.stack([picture.channels[f"d.{name}.{letter}"] for letter in "RGB"])
        np.testing.assert_array_equal(stored, derivative.astype(np.float32))
        assert stored.min() < 0 < stored.max()
    np.testing.assert_array_equal(picture.channels["G"], found.image[1].astype(np.float32))
    assert picture.metadata["scene"] == format_scene(scene)
    assert picture.metadata["settings"] == json.loads(json.dumps(dataclasses.asdict(settings)))
    with Image.open(out.with_suffix(".png")) as sheet:
        assert sheet.width == 3000 > 2 * sheet.height > 2000, "five panels in two rows of three"

    assert run(*arguments, "--quiet") == 0
    captured = capsys.readouterr()
    assert (captured.out.splitlines(), captured.err) == (lines[:2], "")


@pytest.mark.parametrize("status", get_args(Status))
def test_fit_reports_and_exits_by_its_status(status, tmp_path, replace_work, capsys):
    expected = fake_result(status=status)
    seen = {}

    def fit(scene, target, free, settings, *, options, weights, storage, on_step, on_phase):
        assert storage == {"cam1": None}, "a PNG is not compressed"
        of_view = {"weights": weights, "target": target, "settings": settings}
        seen.update(options=options, scene=scene, free=free, **{name: each["cam1"] for name, each in of_view.items()})
        on_phase("scanning: compiling")
        for step in expected.steps:
            on_step(step)
        return expected

    replace_work("fit.fit", fit)
    write_png(tmp_path / "target.png", expected.target)
    write_png(tmp_path / "mask.png", np.ones_like(expected.target))
    options = ["--size", 40, 30, "--blur", 2, 0, "--max-steps", 7, "--max-seconds", 9.5, "--eta", "physical"]
    options += ["--tie", "central.radius=vitreous.radius", "--prior", "vitreous.radius=2.3+-0.01", "--sigma", 0.01]
    options += ["--uncertain", "cam1=0.1%", "--uncertain", "central.radius=0.02"]
    options += ["--mask", tmp_path / "mask.png", "--loss", "cauchy", "--profile", "vitreous.ior", "--no-search"]
    arguments = ["fit", VITREOUS, tmp_path / "target.png", "--free", "vitreous.ior", "--free", "vitreous.radius"]
    code = run(*arguments, "-o", tmp_path / "out", *options, "-D", "vitreous.ior=1.5", "--transfer", "srgb")
    assert code == (0 if status == "converged" else 3)
    assert seen["settings"] == ResolvedSettings(size=(40, 30), eta="physical")
    assert seen["scene"].materials.ior[3] == 1.5
    np.testing.assert_allclose(encode_srgb(seen["target"]), np.floor(255 * expected.target))
    np.testing.assert_allclose(seen["weights"], 1)
    assert seen["free"] == ("vitreous.ior", "vitreous.radius")
    assert seen["options"] == FitOptions(
        ties={"central.radius": "vitreous.radius"},
        priors={"vitreous.radius": (2.3, 0.01)},
        uncertain={"cam1": "0.1%", "central.radius": "0.02"},
        profiles=("vitreous.ior",),
        search=False,
        sigma=0.01,
        loss="cauchy",
        blur=(2, 0),
        max_steps=7,
        max_seconds=9.5,
    )

    captured = capsys.readouterr()
    lines = [line.split() for line in captured.out.splitlines()]
    assert ["vitreous.ior", "1.5", "1.33700(23)"] in lines
    assert ["vitreous.radius", "2", "2.3,", "not", "determined"] in lines
    assert f"{status}: {expected.message} {expected.advice}" in captured.out
    assert lines[-1] == [str(tmp_path / "out")]
    lines = captured.err.splitlines()
    if status != "interrupted":  # Which has only its numbers written.
        assert lines.pop().startswith("writing the report took ")
    phases = [line.split(" s  ")[1] for line in lines]
    assert phases[0] == "scanning: compiling"
    assert len(phases) == 1 + len(expected.steps)
    assert phases[-1].startswith("start 1  blur 0 px  step 1 (rejected)  cost 0.6  vitreous.ior 1.337")
    assert json.loads((tmp_path / "out" / "result.json").read_text())["status"] == status
