import io
import json
import struct
import zlib

import hypothesis.extra.numpy as hnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_files import SIGNATURE, chunk, png_bytes
from PIL import Image

import raytrace_jax
from raytrace_jax import PictureError, RaytraceWarning, read_mask, read_picture, write_exr, write_png
from raytrace_jax.images.pictures import states_colours
from raytrace_jax.images.png import PngFile
from raytrace_jax.images.transfer import decode_course, decode_srgb, encode_course, encode_srgb

RANDOM = np.random.default_rng(0)
RGB = RANDOM.random((3, 9, 13))
SHAPES = st.tuples(st.just(3), st.integers(1, 9), st.integers(1, 9))


def pillow_bytes(array, mode=None, **options):
    file = io.BytesIO()
    image = Image.fromarray(array)
    (image.convert(mode) if mode else image).save(file, "PNG", **options)
    return file.getvalue()


def read_png(path, transfer=None):
    return PngFile(path).light(transfer)


@pytest.fixture
def stored(tmp_path):
    def store(content):
        path = tmp_path / "a.png"
        path.write_bytes(content)
        return path

    return store


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(("encode", "decode"), [(encode_course, decode_course), (encode_srgb, decode_srgb)])
def test_stored_numbers_survive_a_round_trip(bits, encode, decode):
    numbers = np.arange(2**bits, dtype=f"u{bits // 8}")
    np.testing.assert_array_equal(encode(decode(numbers).astype(np.float32), bits=bits), numbers)


def test_course_encoding_truncates():
    colours = np.array([-1.0, 0.0, 0.9999 / 255, 1 / 255, 0.5, 254.99 / 255, 1.0, 7.0])
    np.testing.assert_array_equal(encode_course(colours), [0, 0, 0, 1, 127, 254, 255, 255])


def test_course_decoding_is_unbiased():
    colours = RANDOM.uniform(1 / 255, 1, 100_000)
    error = decode_course(encode_course(colours)) - colours
    step = 1 / 255
    assert abs(error).max() <= 0.5001 * step
    # A uniform error has the deviation step / sqrt(12); five standard errors of its mean.
    assert abs(error.mean()) < 5 * step / np.sqrt(12 * colours.size)
    np.testing.assert_array_equal(decode_course(np.array([0, 255], np.uint8)), [0, 1])


def test_srgb_has_the_values_of_the_standard():
    # Middle grey 0.18 is stored as 0.4614, and the toe is linear (IEC 61966-2-1).
    np.testing.assert_array_equal(encode_srgb([0.18, 0.0, 1.0, 0.0031308]), [118, 0, 255, 10])
    np.testing.assert_allclose(decode_srgb(np.array([10, 128], np.uint8)), [10 / 255 / 12.92, 0.2158605], rtol=1e-6)


@given(
    rgb=hnp.arrays(np.float64, SHAPES, elements=st.floats(-0.5, 1.5)),
    bits=st.sampled_from([8, 16]),
    transfer=st.sampled_from(["course", "srgb"]),
)
def test_pictures_come_back_within_a_step(tmp_path_factory, rgb, bits, transfer):
    path = tmp_path_factory.getbasetemp() / "round_trip.png"
    write_png(path, rgb, transfer=transfer, bits=bits)
    back = read_png(path, transfer=transfer)
    assert back.dtype == np.float32
    encode = {"course": encode_course, "srgb": encode_srgb}[transfer]
    np.testing.assert_array_equal(encode(back, bits=bits), encode(rgb, bits=bits))


def test_reads_every_8_bit_kind(stored):
    red, grey = np.full((2, 3, 3), [255, 0, 51], np.uint8), np.full((2, 3), 51, np.uint8)
    opaque = np.full((2, 3, 1), 255, np.uint8)
    wanted_red, wanted_grey = np.array([1, 0, 51.5 / 255]), np.full(3, 51.5 / 255)
    kinds = [
        (pillow_bytes(red), wanted_red),
        (pillow_bytes(np.concatenate([red, opaque], axis=-1)), wanted_red),
        (pillow_bytes(red, "P"), wanted_red),
        (pillow_bytes(grey), wanted_grey),
        (pillow_bytes(grey, "LA"), wanted_grey),
        (pillow_bytes(np.full((2, 3), True)), np.ones(3)),
        (png_bytes(3, 2, 4, 0, [(0, b"\x33\x30")] * 2), wanted_grey),
        (png_bytes(3, 2, 8, 2, [], interlace=1, raw=adam7_rows()), wanted_red),
    ]
    for content, wanted in kinds:
        picture = read_png(stored(content), transfer="course")
        np.testing.assert_array_equal(picture, np.broadcast_to(wanted[:, None, None], (3, 2, 3)).astype(np.float32))


def adam7_rows():
    """The interlaced rows of 3 x 2 equal pixels: passes 1 (1 pixel), 4 (none), 5 (none), 6 (1 x 1), 7 (3 x 1)."""
    pixel = bytes([255, 0, 51])
    return b"\0" + pixel + b"\0" + pixel + b"\0" + pixel + b"\0" + pixel * 3


@pytest.mark.parametrize(("colour_type", "samples"), [(0, 1), (2, 3), (4, 2), (6, 4)])
def test_reads_every_16_bit_kind(stored, colour_type, samples):
    pixels = RANDOM.integers(0, 65536, (5, 4, samples), np.uint16)
    if samples in (2, 4):
        pixels[..., -1] = 65535
    content = png_bytes(4, 5, 16, colour_type, [(0, row.astype(">u2").tobytes()) for row in pixels])
    wanted = decode_course(pixels[..., :3] if samples > 2 else np.repeat(pixels[..., :1], 3, axis=-1))
    picture = read_png(stored(content), transfer="course")
    np.testing.assert_array_equal(picture, np.moveaxis(wanted, -1, 0).astype(np.float32))


@pytest.mark.parametrize(
    ("rgb", "options", "words"),
    [
        (RGB[0], {}, r"shape is \(9, 13\), and \(3, height, width\) is wanted"),
        (np.zeros((3, 0, 4)), {}, r"shape is \(3, 0, 4\)"),
        (np.full((3, 1, 1), np.nan), {}, "3 of its numbers are NaN, infinite or masked"),
        (np.ma.masked_less(RGB, RGB.max()), {}, f"{RGB.size - 1} of its numbers are NaN, infinite or masked"),
        (RGB.astype(str), {}, "the picture is an array of the dtype <U"),
        (dict(zip("RGB", RGB.astype(object), strict=True)), {}, "the picture is an array of the dtype object"),
        (RGB, {"transfer": "gamma"}, "no transfer 'gamma' with 8 bits; there are the transfers course and srgb"),
        (RGB, {"bits": 12}, "no transfer 'course' with 12 bits; there are .* 8 and 16 bits"),
    ],
)
def test_refuses_to_write(tmp_path, rgb, options, words):
    with pytest.raises(PictureError, match=words):
        write_png(tmp_path / "a.png", rgb, **options)
    assert not list(tmp_path.iterdir())


GREY16 = [(0, b"\x12\x34" * 3)]
WHOLE = pillow_bytes(RANDOM.integers(0, 256, (20, 20, 3), np.uint8))
WHOLE16 = png_bytes(20, 20, 16, 2, [(0, RANDOM.bytes(120)) for _ in range(20)])


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty"),
        (b"GIF89a", "first bytes differ"),
        (SIGNATURE, "truncated"),
        (SIGNATURE + chunk(b"IEND", b""), "has no header"),
        (WHOLE.replace(b"IDAT", b"IDAX"), "checksum of its 'IDAX' chunk is wrong"),
        (WHOLE[:-30] + b"\0" + WHOLE[-29:], "checksum of its 'IDAT' chunk is wrong"),
        (png_bytes(0, 2, 8, 0, []), "cannot be read"),
        (png_bytes(1, 1, 16, 3, GREY16), "cannot be read"),
        (png_bytes(20000, 20000, 1, 0, [(0, bytes(2500))] * 9), "some of its pixels are missing"),
        (png_bytes(3, 2, 16, 0, GREY16), "truncated PNG file: some of its pixels are missing"),
        (png_bytes(3, 1, 16, 0, [(5, b"abcdef")]), "cannot be read"),
        (png_bytes(3, 1, 16, 0, GREY16, extra=chunk(b"tRNS", b"\x12\x34")), "one of its colours transparent"),
        (png_bytes(2, 1, 16, 4, [(0, b"\0\1\xff\xff\0\1\xff\xfe")]), "1 of its pixels are transparent"),
        (png_bytes(2, 1, 8, 0, [(0, b"\1\2")], extra=chunk(b"tRNS", b"\0\1")), "1 of its pixels are transparent"),
        (SIGNATURE + WHOLE16[8:33] + chunk(b"IDAT", b"no zlib") + chunk(b"IEND", b""), "cannot be decompressed"),
    ],
)
def test_refuses_to_read(stored, content, words):
    path = stored(content)
    with pytest.raises(PictureError, match=words) as caught:
        read_png(path, transfer="course")
    assert str(caught.value).startswith(f"{path}: ")


@pytest.mark.parametrize("whole", [WHOLE, WHOLE16])
def test_refuses_every_truncation(stored, whole):
    for length in [*range(1, 70, 3), *range(70, len(whole), 97), len(whole) - 1]:
        with pytest.raises(PictureError, match=r"truncated|first bytes differ"):
            read_png(stored(whole[:length]), transfer="course")


@pytest.mark.parametrize("bits", [8, 16])
def test_metadata_is_json_that_others_see(bits, tmp_path):
    metadata = {"scene": "camera eye { … }", "size": np.array([4, 3])}
    write_png(tmp_path / "a.png", RGB, bits=bits, metadata=metadata)
    with Image.open(tmp_path / "a.png") as image:
        image.load()
        assert json.loads(image.info["raytrace_jax"]) == {"scene": "camera eye { … }", "size": [4, 3]}
    np.testing.assert_allclose(read_png(tmp_path / "a.png"), RGB, atol=1 / 255)
    with pytest.raises(PictureError, match=r"b\.png: cannot be written: the metadata cannot be stored as JSON"):
        write_png(tmp_path / "b.png", RGB, metadata={"scene": object()})


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("transfer", ["course", "srgb"])
def test_a_written_png_says_how_it_is_read(transfer, bits, tmp_path):
    path = tmp_path / "a.png"
    write_png(path, RGB, transfer=transfer, bits=bits)
    assert states_colours(path)
    np.testing.assert_array_equal(read_picture(path), read_png(path, transfer=transfer))
    encode = {"course": encode_course, "srgb": encode_srgb}[transfer]
    with Image.open(path) as image:
        image.load()
        # Pillow keeps the upper 8 of 16 bits.
        np.testing.assert_array_equal(np.asarray(image), np.moveaxis(encode(RGB, bits=bits) >> (bits - 8), 0, -1))
        assert image.info["gamma"] == (0.45455 if transfer == "srgb" else 1.0)
        assert image.info.get("srgb") == (0 if transfer == "srgb" else None)
        assert image.info["Software"] == f"raytrace-jax {raytrace_jax.__version__}"


LEVELS = np.arange(0, 256, 5, np.uint8).reshape(4, 13, 1).repeat(3, axis=2)
GAMMA_22, SRGB = chunk(b"gAMA", struct.pack(">I", 45000)), chunk(b"sRGB", b"\0")


@pytest.mark.parametrize(
    ("said", "decode"),
    [
        (b"", decode_course),
        (SRGB, decode_srgb),
        (chunk(b"gAMA", struct.pack(">I", 45455)), decode_srgb),
        (GAMMA_22, lambda stored: (stored / 255) ** (1 / 0.45)),
        (chunk(b"gAMA", struct.pack(">I", 100000)), lambda stored: stored / 255),
        (chunk(b"cICP", bytes([1, 8, 0, 1])) + SRGB, lambda stored: stored / 255),
        (chunk(b"cICP", bytes([1, 13, 0, 1])), decode_srgb),
        (chunk(b"gAMA", bytes(4)), decode_course),
    ],
)
def test_foreign_colour_chunks_are_obeyed(said, decode, stored):
    whole = pillow_bytes(LEVELS)
    path = stored(whole[:33] + said + whole[33:])
    wanted = np.moveaxis(decode(LEVELS), -1, 0).astype(np.float32)
    np.testing.assert_array_equal(read_png(path), wanted)
    np.testing.assert_array_equal(read_png(path, transfer="srgb"), np.moveaxis(decode_srgb(LEVELS), -1, 0).astype("f4"))
    assert states_colours(path) == (decode is not decode_course)


def test_what_is_no_scene_light_is_refused(stored):
    whole = pillow_bytes(LEVELS)
    path = stored(whole[:33] + chunk(b"cICP", bytes([9, 16, 0, 1])) + whole[33:])
    with pytest.raises(PictureError, match="its primaries are 9 and its transfer is 16"):
        read_png(path)
    np.testing.assert_array_equal(read_png(path, transfer="srgb"), np.moveaxis(decode_srgb(LEVELS), -1, 0).astype("f4"))


@pytest.mark.parametrize("cicp", [(1, 13, 0, 0), (1, 13, 1, 1), (9, 8, 9, 0), (1, 13, 0), (1, 8, 0, 1, 0)])
@pytest.mark.parametrize("read", [read_png, lambda path: read_picture(path, transfer="srgb"), read_mask])
def test_narrow_range_and_ycbcr_are_refused(cicp, read, stored):
    whole = pillow_bytes(LEVELS)
    path = stored(whole[:33] + chunk(b"cICP", bytes(cicp)) + whole[33:])
    with pytest.raises(PictureError, match=r"says by cICP that its numbers are \(.*RGB of the full range"):
        read(path)


def test_an_animation_gives_its_first_frame(tmp_path):
    first, second = (Image.fromarray(np.full((2, 3, 3), value, np.uint8)) for value in (51, 255))
    first.save(tmp_path / "a.png", save_all=True, append_images=[second])
    with pytest.warns(RaytraceWarning, match="is animated, and only its first picture is read"):
        np.testing.assert_array_equal(read_png(tmp_path / "a.png"), np.full((3, 2, 3), np.float32(51.5 / 255)))


def test_bad_transfers_and_files_are_refused(tmp_path):
    write_png(tmp_path / "a.png", RGB)
    with pytest.raises(PictureError, match="no transfer 'linear'"):
        read_png(tmp_path / "a.png", transfer="linear")
    with pytest.raises(PictureError, match=r"no such file; did you mean a\.png"):
        read_png(tmp_path / "b.png", transfer="course")


def test_read_picture_looks_at_the_contents(tmp_path):
    rgb = RGB.astype(np.float32)
    write_exr(tmp_path / "exr.png", {f"img.{name}": pixels for name, pixels in zip("RGB", rgb, strict=True)})
    np.testing.assert_array_equal(read_picture(tmp_path / "exr.png", layer="img"), rgb)
    for transfer in ("course", "srgb"):
        write_png(tmp_path / "png.exr", rgb, transfer=transfer, bits=16)
        np.testing.assert_allclose(read_picture(tmp_path / "png.exr", transfer=transfer), rgb, atol=2e-5)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "is empty, and an OpenEXR"),
        (
            b"camera main {",
            r"of an unknown format \(it starts with b'came'\), and an OpenEXR .*, PNG, JPEG, TIFF, PPM or",
        ),
    ],
)
def test_read_picture_says_what_came(stored, content, words):
    with pytest.raises(PictureError, match=words):
        read_picture(stored(content))


TURNED = Image.Exif()
TURNED[0x0112] = 6
EXIF = TURNED.tobytes().removeprefix(b"Exif\0\0")
RAW_PROFILE = b"\nexif\n%8d\n" % (len(EXIF) + 6) + (b"Exif\0\0" + EXIF).hex().encode() + b"\n"


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize(
    ("part", "place"),
    [
        (chunk(b"eXIf", EXIF), 33),
        (chunk(b"eXIf", EXIF), -12),
        (chunk(b"zTXt", b"Raw profile type exif\0\0" + zlib.compress(RAW_PROFILE)), 33),
    ],
    ids=["before the pixels", "behind the pixels", "as ImageMagick wrote it"],
)
def test_exif_turns_a_png_and_a_mask(bits, part, place, tmp_path):
    light = np.random.default_rng(3).uniform(0.1, 0.9, (3, 4, 6))
    write_png(tmp_path / "a.png", light, bits=bits)
    plain, mask = read_picture(tmp_path / "a.png"), read_mask(tmp_path / "a.png")
    data = (tmp_path / "a.png").read_bytes()
    (tmp_path / "a.png").write_bytes(data[:place] + part + data[place:])
    for read, unturned in ((read_picture, plain), (read_mask, mask)):
        np.testing.assert_array_equal(read(tmp_path / "a.png"), np.rot90(unturned, -1, (-2, -1)))
