"""JPEG and TIFF pictures: every kind that a camera or a scanner writes is read right, or refused in words."""

import io

import numpy as np
import OpenImageIO as oiio
import pytest
from command_line import run
from PIL import Image

from raytrace_jax import PictureError, PictureWarning, read_picture
from raytrace_jax.images.pictures import states_colours
from raytrace_jax.images.transfer import DECODERS

RANDOM = np.random.default_rng(5)
BLOCKS = np.kron(RANDOM.integers(0, 256, size=(4, 6, 3)), np.ones((8, 8, 1))).astype(np.uint8)
"""Squares of 8 x 8 pixels of one colour, of which JPEG loses next to nothing."""

SOFT = np.stack(np.meshgrid(np.linspace(30, 220, 48), np.linspace(40, 200, 32)), -1)
SMOOTH = np.dstack([SOFT, SOFT[..., :1]]).astype(np.uint8)


def jpeg(pixels, **options):
    stored = io.BytesIO()
    Image.fromarray(pixels).save(stored, "JPEG", **{"quality": 98, "subsampling": 0, **options})
    return stored.getvalue()


def write_tiff(path, pixels, *, bits=None, names=None):
    height, width, channels = pixels.shape
    kind = {"float32": "float", "float16": "half"}.get(str(pixels.dtype), str(pixels.dtype))
    spec = oiio.ImageSpec(width, height, channels, kind)
    if bits:
        spec.attribute("oiio:BitsPerSample", bits)
    if names:
        spec.channelnames = names
        spec.alpha_channel = names.index("A") if "A" in names else -1
        spec.attribute("oiio:UnassociatedAlpha", 1)
    file = oiio.ImageOutput.create(str(path))
    assert file.open(str(path), spec) and file.write_image(pixels) and file.close()


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


@pytest.mark.parametrize("orientation", TURNED)
def test_the_orientation_of_exif_is_obeyed_and_told(orientation, tmp_path):
    exif = Image.Exif()
    exif[0x0112] = orientation
    (tmp_path / "a.jpg").write_bytes(jpeg(np.ascontiguousarray(TURNED[orientation]), exif=exif))
    with pytest.warns(PictureWarning, match=rf"orientation {orientation}\): upright it is 48 x 32"):
        found = read_picture(tmp_path / "a.jpg")
    np.testing.assert_allclose(found, DECODERS["srgb"](np.moveaxis(SMOOTH, -1, 0)), atol=0.03)


def test_a_grey_jpeg_has_three_equal_channels_and_garbage_in_exif_harms_nothing(tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg(SMOOTH[..., 0]))
    found = read_picture(tmp_path / "a.jpg")
    assert found.shape == (3, 32, 48) and np.array_equal(found[0], found[2])
    (tmp_path / "b.jpg").write_bytes(jpeg(SMOOTH, exif=b"Exif\0\0II*\0nonsense" + bytes(range(200))))
    np.testing.assert_allclose(read_picture(tmp_path / "b.jpg")[0], found[0], atol=0.03)


@pytest.mark.parametrize("bits", [8, 10, 12, 16])
def test_a_tiff_of_any_bits_is_read_to_its_last_step(bits, tmp_path):
    dtype = np.uint8 if bits == 8 else np.uint16
    largest = 2**bits - 1
    codes = RANDOM.integers(0, largest + 1, size=(5, 7, 3))
    whole = np.iinfo(dtype).max
    write_tiff(tmp_path / "a.tif", np.round(codes * (whole / largest)).astype(dtype), bits=bits)
    found = read_picture(tmp_path / "a.tif", transfer="srgb")
    stored = np.round(codes * (whole / largest)).astype(dtype)
    np.testing.assert_allclose(found, DECODERS["srgb"](np.moveaxis(stored, -1, 0)), atol=3 / whole + 1e-6)
    assert not states_colours(tmp_path / "a.tif")


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
    "without its end": (lambda: jpeg(BLOCKS, progressive=True)[:-2], "cannot be read: JPEG error: Premature end"),
    "one scan": (lambda: scans(1), "is truncated"),
    "all scans but one": (lambda: scans(9), "is truncated"),
    "truncated": (lambda: jpeg(BLOCKS)[: len(jpeg(BLOCKS)) // 2], "cannot be read: JPEG error: Premature end"),
    "a beginning": (lambda: b"\xff\xd8\xff\xe0\0\0", "cannot be read: "),
    "pages": (pages, "has several pages"),
    "transparent": (transparent, "1,536 of its pixels are transparent"),
    "not finite": (not_finite, "3 of its numbers are NaN or infinite"),
    "a broken TIFF": (lambda: b"II*\0\xff\xff\xff\xffnonsense", "cannot be read: "),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_cannot_be_read_is_refused_in_words(what, tmp_path, capfd):
    make, words = REFUSED[what]
    (tmp_path / "a.picture").write_bytes(make())
    with pytest.raises(PictureError, match=f"a.picture: .*{words}"):
        read_picture(tmp_path / "a.picture")
    capfd.readouterr()
    arguments = ["fit", "vitreous", str(tmp_path / "a.picture"), "--free", "vitreous.ior", "-o", str(tmp_path / "out")]
    assert run(*arguments) == 1
    error = capfd.readouterr().err
    assert words.split(":")[0] in error and "Traceback" not in error and not (tmp_path / "out").exists()


def test_a_layer_of_a_jpeg_is_refused(tmp_path):
    (tmp_path / "a.jpg").write_bytes(jpeg(SMOOTH))
    with pytest.raises(PictureError, match="is a JPEG picture and has no layers"):
        read_picture(tmp_path / "a.jpg", layer="left")
