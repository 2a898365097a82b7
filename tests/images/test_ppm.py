"""PPM pictures: a course's own output is a target as its PNG is; broken files are refused in a sentence."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from raytrace_jax import PictureError, read_picture, write_png
from raytrace_jax.images.hdr_ppm import write_ppm
from raytrace_jax.images.pictures import read, states_colours
from raytrace_jax.images.transfer import decode_course, decode_srgb

PICTURE = np.random.default_rng(0).uniform(-0.1, 1.1, (3, 4, 5))


@pytest.mark.parametrize("transfer", ["course", "srgb"])
def test_it_is_the_picture_that_a_png_is(transfer, tmp_path):
    write_ppm(tmp_path / "a.ppm", PICTURE, transfer=transfer)
    write_png(tmp_path / "a.png", PICTURE, transfer=transfer)
    np.testing.assert_array_equal(
        read_picture(tmp_path / "a.ppm", transfer=transfer), read_picture(tmp_path / "a.png", transfer=transfer)
    )
    with Image.open(tmp_path / "a.ppm") as ppm, Image.open(tmp_path / "a.png") as png:
        np.testing.assert_array_equal(np.asarray(ppm), np.asarray(png))


@given(st.sampled_from([255, 65535]), st.booleans(), st.integers(0, 99))
def test_plain_and_raw_ppms_are_read(tmp_path_factory, maximum, plain, seed):
    numbers = np.random.default_rng(seed).integers(0, maximum + 1, (2, 3, 3)).astype(f"u{1 + (maximum > 255)}")
    path = tmp_path_factory.mktemp("ppm") / "a"
    if plain:
        body = " # no number: 7\n".join(map(str, numbers.reshape(-1))).encode()
    else:
        body = numbers.astype(numbers.dtype.newbyteorder(">")).tobytes()
    path.write_bytes(b"P%d # by hand\n3\t2\n#\n%d\n" % (3 if plain else 6, maximum) + body)
    for transfer, decode in (("course", decode_course), ("srgb", decode_srgb)):
        expected = np.moveaxis(decode(numbers), -1, 0)
        np.testing.assert_allclose(read_picture(path, transfer=transfer), expected, rtol=1e-6)


def test_a_ppm_has_integers_and_no_profile(tmp_path):
    write_ppm(tmp_path / "a.ppm", PICTURE)
    assert not states_colours(tmp_path / "a.ppm") and read(tmp_path / "a.ppm").bits() == 8


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"P3", "a head with a width, a height and 255 or 65535 as the largest number is wanted"),
        (b"P3\n1 1 99\n1 2 3\n", "`pamdepth 255` converts it"),
        (b"P6\n0 1 255\n", "cannot be read: "),
        (b"P3\n1 1 255\n1 2 3 4\n", "3 x 1 x 1 numbers from 0 to 255 are wanted, no more"),
        (b"P3\n1 1 255\n1 2 256\n", "numbers from 0 to 255 are wanted"),
        (b"P3\n1 1 255\n1 -2 3\n", "numbers from 0 to 255 are wanted"),
        (b"P6\n2 1 255\nabc", "is not whole"),
        (b"P6\n1 1 255\n\nabc", "is not whole"),
        (b"P6\n1 1 255 # no comment\nabc", "is not whole"),
    ],
)
def test_a_broken_file_is_refused_in_words(content, words, tmp_path):
    (tmp_path / "a.ppm").write_bytes(content)
    with pytest.raises(PictureError, match=re.escape(words)):
        read_picture(tmp_path / "a.ppm")
