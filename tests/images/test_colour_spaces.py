"""Pictures whose numbers are not sRGB's: what their files say of curves and primaries is obeyed, or refused."""

import contextlib
import io
import struct
import zlib

import numpy as np
import OpenEXR
import OpenImageIO as oiio
import pytest
from image_files import BT_2020, HEADER_END
from PIL import Image, ImageCms
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from raytrace_jax import PictureError, RaytraceWarning, read_picture, write_png
from raytrace_jax.images.icc import SRGB_TO_XYZ, read_profile
from raytrace_jax.images.pictures import states_colours
from raytrace_jax.images.png import png_chunk
from raytrace_jax.images.transfer import (
    DECODERS,
    LINEAR_SPACES,
    REC_709,
    XYZ,
    encode_srgb,
    rgb_to_xyz,
    srgb_to_linear,
    to_rec_709,
)

LIGHT = np.random.default_rng(7).uniform(0.05, 0.8, size=(5, 7, 3))
ADOBE = np.array([[0.60974, 0.20528, 0.14919], [0.31111, 0.62567, 0.06322], [0.01947, 0.06087, 0.74457]])
DISPLAY_P3 = np.array([[0.51512, 0.29198, 0.15710], [0.24120, 0.69225, 0.06657], [-0.00105, 0.04189, 0.78407]])
"""From their light to XYZ with the white of profiles, as Adobe's and Apple's have it."""

AP0 = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767)
P3 = (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290)

GAMMA = b"curv" + struct.pack(">4xIH", 1, round(2.19921875 * 256))
LINEAR = b"curv" + struct.pack(">4xI", 0)
SRGB_FORMULA = b"para" + struct.pack(
    ">4xHxx5i", 3, *(round(x * 65536) for x in (2.4, 1 / 1.055, 0.055 / 1.055, 1 / 12.92, 0.04045))
)
SQUARE_TABLE = b"curv" + struct.pack(">4xI1024H", 1024, *(round(65535 * (k / 1023) ** 2) for k in range(1024)))
FORMULAS = {
    "1: nothing, then a power": (
        struct.pack(">4xHxx3i", 1, 2 << 16, 2 << 16, -1 << 15),
        lambda x: np.maximum(2 * x - 0.5, 0) ** 2,
    ),
    "2: a floor, then a power": (
        struct.pack(">4xHxx4i", 2, 2 << 16, 1 << 16, -1 << 14, 1 << 13),
        lambda x: np.maximum(x - 0.25, 0) ** 2 + 0.125,
    ),
    "4: a line, then a power": (
        struct.pack(">4xHxx7i", 4, 2 << 16, 1 << 16, 0, 1 << 15, 1 << 15, 1 << 13, 0),
        lambda x: np.where(x >= 0.5, x**2 + 0.125, x / 2),
    ),
}


def profile(curve, to_xyz=SRGB_TO_XYZ, space=b"RGB ", name=b"of a test"):
    """An ICC profile of version 2."""
    colours = [b"XYZ \0\0\0\0" + struct.pack(">3i", *np.round(column * 65536).astype(int)) for column in to_xyz.T]
    white = b"XYZ \0\0\0\0" + struct.pack(">3i", *(round(x * 65536) for x in (0.9642, 1.0, 0.8249)))
    tags = {b"desc": b"desc" + struct.pack(">4xI", len(name) + 1) + name + bytes(79), b"wtpt": white}
    if space == b"GRAY":
        tags |= {b"kTRC": curve}
    elif curve is not None:
        tags |= {b"%cTRC" % c: curve for c in b"rgb"} | {
            b"%cXYZ" % c: one for c, one in zip(b"rgb", colours, strict=True)
        }
    table, body = struct.pack(">I", len(tags)), b""
    for signature, content in tags.items():
        content += bytes(-len(content) % 4)
        table += struct.pack(">4sII", signature, 132 + 12 * len(tags) + len(body), len(content))
        body += content
    header = struct.pack(
        ">I4xI4s4s4s12x4s28x3i",
        132 + len(table) + len(body) - 4,
        0x02100000,
        b"mntr",
        space,
        b"XYZ ",
        b"acsp",
        63190,
        65536,
        54061,
    )
    return header.ljust(128, b"\0") + table + body


def with_profile(path, stored, icc):
    """A picture of 16 bits in a PNG, or of 8 in another format, with a profile."""
    if path.suffix != ".png":
        Image.fromarray(np.round(stored / 257).astype(np.uint8)).save(path, icc_profile=icc, quality=100, subsampling=0)
        return
    write_png(path, np.moveaxis(stored / 65535, -1, 0), bits=16)
    data = path.read_bytes()
    start, end = data[:HEADER_END], data[data.index(b"IDAT") - 4 :]
    gamma = png_chunk(b"gAMA", struct.pack(">I", 45455))
    path.write_bytes(start + gamma + png_chunk(b"iCCP", b"x\0\0" + zlib.compress(icc)) + end)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".jpg"])
def test_a_linear_profile_is_read_as_light(suffix, tmp_path):
    path = tmp_path / f"a{suffix}"
    smooth = np.round(65535 * np.kron(LIGHT, np.ones((8, 8, 1))))
    with_profile(path, smooth, profile(LINEAR))
    bound = {".png": 2e-5, ".tif": 2.1e-3, ".jpg": 0.01}[suffix]
    np.testing.assert_allclose(np.moveaxis(read_picture(path), 0, -1), smooth / 65535, atol=bound)
    assert states_colours(path)
    told = read_picture(path, transfer="srgb")
    assert np.max(np.abs(np.moveaxis(told, 0, -1) - smooth / 65535)) > 0.1, "what the user says goes first"


@pytest.mark.parametrize(("curve", "to_xyz"), [(GAMMA, ADOBE), (SRGB_FORMULA, DISPLAY_P3), (SQUARE_TABLE, SRGB_TO_XYZ)])
def test_it_is_read_as_lcms_converts_it(curve, to_xyz, tmp_path):
    icc, stored = profile(curve, to_xyz), np.random.default_rng(8).integers(60, 190, size=(6, 8, 3)).astype(np.uint8)
    image = Image.fromarray(stored)
    image.save(tmp_path / "a.tif", icc_profile=icc)
    other = ImageCms.profileToProfile(image, ImageCms.ImageCmsProfile(io.BytesIO(icc)), ImageCms.createProfile("sRGB"))
    if to_xyz is SRGB_TO_XYZ:
        found = read_picture(tmp_path / "a.tif")
    else:
        with pytest.warns(RaytraceWarning, match=r"its primaries are others \(of a test\)"):
            found = read_picture(tmp_path / "a.tif")
    inside = np.asarray(other).min(axis=-1) > 0
    assert inside.mean() > 0.5
    off = np.moveaxis(encode_srgb(found).astype(int), 0, -1) - np.asarray(other)
    assert np.max(np.abs(off[inside])) <= 1


@pytest.mark.parametrize("form", FORMULAS)
def test_the_forms_of_a_parametric_curve(form):
    stored, wanted = FORMULAS[form]
    space = read_profile(profile(b"para" + stored))
    encoded = np.linspace(0, 1, 101)[:, None] * np.ones(3)
    np.testing.assert_allclose(space.decode(encoded), wanted(encoded), atol=1e-4)


def test_srgb_and_grey_profiles_are_read(tmp_path):
    of_lcms = ImageCms.ImageCmsProfile(ImageCms.createProfile("sRGB")).tobytes()
    assert read_profile(of_lcms) is None and read_profile(profile(SRGB_FORMULA)) is None
    grey = np.arange(0, 240, 8, dtype=np.uint8).reshape(5, 6)
    Image.fromarray(grey).save(tmp_path / "a.tif", icc_profile=profile(LINEAR, space=b"GRAY"))
    np.testing.assert_allclose(read_picture(tmp_path / "a.tif")[1], grey / 255, atol=1e-6)


@pytest.mark.parametrize(
    ("icc", "words"),
    [
        (profile(None), r"has an ICC profile \(of a test\) that is a table of RGB colours"),
        (profile(LINEAR, space=b"CMYK"), "is a table of CMYK colours"),
        (profile(LINEAR)[:200], "has a broken ICC profile"),
        (b"nonsense", "has a broken ICC profile"),
        (profile(b"para" + struct.pack(">4xHxx3i", 1, 1 << 16, 0, 0)), "has a broken ICC profile"),
    ],
)
@pytest.mark.parametrize("suffix", [".png", ".tif"])
def test_an_unknown_profile_is_refused(suffix, icc, words, tmp_path):
    path = tmp_path / f"a{suffix}"
    with_profile(path, np.round(65535 * LIGHT), icc)
    with pytest.raises(PictureError, match=words):
        read_picture(path)
    found = read_picture(path, transfer="srgb")
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), srgb_to_linear(np.round(65535 * LIGHT) / 65535), atol=5e-3)


def exr_part(light, name="", **header):
    """A part of an OpenEXR file whose header says this, of numbers "height width 3"."""
    channels = {channel: np.ascontiguousarray(light[..., k], np.float32) for k, channel in enumerate("RGB")}
    return OpenEXR.Part({"type": OpenEXR.scanlineimage, **header}, channels, name)


@pytest.mark.parametrize("primaries", [AP0, P3, BT_2020, XYZ])
def test_exr_primaries_keep_the_light(primaries, tmp_path):
    rgb = np.moveaxis(LIGHT, -1, 0)
    stored = LIGHT @ np.linalg.solve(rgb_to_xyz(primaries), rgb_to_xyz(REC_709)).T
    OpenEXR.File([exr_part(stored, chromaticities=primaries)]).write(str(tmp_path / "a.exr"))
    with pytest.warns(RaytraceWarning, match="its light is converted to Rec. 709"):
        found = read_picture(tmp_path / "a.exr")
    np.testing.assert_allclose(found, rgb, atol=2e-6)


def converted(space):
    """The light as OpenImageIO converts it to a space by its id."""
    light = np.ascontiguousarray(LIGHT, np.float32)
    found = oiio.ImageBufAlgo.colorconvert(oiio.ImageBuf(light), "lin_rec709_scene", space)
    assert not found.has_error, found.geterror()
    return found.get_pixels(oiio.FLOAT)


OTHERS = {"chromaticities": BT_2020}
STALE = "and has the chromaticities of others"
CONVERTED = "its primaries are others"


@pytest.mark.parametrize(
    ("space", "header", "words"),
    [
        *((space, {"colorInteropID": space}, [CONVERTED]) for space in LINEAR_SPACES if space != "lin_rec709_scene"),
        ("lin_rec709_scene", {"colorInteropID": "lin_rec709_scene", "chromaticities": REC_709}, []),
        ("lin_rec709_scene", {"colorInteropID": "lin_rec709_scene", **OTHERS}, [STALE]),
        ("lin_ap1_scene", {"colorInteropID": "lin_ap1_scene", **OTHERS}, [STALE, CONVERTED]),
        ("lin_ap0_scene", {"acesImageContainerFlag": 1, "chromaticities": AP0}, [CONVERTED]),
        ("lin_rec2020_scene", {"colorInteropID": "unknown", **OTHERS}, [CONVERTED]),
        ("lin_rec709_scene", {"colorInteropID": "data", **OTHERS}, []),
    ],
)
def test_an_exr_colour_space_id_is_converted(space, header, words, tmp_path, recwarn):
    OpenEXR.File([exr_part(converted(space), **header)]).write(str(tmp_path / "a.exr"))
    found = read_picture(tmp_path / "a.exr")
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), LIGHT, atol=2e-5)
    told = [str(one.message) for one in recwarn if one.category is RaytraceWarning]
    assert len(told) == len(words) and all(word in one for word, one in zip(words, told, strict=True))


def test_each_exr_part_has_its_colour_space(tmp_path):
    first = exr_part(converted("lin_ap1_scene"), "beauty", colorInteropID="lin_ap1_scene")
    others = [exr_part(converted("lin_ap1_scene"), "diffuse"), exr_part(LIGHT, "normal", colorInteropID="data")]
    OpenEXR.File([first, *others]).write(str(tmp_path / "a.exr"))
    for layer in ("beauty", "diffuse"):
        with pytest.warns(RaytraceWarning, match=r"its primaries are others \(lin_ap1_scene\)"):
            found = read_picture(tmp_path / "a.exr", layer=layer)
        np.testing.assert_allclose(np.moveaxis(found, 0, -1), LIGHT, atol=2e-5)
    np.testing.assert_allclose(np.moveaxis(read_picture(tmp_path / "a.exr", layer="normal"), 0, -1), LIGHT, atol=1e-6)


@pytest.mark.parametrize("space", ["srgb_rec709_scene", "g22_ap1_scene", "pq_rec2020_display", "studio:lin_gamut", ""])
@pytest.mark.parametrize("channels", ["RGB", "Y"])
def test_an_exr_of_unknown_light_is_refused(space, channels, tmp_path):
    header = {"type": OpenEXR.scanlineimage, "colorInteropID": space}
    stored = {name: np.full((2, 3), 0.5, np.float32) for name in channels}
    OpenEXR.File(header, stored).write(str(tmp_path / "a.exr"))
    with pytest.raises(PictureError, match=rf"its colours are '{space}' \(colorInteropID\), and linear light"):
        read_picture(tmp_path / "a.exr")


ADOBE_XY = (0.64, 0.33, 0.21, 0.71, 0.15, 0.06)
CODES = np.random.default_rng(10).integers(30, 220, size=(16, 24, 3)).repeat(8, axis=0).repeat(8, axis=1)
CODES = CODES.astype(np.uint8)


@pytest.mark.parametrize(
    ("tags", "primaries"),
    [
        ({319: ADOBE_XY}, (*ADOBE_XY, *REC_709[6:])),
        ({318: (0.3457, 0.3585)}, (*REC_709[:6], 0.3457, 0.3585)),
        ({318: REC_709[6:], 319: REC_709[:6]}, REC_709),
    ],
)
@pytest.mark.parametrize("suffix", [".tif", ".jpg"])
def test_primaries_of_tiff_and_exif_hold(suffix, tags, primaries, tmp_path):
    path, exif = tmp_path / f"a{suffix}", Image.Exif()
    exif.update(tags)
    Image.fromarray(CODES).save(path, exif=exif, quality=100, subsampling=0)
    matrix, light, off = to_rec_709(primaries), DECODERS["srgb"](CODES), 0.05 if suffix == ".jpg" else 2e-5
    told = (
        contextlib.nullcontext() if matrix is None else pytest.warns(RaytraceWarning, match="its primaries are other")
    )
    with told:
        found = read_picture(path)
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), light if matrix is None else light @ matrix.T, atol=off)
    assert states_colours(path) == (suffix == ".jpg" or matrix is not None)
    np.testing.assert_allclose(np.moveaxis(read_picture(path, transfer="srgb"), 0, -1), light, atol=off)


@pytest.mark.parametrize(
    ("tags", "words"),
    [
        ({301: tuple(range(256))}, "has a TransferFunction, which is not read"),
        ({319: b"nonsense"}, "PrimaryChromaticities that are no numbers"),
        ({319: ADOBE_XY[:5]}, "has chromaticities that are none"),
        ({319: (0.3,) * 6}, "has chromaticities that are on one line"),
        ({532: (16, 235, 16, 235, 16, 235)}, r"ReferenceBlackWhite of \[16.*235.*; 0 and 255 are wanted"),
    ],
)
def test_impossible_tiff_colours_are_refused(tags, words, tmp_path):
    types = ImageFileDirectory_v2()
    for tag, value in tags.items():
        types.tagtype[tag] = 7 if isinstance(value, bytes) else 5 if tag in (319, 532) else 3
        types[tag] = value
    Image.fromarray(CODES).save(tmp_path / "a.tif", tiffinfo=types)
    with pytest.raises(PictureError, match=words):
        read_picture(tmp_path / "a.tif")


@pytest.mark.parametrize("levels", [(0, 255) * 3, (0, 255, 128, 255, 128, 255)])
def test_a_full_range_tiff_is_read(levels, tmp_path):
    Image.fromarray(CODES).save(tmp_path / "a.tif", tiffinfo={532: levels})
    np.testing.assert_allclose(np.moveaxis(read_picture(tmp_path / "a.tif"), 0, -1), DECODERS["srgb"](CODES), atol=1e-6)


def test_impossible_primaries_are_refused():
    assert to_rec_709(tuple(round(x, 3) for x in REC_709)) is None
    for broken in ((0.3, 0.3) * 4, (*REC_709[:7], 0.0), (np.nan, *REC_709[1:])):
        with pytest.raises(ValueError, match="has chromaticities that are"):
            rgb_to_xyz(broken)


@pytest.mark.parametrize(
    ("chunks", "to_light"),
    [
        (png_chunk(b"cICP", bytes([12, 13, 0, 1])), "srgb"),
        (png_chunk(b"cICP", bytes([12, 8, 0, 1])), "linear"),
        (
            png_chunk(b"gAMA", struct.pack(">I", 45455))
            + png_chunk(b"cHRM", struct.pack(">8I", *(round(1e5 * x) for x in (*P3[6:], *P3[:6])))),
            "srgb",
        ),
    ],
)
def test_png_primaries_are_converted(chunks, to_light, tmp_path):
    codes = np.random.default_rng(9).integers(40, 220, size=(4, 6, 3)).astype(np.uint8)
    stored = io.BytesIO()
    Image.fromarray(codes).save(stored, "PNG")
    data = stored.getvalue()
    (tmp_path / "a.png").write_bytes(data[:HEADER_END] + chunks + data[HEADER_END:])
    with pytest.warns(RaytraceWarning, match="its primaries are others"):
        found = read_picture(tmp_path / "a.png")
    light = DECODERS["srgb"](codes) if to_light == "srgb" else codes / 255
    np.testing.assert_allclose(np.moveaxis(found, 0, -1), light @ to_rec_709(P3).T, atol=1e-6)
    np.testing.assert_allclose(to_rec_709(P3) @ np.ones(3), 1, atol=1e-6)
