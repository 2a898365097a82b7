"""The galleries of the source documents: each picture is the tracer's own under its switches."""

import numpy as np
import pytest
from command_line import run
from PIL import Image
from scenes import DATA

from raytrace_jax import read_exr, read_picture

SIZE = (24, 18)


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
