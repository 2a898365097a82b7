"""Radiance HDR pictures: every coding and orientation against an encoder of the test's own, and broken files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from test_colour_spaces import BT_2020

from raytrace_jax import PictureError, PictureWarning, read_picture
from raytrace_jax.images.own_readers import HdrFile
from raytrace_jax.images.pictures import states_colours
from raytrace_jax.images.transfer import REC_709, to_rec_709

RANDOM = np.random.default_rng(0)
HEAD = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n"
FLAT, PIXEL_RUNS, CHANNEL_RUNS = "flat", "pixel runs", "channel runs"


def read_hdr(path):
    return HdrFile(path).light()


def pixels_with_runs(lines, length, random=RANDOM):
    """Bytes "lines length 4" as pictures have them: some pixels equal to the one before, the largest mantissa big."""
    fresh = random.integers(0, 256, (lines, length, 4), np.uint8)
    fresh[..., 1] |= 128
    source = np.maximum.accumulate(np.where(random.random((lines, length)) < 0.4, np.arange(length), 0), axis=1)
    return np.take_along_axis(fresh, source[..., None], axis=1)


def coded(line, coding):
    if coding == FLAT:
        return line.tobytes()
    if coding == PIXEL_RUNS:
        return b"".join(pixel + repeat_pixel(times - 1) for pixel, times in runs([bytes(pixel) for pixel in line]))
    out = bytes([2, 2, len(line) >> 8, len(line) & 255])
    for channel in line.T.tolist():
        for value, times in runs(channel):
            while times > 2:
                out += bytes([128 + min(times, 127), value])
                times -= min(times, 127)
            out += bytes([times] + [value] * times) if times else b""
    return out


def runs(values):
    """Values with how often they come in a row."""
    found = []
    for value in values:
        if found and found[-1][0] == value:
            found[-1][1] += 1
        else:
            found.append([value, 1])
    return found


def repeat_pixel(times):
    """The digits of a number to the base of 256, the least first, each in a pixel of its own."""
    return bytes([1, 1, 1, times & 255]) + repeat_pixel(times >> 8) if times else b""


def hdr_bytes(pixels, coding=FLAT, *, head=HEAD, size=None):
    lines, length, _ = pixels.shape
    size = size or f"-Y {lines} +X {length}"
    return head + b"\n" + size.encode() + b"\n" + b"".join(coded(line, coding) for line in pixels)


def colours(pixels):
    """By the formula."""
    wanted = pixels[..., :3] * 2.0 ** (pixels[..., 3:].astype(int) - 136) * (pixels[..., 3:] > 0)
    return np.moveaxis(wanted, -1, 0).astype(np.float32)


@pytest.fixture
def stored(tmp_path):
    def store(content):
        (tmp_path / "a.hdr").write_bytes(content)
        return tmp_path / "a.hdr"

    return store


@given(
    lines=st.integers(1, 4),
    length=st.sampled_from([1, 2, 7, 8, 9, 130, 400]),
    coding=st.sampled_from([FLAT, PIXEL_RUNS, CHANNEL_RUNS]),
    seed=st.integers(0, 1000),
)
def test_every_coding_gives_the_formula_and_is_known_by_its_contents(tmp_path_factory, lines, length, coding, seed):
    pixels = pixels_with_runs(lines, length, np.random.default_rng(seed))
    pixels[0, 10:-10] = pixels[0, 10 % length]  # A run of more than a byte, and more than 127.
    pixels[0, length // 2, 3] *= seed % 2
    if length < 8 and coding == CHANNEL_RUNS:
        coding = FLAT
    path = tmp_path_factory.getbasetemp() / "encoded.hdr"
    path.write_bytes(hdr_bytes(pixels, coding))
    picture = read_picture(path)
    assert picture.dtype == np.float32 and picture.flags.c_contiguous and states_colours(path)
    np.testing.assert_array_equal(picture, colours(pixels))


@pytest.mark.parametrize("x_sign", "+-")
@pytest.mark.parametrize("y_sign", "+-")
@pytest.mark.parametrize("rows_first", [True, False])
def test_every_orientation_puts_pixels_where_they_belong(x_sign, y_sign, rows_first, stored):
    picture = pixels_with_runs(4, 9)  # As it is seen.
    lines = picture[::-1] if y_sign == "+" else picture
    lines = lines[:, ::-1] if x_sign == "-" else lines
    size = f"{y_sign}Y 4 {x_sign}X 9" if rows_first else f"{x_sign}X 9 {y_sign}Y 4"
    content = hdr_bytes(lines if rows_first else lines.swapaxes(0, 1), size=size)
    np.testing.assert_array_equal(read_hdr(stored(content)), colours(picture))


def test_exposures_are_divided_out_and_lines_may_end_as_on_windows(stored):
    pixels = pixels_with_runs(2, 3)
    head = b"#?RGBE\r\nEXPOSURE=2.0\r\nFORMAT=32-bit_rle_rgbe\r\nEXPOSURE= 4\r\nCOLORCORR=1 2 .5\r\nGAMMA=1\r\n\r"
    wanted = colours(pixels) / np.array([8, 16, 4], np.float32)[:, None, None]
    np.testing.assert_array_equal(read_hdr(stored(hdr_bytes(pixels, head=head, size="-Y 2 +X 3\r"))), wanted)


@pytest.mark.parametrize("stated", [(*BT_2020,), (0,) * 8, REC_709])
def test_primaries_are_obeyed_and_zeros_as_photoshop_writes_them_say_nothing(stated, stored):
    pixels = pixels_with_runs(2, 3)
    head = HEAD + b"GAMMA=1\nPRIMARIES=" + " ".join(map(str, stated)).encode() + b"\n"
    path = stored(hdr_bytes(pixels, head=head))
    if stated != BT_2020:
        np.testing.assert_array_equal(read_hdr(path), colours(pixels))
        return
    with pytest.warns(PictureWarning, match=r"its primaries are others \(by PRIMARIES\)"):
        found = read_hdr(path)
    np.testing.assert_allclose(found, np.tensordot(to_rec_709(BT_2020), colours(pixels), 1), rtol=1e-5)


PIXELS = pixels_with_runs(3, 20)
RUN = b"\x80\x80\x80\x80"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"#!RADIANCE\n\n-Y 1 +X 1\n" + RUN, "does not start with #?"),
        (b"#?RADIANCE\nEXPOSURE=1\n", "its header does not end"),
        (
            HEAD.replace(b"rgbe", b"xyze") + b"\n-Y 1 +X 1\n" + RUN,
            "format is '32-bit_rle_xyze', and '32-bit_rle_rgbe' is",
        ),
        (HEAD + b"EXPOSURE=0\n\n-Y 1 +X 1\n" + RUN, "EXPOSURE is '0', and a positive number is wanted"),
        (HEAD + b"COLORCORR=1 2\n\n-Y 1 +X 1\n" + RUN, "COLORCORR is '1 2', and three positive numbers are wanted"),
        (HEAD + b"GAMMA=2.2\n\n-Y 1 +X 1\n" + RUN, "its GAMMA is 2.2, and linear light is wanted"),
        (HEAD + b"PRIMARIES=.3 .3\n\n-Y 1 +X 1\n" + RUN, "PRIMARIES is '.3 .3', and eight numbers are wanted"),
        (HEAD + b"PRIMARIES=" + 8 * b".3 " + b"\n\n-Y 1 +X 1\n" + RUN, "chromaticities that are on one line"),
        (HEAD + b"EXPOSURE=1e-9\n\n-Y 1 +X 1\n\x80\x80\x80\xff", "do not fit into 32-bit floats"),
        (HEAD + b"\n-Y 1 +Y 1\n" + RUN, "'-Y 480 \\+X 640' is wanted, not '-Y 1 \\+Y 1'"),
        (HEAD + b"\n-Y 0 +X 4\n" + RUN, "has no pixels"),
        (HEAD + b"\n-Y 99999999999 +X 9\n" + RUN, "truncated Radiance HDR file: 99999999999 scan lines"),
        (HEAD + b"\n-Y 1 +X 99999999999999999999999\n" + RUN, "GB of memory"),
        (HEAD + b"\n-Y 1 +X 2\n" + RUN, r"truncated Radiance HDR file \(scan line 1 of 1\)"),
        (HEAD + b"\n-Y 1 +X 2\n\1\1\1\2" + RUN, "repeats a pixel before there is one"),
        (HEAD + b"\n-Y 1 +X 3\n" + RUN + b"\1\1\1\3", "a run goes beyond its scan line"),
        (HEAD + b"\n-Y 1 +X 9\n\2\2\0\x08" + RUN, "9 pixels are wanted, not 8"),
        (HEAD + b"\n-Y 1 +X 9\n\2\2\0\x09\0\1", "a run of no pixels"),
    ],
)
def test_says_what_is_broken(content, words, stored):
    path = stored(content)
    with pytest.raises(PictureError, match=words) as caught:
        read_hdr(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("coding", [FLAT, PIXEL_RUNS, CHANNEL_RUNS])
def test_refuses_every_truncation(coding, stored):
    whole = hdr_bytes(PIXELS, coding)
    for length in range(2, len(whole)):
        with pytest.raises(PictureError, match=r"truncated|a size such as"):
            read_hdr(stored(whole[:length]))
