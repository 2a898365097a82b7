"""JPEG and TIFF: all that cameras and scanners write is read right or refused; the angle of view that EXIF tells."""

import io
import math
import struct
import zlib

import numpy as np
import pytest
from command_line import run
from hypothesis import given
from hypothesis import strategies as st
from image_files import jpeg, photo, write_tiff
from PIL import Image

from raytrace_jax import PictureError, RaytraceWarning, read_picture
from raytrace_jax.images.exif import angle_of_view
from raytrace_jax.images.pictures import states_colours
from raytrace_jax.images.transfer import DECODERS, srgb_to_linear

RANDOM = np.random.default_rng(5)
BLOCKS = np.kron(RANDOM.integers(0, 256, size=(4, 6, 3)), np.ones((8, 8, 1))).astype(np.uint8)
"""Squares of 8 x 8 pixels of one colour, of which JPEG loses next to nothing."""

SOFT = np.stack(np.meshgrid(np.linspace(30, 220, 48), np.linspace(40, 200, 32)), -1)
SMOOTH = np.dstack([SOFT, SOFT[..., :1]]).astype(np.uint8)


@pytest.mark.parametrize("transfer", ["course", "srgb", None])
@pytest.mark.parametrize("progressive", [False, True])
def test_a_jpeg_is_read_as_it_was_stored(transfer, progressive, tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg(BLOCKS, progressive=progressive))
    found = read_picture(tmp_path / "a.jpg", transfer=transfer)
    stored = np.moveaxis(np.asarray(Image.open(tmp_path / "a.jpg")), -1, 0)
    np.testing.assert_allclose(found, DECODERS[transfer or "srgb"](stored), atol=0.02)
    assert found.dtype == np.float32 and np.mean(np.abs(stored - np.moveaxis(BLOCKS.astype(int), -1, 0))) < 2
    assert states_colours(tmp_path / "a.jpg")


TURNED = {
    2: SMOOTH[:, ::-1],
    3: SMOOTH[::-1, ::-1],
    4: SMOOTH[::-1],
    5: SMOOTH.swapaxes(0, 1),
    6: np.rot90(SMOOTH, 1),
    7: SMOOTH[::-1, ::-1].swapaxes(0, 1),
    8: np.rot90(SMOOTH, -1),
}
"""What a camera stores of an upright picture when it is held in each way, and says so."""


@pytest.mark.parametrize("suffix", [".jpg", ".tif"])
@pytest.mark.parametrize("orientation", TURNED)
def test_the_exif_orientation_is_obeyed(orientation, suffix, tmp_path):
    exif, path = Image.Exif(), tmp_path / f"a{suffix}"
    exif[0x0112] = orientation
    Image.fromarray(np.ascontiguousarray(TURNED[orientation])).save(path, exif=exif, quality=98, subsampling=0)
    found = read_picture(path)  # A warning would be an error.
    np.testing.assert_allclose(found, DECODERS["srgb"](np.moveaxis(SMOOTH, -1, 0)), atol=0.03)


def test_a_grey_jpeg_with_bad_exif_is_read(tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg(SMOOTH[..., 0]))
    found = read_picture(tmp_path / "a.jpg")
    assert found.shape == (3, 32, 48) and np.array_equal(found[0], found[2])
    (tmp_path / "b.jpg").write_bytes(jpeg(SMOOTH, exif=b"Exif\0\0II*\0nonsense" + bytes(range(200))))
    np.testing.assert_allclose(read_picture(tmp_path / "b.jpg")[0], found[0], atol=0.03)


@pytest.mark.parametrize("dtype", ["half", "float"])
def test_a_tiff_of_floats_is_scene_linear(dtype, tmp_path):
    light = RANDOM.uniform(0, 9, size=(5, 7, 3)).astype({"half": np.float16, "float": np.float32}[dtype])
    write_tiff(tmp_path / "a.tif", light)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.tif"), np.moveaxis(light.astype(np.float32), -1, 0))
    assert states_colours(tmp_path / "a.tif")


def test_an_opaque_alpha_is_left_out(tmp_path):
    pixels = np.dstack([SMOOTH, np.full(SMOOTH.shape[:2], 255, np.uint8)])
    write_tiff(tmp_path / "a.tif", pixels, names=("R", "G", "B", "A"))
    np.testing.assert_allclose(
        read_picture(tmp_path / "a.tif"), DECODERS["srgb"](np.moveaxis(SMOOTH, -1, 0)), atol=1e-6
    )


def pages():
    stored = io.BytesIO()
    Image.fromarray(SMOOTH).save(stored, "TIFF", save_all=True, append_images=[Image.fromarray(SMOOTH)])
    return stored.getvalue()


def transparent():
    stored = io.BytesIO()
    Image.fromarray(np.dstack([SMOOTH, np.full(SMOOTH.shape[:2], 99, np.uint8)])).save(stored, "TIFF")
    return stored.getvalue()


def not_finite():
    light = np.ones((4, 4), np.float32)
    light[1, 2] = np.nan
    stored = io.BytesIO()
    Image.fromarray(light, "F").save(stored, "TIFF")
    return stored.getvalue()


def cmyk():
    stored = io.BytesIO()
    Image.fromarray(SMOOTH).convert("CMYK").save(stored, "JPEG")
    return stored.getvalue()


def ycck():
    """As Photoshop stores it: the text of Adobe's marker says that it is YCCK (ITU-T T.872, 6.5.3)."""
    stored = bytearray(cmyk())
    stored[stored.index(b"Adobe") + 11] = 2
    return bytes(stored)


def scans(count):
    """A progressive JPEG of which so many scans are there, and its end."""
    whole = jpeg(BLOCKS, progressive=True)
    return b"\xff\xda".join(whole.split(b"\xff\xda")[: count + 1]) + b"\xff\xd9"


REFUSED = {
    "CMYK": (cmyk, "is CMYK, for print"),
    "YCCK": (ycck, "is CMYK, for print"),
    "cut progressive": (lambda: scans(10)[:-99], "cannot be read: JPEG error: Premature end"),
    "one scan": (lambda: scans(1), "is truncated"),
    "truncated": (lambda: jpeg(BLOCKS)[: len(jpeg(BLOCKS)) // 2], "cannot be read: JPEG error: Premature end"),
    "pages": (pages, "has several pages"),
    "transparent": (transparent, "1,536 of its pixels are transparent"),
    "not finite": (not_finite, "3 of its numbers are NaN or infinite"),
    "a broken TIFF": (lambda: b"II*\0\xff\xff\xff\xffnonsense", "cannot be read: "),
}


@pytest.mark.parametrize("what", REFUSED)
def test_unreadable_files_are_refused(what, tmp_path, capfd):
    make, words = REFUSED[what]
    (tmp_path / "a.picture").write_bytes(make())
    with pytest.raises(PictureError, match=f"a.picture: .*{words}"):
        read_picture(tmp_path / "a.picture")
    capfd.readouterr()
    arguments = ["fit", "vitreous", str(tmp_path / "a.picture"), "--free", "vitreous.ior", "-o", str(tmp_path / "out")]
    assert run(*arguments) == 1
    error = capfd.readouterr().err
    assert words.split(":")[0] in error and "Traceback" not in error and not (tmp_path / "out").exists()


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
        ((40, 30), {"FocalLengthIn35mmFilm": 50}, math.degrees(2 * math.atan(0.8 * 43.2666 / 100))),
        ((48, 32), {"FocalLengthIn35mmFilm": 25, "DigitalZoomRatio": 2.0}, 39.598),
        ((48, 32), {**SENSOR, "DigitalZoomRatio": 1.25}, math.degrees(2 * math.atan(18 / 49.45 / 1.25))),
        ((48, 32), {"FocalLengthIn35mmFilm": 0}, None),
        ((48, 32), {"FocalLength": 50.0}, None),
        ((48, 32), SENSOR, 40.0),
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
        ((48, 32), {**SENSOR, "PixelXDimension": 48, "PixelYDimension": 32}, "no camera has a sensor 0.288 mm wide"),
        ((48, 32), {"FocalLengthIn35mmFilm": 50, "FocalLength": 300.0}, "no camera has a sensor 216 mm wide"),
        ((40, 32), SENSOR, "it was cut to 40 x 32 of 6000 x 4000 pixels"),
    ],
)
def test_impossible_exif_is_not_believed(size, exif, words, tmp_path):
    path = photo(tmp_path / "a.jpg", size, **exif)
    with pytest.warns(RaytraceWarning, match=words):
        assert angle_of_view(path) is None


WIDTH, HEIGHT = 9, 4


def tiff(codes, bits, *, white_is_zero, predictor, compression, order, reversed_bits):
    """A TIFF by its definition (TIFF 6.0): numbers of any number of bits, "height width samples", in one strip."""
    samples = codes.shape[-1]
    stored = (2**bits - 1 - codes if white_is_zero else codes).astype(int)
    if predictor == 2:
        stored[:, 1:] = (stored[:, 1:] - stored[:, :-1]) % 2**bits
    if bits == 16:
        data = stored.astype(f"{order}u2").tobytes()
    else:
        digits = (stored.reshape(HEIGHT, -1, 1) >> np.arange(bits)[::-1] & 1).reshape(HEIGHT, -1).astype(np.uint8)
        data = np.packbits(digits, axis=1).tobytes()
    if compression == 8:
        data = zlib.compress(data)
    if reversed_bits:
        data = np.packbits(np.unpackbits(np.frombuffer(data, np.uint8)).reshape(-1, 8)[:, ::-1]).tobytes()
    data += bytes(len(data) % 2)
    tags = {256: WIDTH, 257: HEIGHT, 258: bits, 259: compression, 262: 2 if samples == 3 else int(not white_is_zero)}
    tags |= {266: 2 if reversed_bits else 1, 273: 8, 277: samples, 278: HEIGHT, 279: len(data), 284: 1, 317: predictor}
    end = 8 + len(data) + 2 + 12 * len(tags) + 4
    directory = struct.pack(f"{order}H", len(tags))
    for tag, value in sorted(tags.items()):
        if tag == 258 and samples == 3:
            directory += struct.pack(f"{order}HHII", tag, 3, 3, end)
        else:
            directory += struct.pack(f"{order}HHIHxx", tag, 3, 1, value)
    start = (b"II*\0" if order == "<" else b"MM\0*") + struct.pack(f"{order}I", 8 + len(data))
    return start + data + directory + bytes(4) + struct.pack(f"{order}3H", bits, bits, bits)


@given(
    st.sampled_from([1, 2, 4, 6, 8, 10, 12, 14, 16]),
    st.sampled_from([1, 3]),
    st.booleans(),
    st.sampled_from([1, 2]),
    st.sampled_from([1, 8]),
    st.sampled_from("<>"),
    st.booleans(),
)
def test_a_tiff_is_read_fully_or_refused(
    tmp_path_factory, bits, samples, white_is_zero, predictor, compression, order, reversed_bits
):
    codes = np.random.default_rng(0).integers(0, 2**bits, size=(HEIGHT, WIDTH, samples))
    path = tmp_path_factory.getbasetemp() / "a.tif"
    white_is_zero &= samples == 1
    reversed_bits &= compression == 1
    how = {"white_is_zero": white_is_zero, "predictor": predictor, "compression": compression, "order": order}
    path.write_bytes(tiff(codes, bits, **how, reversed_bits=reversed_bits))
    if predictor == 2 and (compression == 1 or bits not in (8, 16)):
        with pytest.raises(PictureError, match=r"without compression, which programs read|not supported with \d+-bit"):
            read_picture(path, transfer="srgb")
    else:
        wanted = np.broadcast_to(np.moveaxis(srgb_to_linear(codes / (2**bits - 1)), -1, 0), (3, HEIGHT, WIDTH))
        np.testing.assert_allclose(read_picture(path, transfer="srgb"), wanted, atol=3e-5)
        assert not states_colours(path)


@pytest.mark.parametrize(("photometric", "words"), [(8, "its colours are CIE"), (32803, "is a raw file of a camera")])
def test_non_rgb_tiffs_are_refused(photometric, words, tmp_path):
    codes = np.random.default_rng(0).integers(0, 256, size=(HEIGHT, WIDTH, 3))
    how = {"white_is_zero": False, "predictor": 1, "compression": 1, "order": "<", "reversed_bits": False}
    data = tiff(codes, 8, **how)
    place = data.index(struct.pack("<HHI", 262, 3, 1)) + 8
    (tmp_path / "a.tif").write_bytes(data[:place] + struct.pack("<H", photometric) + data[place + 2 :])
    with pytest.raises(PictureError, match=words):
        read_picture(tmp_path / "a.tif")
