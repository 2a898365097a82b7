"""Formats are read here where libraries read them wrongly: each file below is such, and ours reads or refuses it."""

import numpy as np
import OpenImageIO as oiio
import pytest
from PIL import Image
from test_hdr import FLAT, HEAD, PIXEL_RUNS, coded, colours, hdr_bytes, pixels_with_runs
from test_png import png_bytes

from raytrace_jax import PictureError, read_picture

PIXELS = pixels_with_runs(4, 9)


def by_library(path):
    """The numbers that OpenImageIO reads, "3 height width"; None where it refuses."""
    file = oiio.ImageInput.open(str(path))
    stored = None if file is None else file.read_image(0, 0, 0, 3, str(file.spec().format))
    oiio.geterror()
    return None if stored is None else np.moveaxis(np.asarray(stored), -1, 0)


@pytest.mark.parametrize(
    ("content", "wanted"),
    [
        (hdr_bytes(PIXELS, PIXEL_RUNS), PIXELS),
        (HEAD + b"\n-Y 4 +X 9\n" + b"".join(map(coded, PIXELS, (PIXEL_RUNS, FLAT, FLAT, FLAT))), PIXELS),
        (hdr_bytes(PIXELS[:, ::-1], size="-Y 4 -X 9"), PIXELS),
        (hdr_bytes(PIXELS[::-1], size="+Y 4 +X 9"), PIXELS),
    ],
    ids=["old runs", "several codings", "from the right", "from the bottom"],
)
def test_radiance_files_of_all_codings_and_orientations(content, wanted, tmp_path):
    (tmp_path / "a.hdr").write_bytes(content)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.hdr"), colours(wanted))
    other = by_library(tmp_path / "a.hdr")
    assert other is None or not np.array_equal(other, colours(wanted))


@pytest.mark.parametrize("content", [b"P3\n1 1 9\n1 2 10\n", b"P3\n1 1 9\n1 -2 3\n", b"P3\n1 1 255\n1 2 3 4\n"])
def test_ppms_that_are_wrong(content, tmp_path):
    (tmp_path / "a.ppm").write_bytes(content)
    with pytest.raises(PictureError):
        read_picture(tmp_path / "a.ppm")
    assert by_library(tmp_path / "a.ppm") is not None


def test_rows_of_a_png_that_are_missing(tmp_path):
    rows = [(0, bytes([9, 8, 7, 6]))] * 2
    (tmp_path / "a.png").write_bytes(png_bytes(4, 5, 8, 0, rows))
    with pytest.raises(PictureError, match="some of its pixels are missing"):
        read_picture(tmp_path / "a.png")
    # Of 16 bits a channel Pillow keeps the upper 8.
    (tmp_path / "b.png").write_bytes(png_bytes(1, 1, 16, 2, [(0, bytes(range(1, 7)))]))
    with Image.open(tmp_path / "b.png") as image:
        assert np.asarray(image).dtype == np.uint8
    np.testing.assert_allclose(read_picture(tmp_path / "b.png", transfer="srgb")[0], 258 / 65535 / 12.92)
