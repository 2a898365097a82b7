"""The galleries of the source documents: each picture is the tracer's own under its switches."""

import numpy as np
import pytest
from command_line import run
from PIL import Image
from scenes import DATA

from raytrace_jax import load_scene, read_exr, read_picture, render
from raytrace_jax.report.gallery import GALLERIES, render_gallery
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

SIZE = (24, 18)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["assignment", "checkpoints"])
def test_every_picture_differs_from_the_whole_model(name):
    gallery = GALLERIES[name]
    scene = load_scene(gallery.scene, model=gallery.model)
    settings = ResolvedSettings(size=SIZE, model=gallery.model, max_bounces=2)
    pictures = {
        variant.name: found.image for variant, _, _, found in render_gallery(lambda _: scene, gallery, settings)
    }
    assert len(pictures) == 6 and len({picture.tobytes() for picture in pictures.values()}) >= 4
    np.testing.assert_array_equal(pictures[gallery.variants[-1].name], render(scene, settings).image)


@pytest.mark.slow
def test_the_command_writes_each_picture_with_its_derivatives_and_a_sheet(tmp_path, capsys):
    assert (
        run("gallery", DATA / "vitreous.txt", "-o", tmp_path, "--size", 16, 12, "--max-bounces", 1, "--wrt", "cyan.ior")
        == 0
    )
    captured = capsys.readouterr()
    written = captured.out.split()
    assert len(written) == 13 and written[-1].endswith("gallery.png")
    assert captured.err.count("took") == 6
    final = read_exr(tmp_path / "6_final_schlick.exr")
    assert {"R", "d.cyan.ior.G"} <= set(final.channels) and np.abs(final.channels["d.cyan.ior.G"]).max() > 0
    picture = read_picture(tmp_path / "6_final_schlick.png", transfer="course")
    np.testing.assert_allclose(picture[0], final.channels["R"], atol=1 / 255)
    with Image.open(tmp_path / "gallery.png") as sheet:
        assert sheet.width > 1000


@pytest.mark.slow
def test_without_a_scene_the_source_documents_scene_is_taken(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    options = ("--size", 8, 6, "--max-bounces", 0, "--quiet")
    assert run("gallery", "--set", "checkpoints", "-o", tmp_path / "out", *options) == 0
    assert (tmp_path / "out" / "6_transmission.exr").is_file()


def test_switches_that_the_pictures_differ_in_are_refused(tmp_path, capsys):
    assert run("gallery", DATA / "vitreous.txt", "-o", tmp_path, "--no-second-root") == 2
    assert "--second-root is what the pictures of a gallery differ in" in capsys.readouterr().err


@pytest.mark.slow
def test_the_gallery_of_glass_has_six_scenes_of_its_own(tmp_path, capsys):
    assert run("gallery", "--set", "glass", "-o", str(tmp_path), "--size", "16", "12", "--samples", "1", "--quiet") == 0
    written = capsys.readouterr().out.split()
    assert len(written) == 13
    pictures = [read_picture(path) for path in written if path.endswith(".exr")]
    assert len({picture.tobytes() for picture in pictures}) == 6
    assert run("gallery", "vitreous", "--set", "glass", "-o", str(tmp_path)) == 2
    assert "have scenes of their own" in capsys.readouterr().err
