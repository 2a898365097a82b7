"""The angle of view that the EXIF of a photograph tells, also of one that was made smaller; or that it cannot be."""

import math

import numpy as np
import OpenImageIO as oiio
import pytest

from raytrace_jax import PictureWarning
from raytrace_jax.images.exif import angle_of_view


def photo(path, size=(48, 32), **exif):
    """A JPEG with EXIF."""
    spec = oiio.ImageSpec(*size, 3, oiio.UINT8)
    for name, value in exif.items():
        spec.attribute("Orientation" if name == "Orientation" else f"Exif:{name}", value)
    file = oiio.ImageOutput.create(str(path))
    pixels = np.random.default_rng(0).integers(50, 200, (size[1], size[0], 3)).astype(np.uint8)
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()
    return path


SENSOR = {
    "FocalLength": 49.45,
    "FocalPlaneXResolution": 6000 / 3.6,
    "FocalPlaneResolutionUnit": 3,
    "PixelXDimension": 6000,
    "PixelYDimension": 4000,
}
"""40 degrees across a sensor of 36 mm and 6000 pixels."""


@pytest.mark.parametrize(
    ("size", "exif", "wanted"),
    [
        ((48, 32), {"FocalLengthIn35mmFilm": 50}, 39.598),
        ((48, 32), {"FocalLengthIn35mmFilm": 28}, 65.47),
        ((40, 30), {"FocalLengthIn35mmFilm": 50}, math.degrees(2 * math.atan(0.8 * 43.2666 / 100))),
        ((48, 32), {"FocalLengthIn35mmFilm": 26, "FocalLength": 4.2}, 69.39),
        ((48, 32), {"FocalLengthIn35mmFilm": 25, "DigitalZoomRatio": 2.0}, 39.598),
        ((48, 32), {"FocalLengthIn35mmFilm": 50, "DigitalZoomRatio": 0.0}, 39.598),
        ((48, 32), {**SENSOR, "DigitalZoomRatio": 1.25}, math.degrees(2 * math.atan(18 / 49.45 / 1.25))),
        ((48, 32), {"FocalLengthIn35mmFilm": 0}, None),
        ((48, 32), {}, None),
        ((48, 32), {"FocalLength": 50.0}, None),
        ((48, 32), SENSOR, 40.0),
        ((47, 31), SENSOR, 40.0),
        ((48, 32), {**SENSOR, "Orientation": 6}, math.degrees(2 * math.atan(12 / 49.45))),
        ((32, 48), SENSOR, math.degrees(2 * math.atan(12 / 49.45))),
    ],
)
def test_the_angle_of_view_follows_from_exif(size, exif, wanted, tmp_path):
    found = angle_of_view(photo(tmp_path / "a.jpg", size, **exif))
    assert found == (None if wanted is None else pytest.approx(wanted, abs=0.02))


@pytest.mark.parametrize(
    ("size", "exif", "words"),
    [
        (
            (48, 32),
            {**SENSOR, "PixelXDimension": 48, "PixelYDimension": 32},
            "a sensor that is 0.288 mm wide, which no",
        ),
        ((48, 32), {**SENSOR, "FocalPlaneXResolution": 600.0}, "a sensor that is 100 mm wide"),
        ((48, 32), {"FocalLengthIn35mmFilm": 50, "FocalLength": 300.0}, "a sensor that is 216 mm wide"),
        ((40, 32), SENSOR, "for 6000 x 4000 pixels, and it has 40 x 32: it was cut"),
        ((48, 32), {"FocalLengthIn35mmFilm": 65535}, "an angle of view of 0.031 degrees, which no lens has"),
    ],
)
def test_what_cannot_be_is_not_believed_and_said(size, exif, words, tmp_path):
    path = photo(tmp_path / "a.jpg", size, **exif)
    with pytest.warns(PictureWarning, match=words):
        assert angle_of_view(path) is None
