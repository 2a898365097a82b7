"""What a JPEG does to its picture, done to others: its own tables, squares and orientation; and its bias."""

import io

import numpy as np
import pytest
from image_files import jpeg
from linear_fit import linear_problem
from PIL import Image
from scipy import ndimage

from raytrace_jax import PictureError, jpeg_storage, read_picture
from raytrace_jax.images.exif import upright
from raytrace_jax.images.transfer import decode_srgb
from raytrace_jax.inverse.judge.structure import distant_correlation
from raytrace_jax.inverse.problem.noise import compressed

RANDOM = np.random.default_rng(4)
PIXELS = RANDOM.integers(0, 256, (37, 53, 3)).astype(np.uint8)


def turned_jpeg(orientation, **options):
    exif = Image.Exif()
    exif[0x0112] = orientation
    return jpeg(PIXELS, exif=exif.tobytes(), **options)


@pytest.mark.parametrize("orientation", [1, 3, 6, 8, 5])
@pytest.mark.parametrize("options", [{"quality": 90}, {"quality": 60, "subsampling": 2}])
def test_a_picture_is_compressed_as_the_file(orientation, options, tmp_path):
    """Also a part of it, whatever squares it begins and ends in, but for those that it does not fill."""
    (tmp_path / "a.jpg").write_bytes(turned_jpeg(orientation, **options))
    storage, whole = jpeg_storage(tmp_path / "a.jpg"), read_picture(tmp_path / "a.jpg")
    picture = np.moveaxis(upright(PIXELS, orientation), -1, 0).astype(float)
    np.testing.assert_allclose(storage.compress(picture), whole, atol=1e-6)
    assert storage.size == whole.shape[:0:-1]

    left, top, width, height = window = (2, 1, 33, 34) if orientation != 1 else (5, 3, 40, 30)
    part = storage._replace(window=window).compress(picture[:, top : top + height, left : left + width])
    assert part.shape == (3, height, width)
    off = np.abs(part - whole[:, top : top + height, left : left + width]).max(axis=0)
    unit = 8 if "subsampling" not in options else 17
    assert np.all(off[unit:-unit, unit:-unit] < 1e-6)


def test_numbers_are_those_of_the_transfer(tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg(PIXELS))
    light = decode_srgb(np.moveaxis(PIXELS, -1, 0))
    np.testing.assert_allclose(jpeg_storage(tmp_path / "a.jpg").encode(light), np.moveaxis(PIXELS, -1, 0), atol=3e-3)


def test_a_jpeg_without_ycbcr_has_no_storage(tmp_path):
    gray = io.BytesIO()
    Image.fromarray(PIXELS[..., 0]).save(gray, "JPEG")
    (tmp_path / "gray.jpg").write_bytes(gray.getvalue())
    assert jpeg_storage(tmp_path / "gray.jpg") is None
    (tmp_path / "a.jpg").write_bytes(b"nothing")
    with pytest.raises(PictureError, match=r"a.jpg: cannot be read"):
        jpeg_storage(tmp_path / "a.jpg")


def test_the_jpeg_bias_is_found_in_noise(tmp_path):
    """A JPEG of quality 80 blurs a board of colours behind a lens; with the bias taken off little of that is left."""
    colors = np.kron(RANDOM.uniform(0.1, 0.8, (3, 10, 14)), np.ones((1, 9, 9)))
    picture = ndimage.gaussian_filter(colors, (0, 1, 1), mode="nearest")
    blurrier = (ndimage.gaussian_filter(colors, (0, 1.1, 1.1), mode="nearest") - picture) / 0.1
    (tmp_path / "a.jpg").write_bytes(jpeg(PIXELS, quality=80))
    storage = jpeg_storage(tmp_path / "a.jpg")._replace(size=(126, 90), window=(0, 0, 126, 90))

    def blur_of(off):
        return float(np.sum(off * blurrier) / np.sum(blurrier**2))

    left = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(scale=0.006, size=picture.shape)
        target = storage.compress(storage.encode(picture + noise))
        bias = compressed(storage, linear_problem(picture[None], target).observation, picture) - picture
        left.append([blur_of(target - picture), blur_of(target - picture - bias)])
    before, after = np.mean(left, axis=0)
    assert before > 5e-3 and abs(after) < 0.2 * before


@pytest.mark.parametrize(("subsampling", "unit"), [(0, 8), (2, 16)])
def test_jpeg_noise_correlates_in_its_blocks(subsampling, unit, tmp_path):
    colors = np.kron(np.random.default_rng(5).uniform(0.1, 0.8, (3, 12, 16)), np.ones((1, 17, 17)))
    picture = ndimage.gaussian_filter(colors, (0, 1, 1), mode="nearest")
    pixels = np.zeros((*picture.shape[1:], 3), np.uint8)
    (tmp_path / "a.jpg").write_bytes(jpeg(pixels, quality=80, subsampling=subsampling))
    storage = jpeg_storage(tmp_path / "a.jpg")
    assert storage.unit == unit
    found = []
    for seed in range(4):
        noise = np.random.default_rng(seed).normal(scale=0.006, size=picture.shape)
        target = storage.compress(storage.encode(picture + noise))
        residual = target - compressed(storage, linear_problem(picture[None], target).observation, picture)
        found.append((distant_correlation(residual), distant_correlation(residual, storage.unit)))
    usual, own = np.array(found).T
    assert unit == 16 or np.min(usual) > 3, "the case is worth testing"
    assert np.max(np.abs(own)) < 3
