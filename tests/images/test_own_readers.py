"""Formats are read here where libraries read them wrongly: each file below is such, and ours reads or refuses it."""

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image
from test_hdr import FLAT, HEAD, PIXEL_RUNS, coded, colours, hdr_bytes, pixels_with_runs
from test_png import png_bytes

from raytrace_jax import read_picture

PIXELS = pixels_with_runs(4, 9)


def by_library(path):
    """The numbers that OpenImageIO reads, "3 height width"; None where it refuses."""
    file = oiio.ImageInput.open(str(path))
    stored = None if file is None else file.read_image(0, 0, 0, 3, str(file.spec().format))
    oiio.geterror()
    return None if stored is None else np.moveaxis(np.asarray(stored), -1, 0)


OLD_RUNS = hdr_bytes(PIXELS, PIXEL_RUNS)
SEVERAL_CODINGS = HEAD + b"\n-Y 4 +X 9\n" + b"".join(map(coded, PIXELS, (PIXEL_RUNS, FLAT, FLAT, FLAT)))
FROM_THE_RIGHT = hdr_bytes(PIXELS[:, ::-1], size="-Y 4 -X 9")
FROM_THE_BOTTOM = hdr_bytes(PIXELS[::-1], size="+Y 4 +X 9")


@pytest.mark.parametrize("content", [OLD_RUNS, SEVERAL_CODINGS, FROM_THE_RIGHT, FROM_THE_BOTTOM])
def test_radiance_files_of_all_codings_and_orientations(content, tmp_path):
    (tmp_path / "a.hdr").write_bytes(content)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.hdr"), colours(PIXELS))
    other = by_library(tmp_path / "a.hdr")
    assert other is None or not np.array_equal(other, colours(PIXELS))


@pytest.mark.parametrize("content", [b"P3\n1 1 9\n1 2 10\n", b"P3\n1 1 9\n1 -2 3\n", b"P3\n1 1 255\n1 2 3 4\n"])
def test_ppms_that_are_wrong(content, tmp_path):
    """That they are refused here `test_ppm` has."""
    (tmp_path / "a.ppm").write_bytes(content)
    assert by_library(tmp_path / "a.ppm") is not None


def test_of_16_bits_a_channel_pillow_keeps_the_upper_8(tmp_path):
    (tmp_path / "b.png").write_bytes(png_bytes(1, 1, 16, 2, [(0, bytes(range(1, 7)))]))
    with Image.open(tmp_path / "b.png") as image:
        assert np.asarray(image).dtype == np.uint8
    np.testing.assert_allclose(read_picture(tmp_path / "b.png", transfer="srgb")[0], 258 / 65535 / 12.92)
