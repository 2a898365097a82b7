"""Pictures that are not read, raw files of cameras and formats with names; and pixels that are not square, in all."""

import io
import struct

import numpy as np
import OpenEXR
import pytest
from image_files import chunk
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from raytrace_jax import PictureError, RaytraceWarning, read_mask, read_picture

PREVIEW = Image.fromarray(np.random.default_rng(0).integers(0, 256, (12, 16, 3)).astype(np.uint8))
REDUCED, INNER, DNG, MOSAIC, PHOTOMETRIC, COMPRESSION = 254, 330, 50706, 33422, 262, 259


def raw_tiff(inner, first):
    """A TIFF of a preview, its first directory with these tags, with a directory of others inside it, at its end."""
    end = 8
    for _ in range(2):
        tags, file = ImageFileDirectory_v2(), io.BytesIO()
        for tag, value in {**first, INNER: end}.items():
            tags.tagtype[tag] = 1 if isinstance(value, bytes) else 4
            tags[tag] = value
        PREVIEW.save(file, "TIFF", tiffinfo=tags)
        data = file.getvalue() + bytes(len(file.getvalue()) % 2)
        end = len(data)
    entries = b"".join(struct.pack("<HHII", tag, 4, 1, value) for tag, value in sorted(inner.items()))
    return data + struct.pack("<H", len(inner)) + entries + bytes(4)


ANY = {256: 640}
RAW = {
    "a.dng": raw_tiff(ANY, {DNG: b"\1\4\0\0"}),
    "preview first.tif": raw_tiff(ANY, {REDUCED: 1}),
    "a mosaic inside.tif": raw_tiff({PHOTOMETRIC: 32803}, {}),
    "linear DNG inside.tif": raw_tiff({PHOTOMETRIC: 34892}, {}),
    "the mosaic's pattern.tif": raw_tiff({MOSAIC: 0x02010100}, {}),
    "of Nikon.tif": raw_tiff({COMPRESSION: 34713}, {}),
    "of Sony.tif": raw_tiff({COMPRESSION: 32767}, {}),
    "by its name.NEF": raw_tiff(ANY, {}),
    "a.cr2": b"II*\0\x10\0\0\0CR\2\0" + bytes(99),
    "a.cr3": b"\0\0\0\x18ftypcrx \0\0\0\1crx isom" + bytes(99),
    "a.raf": b"FUJIFILMCCD-RAW 0201FF383501X-T3" + bytes(99),
    "a.orf": b"IIRS\x08\0\0\0" + bytes(99),
    "a.rw2": b"IIU\0\x18\0\0\0" + bytes(99),
    "a.x3f": b"FOVb\0\0\2\0" + bytes(99),
}


@pytest.mark.parametrize("read", [read_picture, read_mask])
@pytest.mark.parametrize("name", RAW)
def test_a_raw_file_is_refused(name, read, tmp_path):
    (tmp_path / name).write_bytes(RAW[name])
    with pytest.raises(PictureError, match=r"is a raw file of a camera: develop it \(docs/photograph\.md says how\)"):
        read(tmp_path / name)


def test_a_pyramid_tiff_is_no_raw_file(tmp_path):
    (tmp_path / "a.tif").write_bytes(raw_tiff({REDUCED: 1}, {}))
    assert read_picture(tmp_path / "a.tif").shape == (3, 12, 16)


@pytest.mark.parametrize("kind", ["AVIF", "BMP", "GIF", "JPEG2000", "PPM", "WEBP"])
def test_other_formats_are_named_with_advice(kind, tmp_path):
    (PREVIEW.convert("L") if kind == "PPM" else PREVIEW).save(tmp_path / "a.picture", kind)
    with pytest.raises(PictureError, match=r"is a picture of another format \(.+\), and an OpenEXR .* `magick FILE"):
        read_picture(tmp_path / "a.picture")


@pytest.mark.parametrize("brands", [b"heic\0\0\0\0mif1heic", b"mif1\0\0\0\0mif1heic"])
def test_a_picture_of_a_telephone_is_named(brands, tmp_path):
    (tmp_path / "a.picture").write_bytes(b"\0\0\0\x18ftyp" + brands + bytes(40))
    with pytest.raises(PictureError, match=r"is a HEIC picture, as telephones write them, and .* `magick FILE"):
        read_picture(tmp_path / "a.picture")


def density(across, down, kind, **options):
    """A picture with so many pixels an inch."""
    file = io.BytesIO()
    PREVIEW.save(file, kind, dpi=(across, down), **options)
    return file.getvalue()


def jfif(across, down):
    """A JPEG that tells of its densities no unit, only how they are to each other (JFIF 1.02)."""
    data = bytearray(density(72, 72, "JPEG"))
    struct.pack_into(">BHH", data, data.index(b"JFIF\0") + 7, 0, across, down)
    return bytes(data)


def pixels_of_a_png(across, down):
    file = io.BytesIO()
    PREVIEW.save(file, "PNG")
    data = file.getvalue()
    return data[:33] + chunk(b"pHYs", struct.pack(">IIB", across, down, 0)) + data[33:]


def pixels_of_an_exr(aspect, tmp_path):
    header = {"type": OpenEXR.scanlineimage, "pixelAspectRatio": aspect}
    OpenEXR.File(header, {"Y": np.ones((2, 3), np.float32)}).write(str(tmp_path / "made.exr"))
    return (tmp_path / "made.exr").read_bytes()


@pytest.mark.parametrize(
    ("make", "aspect"),
    [
        (lambda _: density(100, 50, "TIFF"), 0.5),
        (lambda _: density(100, 50, "TIFF", tiffinfo={0x0112: 6}), 2),
        (lambda _: density(100, 50, "JPEG"), 0.5),
        (lambda _: jfif(2, 1), 2),
        (lambda _: pixels_of_a_png(1000, 2000), 2),
        (lambda folder: pixels_of_an_exr(2.0, folder), 2),
        (lambda _: density(300, 300, "TIFF"), 1),
        (lambda _: density(300, 300, "JPEG"), 1),
        (lambda _: jfif(1, 1), 1),
        (lambda _: jfif(0, 0), 1),
        (lambda _: pixels_of_a_png(2835, 2834), 1),
        (lambda folder: pixels_of_an_exr(0.9999, folder), 1),
    ],
)
def test_pixels_that_are_not_square_are_told(make, aspect, tmp_path):
    (tmp_path / "a.picture").write_bytes(make(tmp_path))
    if aspect == 1:
        read_picture(tmp_path / "a.picture")
        return
    with pytest.warns(
        RaytraceWarning, match=rf"its pixels are {aspect} times as wide as high; they are read as square"
    ):
        read_picture(tmp_path / "a.picture")
