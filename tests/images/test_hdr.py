"""Radiance HDR pictures against an encoder of the test's own, and files that OpenImageIO would read wrongly."""

import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax import PictureError, read_mask, read_picture
from raytrace_jax.images.pictures import states_colours

RANDOM = np.random.default_rng(0)
HEAD = b"#?RADIANCE\n# a comment\nFORMAT=32-bit_rle_rgbe\n"
FLAT, PIXEL_RUNS, CHANNEL_RUNS = "flat", "pixel runs", "channel runs"


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
    coding=st.sampled_from([FLAT, CHANNEL_RUNS]),
    seed=st.integers(0, 1000),
)
def test_every_coding_is_recognised_and_read(tmp_path_factory, lines, length, coding, seed):
    pixels = pixels_with_runs(lines, length, np.random.default_rng(seed))
    pixels[0, 10:-10] = pixels[0, 10 % length]  # A run of more than a byte, and more than 127.
    pixels[0, length // 2, 3] *= seed % 2
    if length < 8 and coding == CHANNEL_RUNS:
        coding = FLAT
    path = tmp_path_factory.getbasetemp() / "encoded.hdr"
    path.write_bytes(hdr_bytes(pixels, coding))
    picture = read_picture(path)
    assert picture.dtype == np.float32 and picture.flags.c_contiguous and states_colours(path)
    # OpenImageIO's powers of two are a last digit off for some exponents.
    np.testing.assert_allclose(picture, colours(pixels), rtol=2e-7, atol=0)
    np.testing.assert_allclose(read_mask(path), picture.astype(float).mean(axis=0), rtol=1e-6)


def test_harmless_headers_are_read(stored):
    pixels = pixels_with_runs(2, 3)
    head = b"#?RGBE\r\nSOFTWARE=x\r\nEXPOSURE=1.0\r\nCOLORCORR=1 1 1\r\nGAMMA=1\r\nPRIMARIES=0 0 0 0 0 0 0 0\r\n"
    head += b"PRIMARIES=0.640 .33 0.3 0.6 0.15 0.06 0.3127 0.329\r\n"
    content = hdr_bytes(pixels, head=head + b"FORMAT=32-bit_rle_rgbe\r\n\r", size="-Y 2 +X 3\r")
    np.testing.assert_allclose(read_picture(stored(content)), colours(pixels), rtol=2e-7, atol=0)


PIXELS = pixels_with_runs(3, 20)
RUN = b"\x80\x80\x80\x80"
ONE = b"\n-Y 1 +X 1\n" + RUN
MIXED = HEAD + b"\n-Y 2 +X 20\n" + b"".join(map(coded, PIXELS, (CHANNEL_RUNS, PIXEL_RUNS)))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"#?RADIANCE\nEXPOSURE=1\n", "has no header with a size"),
        (HEAD + b"\n-Y 1 +Y 1\n" + RUN, "has no header with a size"),
        (hdr_bytes(PIXELS, size="+Y 3 +X 20"), "is turned: save it as OpenEXR"),
        (hdr_bytes(PIXELS, size="-Y 3 -X 20"), "is turned: save it as OpenEXR"),
        (hdr_bytes(PIXELS, size="+X 3 -Y 20"), "is turned: save it as OpenEXR"),
        (HEAD.replace(b"rgbe", b"xyze") + ONE, "says FORMAT=32-bit_rle_xyze, which is not read: save it as OpenEXR"),
        *((HEAD + said + b"\n" + ONE, f"says {said.decode()}, which is not read") for said in (
            b"EXPOSURE=2.0", b"EXPOSURE=", b"COLORCORR=1 2 .5", b"GAMMA=2.2", b"PIXASPECT=0.5",
            b"PRIMARIES=.7 .3 .2 .8 .1 .1 .3 .3",
        )),
        (HEAD + b"\n-Y 0 +X 4\n" + RUN, "cannot be read: "),
        (HEAD + b"\n-Y 9999999 +X 9\n" + RUN, "is truncated"),
        (hdr_bytes(PIXELS, PIXEL_RUNS), "runs of pixels in Radiance's old coding, which is not read"),
        (HEAD + b"\n-Y 1 +X 2\n" + RUN + b"\1\1\1\1", "runs of pixels in Radiance's old coding"),
        (MIXED + bytes(99), "runs of pixels in Radiance's old coding"),
        (HEAD + b"\n-Y 1 +X 9\n\2\2\0\x08" + RUN, "cannot be read: "),
        (HEAD + b"\n-Y 1 +X 9\n\2\2\0\x09\0\1", "cannot be read: "),
    ],
)  # fmt: skip
def test_says_what_is_broken(content, words, stored):
    path = stored(content)
    with pytest.raises(PictureError, match=re.escape(words)) as caught:
        read_picture(path)
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("coding", [FLAT, CHANNEL_RUNS])
def test_refuses_every_truncation(coding, stored):
    whole = hdr_bytes(PIXELS, coding)
    for length in range(2, len(whole)):
        with pytest.raises(PictureError, match=r"truncated|cannot be read|a size such as"):
            read_picture(stored(whole[:length]))
