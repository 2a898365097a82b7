"""Files as Blender, Mitsuba and others write them, and files that are broken."""

import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_files import BLUE, CLEAN, DEPTH, GREEN, RED

from raytrace_jax import PictureError, RaytraceWarning, read_exr, read_picture

RANDOM = np.random.default_rng(0)
NAN = np.where(np.arange(117).reshape(9, 13) == 28, np.nan, RED)


def window(left, top, right, bottom):
    return np.array([left, top], np.int32), np.array([right, bottom], np.int32)


def store(path, channels, **header):
    """Write a file as other programs do: with a header of choice."""
    # A copy, since OpenEXR puts its own objects into the dictionary.
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)).write(str(path))
    return path


def store_parts(path, parts, **header):
    made = [
        OpenEXR.Part({"type": OpenEXR.scanlineimage, **header}, dict(channels), name)
        for name, channels in parts.items()
    ]
    OpenEXR.File(made).write(str(path))
    return path


def colours(layer):
    return {f"{layer}.{name}": pixels for name, pixels in CLEAN.items()}


@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "ZSTD", "B44", "B44A", "HTJ2K256"])
@pytest.mark.parametrize("storage", [OpenEXR.scanlineimage, OpenEXR.tiledimage])
def test_reads_lossless_foreign_files(tmp_path, compression, storage):
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": storage}
    if storage == OpenEXR.tiledimage:
        header["tiles"] = OpenEXR.TileDescription()
    store(tmp_path / "a.exr", CLEAN, **header)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), np.stack([RED, GREEN, BLUE]))
    assert read_exr(tmp_path / "a.exr").compression == compression


@pytest.mark.parametrize(
    ("compression", "dtype", "is_lossy"),
    [
        *((name, dtype, True) for name in ("DWAA", "DWAB", "LJ2K") for dtype in (np.float16, np.float32)),
        *(("B44", np.float16, True), ("B44A", np.float16, True), ("PXR24", np.float32, True)),
        *(("B44", np.float32, False), ("B44A", np.float32, False), ("PXR24", np.float16, False)),
    ],
)
def test_warns_only_of_lossy_compression(tmp_path, compression, dtype, is_lossy):
    pixels = RANDOM.random((64, 64)).astype(dtype)
    path = store(
        tmp_path / "a.exr",
        {"R": pixels, "G": pixels, "B": pixels},
        compression=getattr(OpenEXR, f"{compression}_COMPRESSION"),
    )
    if is_lossy:
        with pytest.warns(RaytraceWarning, match=f"lossy compression {compression}"):
            stored = read_picture(path)
    else:
        stored = read_picture(path)
    assert np.array_equal(stored[0], pixels) is not is_lossy


def test_reads_halfs_and_unsigned_integers(tmp_path):
    identifiers = np.array([[2**32 - 1, 7]], np.uint32)
    half = np.array([[65504, 6e-8]], np.float16)
    channels = read_exr(store(tmp_path / "a.exr", {"id": identifiers, "R": half})).channels
    assert channels["id"].dtype == np.uint32
    np.testing.assert_array_equal(channels["id"], identifiers)
    assert channels["R"].dtype == np.float32
    np.testing.assert_array_equal(channels["R"], half)


coordinates = st.integers(-6, 6)


@given(
    data=st.tuples(coordinates, coordinates),
    display=st.tuples(coordinates, coordinates, st.integers(1, 12), st.integers(1, 12)),
)
def test_pixels_land_in_the_display_window(tmp_path_factory, data, display):
    """Each pixel of the answer is looked up by its coordinates."""
    data_left, data_top = data
    left, top, width, height = display
    path = store(
        tmp_path_factory.getbasetemp() / "window.exr",
        {"R": RED},
        dataWindow=window(data_left, data_top, data_left + 12, data_top + 8),
        displayWindow=window(left, top, left + width - 1, top + height - 1),
    )
    wanted = np.zeros((height, width), np.float32)
    overlaps = False
    for y in range(height):
        for x in range(width):
            row, column = y + top - data_top, x + left - data_left
            if 0 <= row < 9 and 0 <= column < 13:
                wanted[y, x] = RED[row, column]
                overlaps = True
    if overlaps:
        np.testing.assert_array_equal(read_exr(path).channels["R"], wanted)
    else:
        with pytest.raises(PictureError, match="outside of its display window"):
            read_exr(path)


def test_blender_part_names_are_read(tmp_path):
    parts = {"ViewLayer.Combined": colours("ViewLayer.Combined"), "ViewLayer.Depth": {"ViewLayer.Depth.Z": DEPTH}}
    path = store_parts(tmp_path / "a.exr", parts)
    assert len(read_exr(path).channels) == 4
    np.testing.assert_array_equal(read_picture(path), np.stack([RED, GREEN, BLUE]))
    assert list(read_exr(path, layer="Depth").channels) == ["ViewLayer.Depth.Z"]


def test_same_names_get_the_name_of_the_part(tmp_path):
    left, right = {**CLEAN, "A": DEPTH}, {"R": BLUE, "G": GREEN, "B": RED}
    path = store_parts(tmp_path / "a.exr", {"left": left, "right": right, "depth": {"Z": DEPTH}})
    names = ["left.A", "left.B", "left.G", "left.R", "right.B", "right.G", "right.R", "Z"]
    assert sorted(read_exr(path).channels) == sorted(names)
    np.testing.assert_array_equal(read_picture(path, layer="right"), np.stack([BLUE, GREEN, RED]))
    with pytest.raises(PictureError, match=r"name it; its layers are '' \(Z\); 'left' .*; 'right'"):
        read_picture(path)


@pytest.mark.parametrize(
    ("channels", "layer", "wanted"),
    [
        ({**CLEAN, **colours("albedo")}, None, "RGB"),
        ({**colours("img"), "dd.T": DEPTH, "nn.X": RED, "nn.Y": RED, "nn.Z": RED}, None, "img.RGB"),
        ({**colours("img"), **colours("albedo")}, "albedo", "albedo.RGB"),
        ({**colours("ViewLayer.Combined"), **colours("ViewLayer.Diffuse")}, None, "ViewLayer.Combined.RGB"),
        ({**colours("ViewLayer.Combined"), **colours("ViewLayer.Diffuse")}, "Diffuse", "ViewLayer.Diffuse.RGB"),
        ({"Y": DEPTH, "A": RED, **colours("normal")}, None, "YYY"),
        ({"mask.Y": DEPTH, "n.X": RED, "n.Y": RED, "n.Z": RED}, None, "mask.YYY"),
    ],
)
def test_picks_the_obvious_layer(tmp_path, channels, layer, wanted):
    # Every channel gets a value of its own, so that a wrong one is noticed.
    numbered = {name: np.full((2, 3), number, np.float32) for number, name in enumerate(channels)}
    path = store(tmp_path / "a.exr", numbered)
    prefix, components = wanted[:-3], wanted[-3:]
    np.testing.assert_array_equal(read_picture(path, layer=layer), [numbered[prefix + name] for name in components])


@pytest.mark.parametrize(
    ("channels", "layer", "words"),
    [
        (
            {**colours("img"), **colours("albedo")},
            None,
            r"is wanted: name it; its layers are 'albedo' \(B, G, R\); 'img'",
        ),
        ({**colours("a.Combined"), **colours("b.Combined")}, None, "its layers are 'a.Combined' .*; 'b.Combined'"),
        (
            {**colours("a.Combined"), **colours("b.Combined")},
            "Combined",
            "not one layer 'Combined'; its layers are 'a.Combined', 'b.Combined'",
        ),
        ({**CLEAN, **colours("albedo")}, "albdo", "layer 'albdo'; its layers are '', 'albedo'. Did you mean 'albedo'"),
        ({"R": RED, "G": GREEN}, None, r"one layer with the channels R, G, B or a grey Y is wanted.* '' \(G, R\)"),
        ({**CLEAN, "depth.Z": DEPTH}, "depth", r"R, G, B or a grey Y is wanted.*'depth' \(Z\)"),
        ({"n.X": RED, "n.Y": RED, "n.Z": RED}, None, r"'n' \(X, Y, Z\)"),
        ({**CLEAN, "G": NAN.astype(np.float32)}, None, "used as a picture: channel G has 1 pixels that are NaN"),
    ],
)
def test_refuses_to_guess(tmp_path, channels, layer, words):
    path = store(tmp_path / "a.exr", channels)
    with pytest.raises(PictureError, match=words) as caught:
        read_picture(path, layer=layer)
    assert str(caught.value).startswith(f"{path}: ")


def test_keeps_infinite_depths(tmp_path):
    path = store(tmp_path / "a.exr", {**CLEAN, "depth.Z": np.full((9, 13), np.inf, np.float32)})
    assert np.isinf(read_exr(path).channels["depth.Z"]).all()
    assert read_picture(path).shape == (3, 9, 13)


@pytest.mark.parametrize("keep", [0, 3, 4, 8, 100, 0.3, 0.5, 0.9, -1])
@pytest.mark.parametrize("kind", ["scanlines", "tiles", "parts"])
def test_refuses_truncated_files(tmp_path, kind, keep, capsys):
    path, noise = tmp_path / "a.exr", RANDOM.random((100, 100), np.float32)
    if kind == "parts":
        store_parts(path, {"one": {"R": noise}, "two": {"Z": noise}})
    elif kind == "tiles":
        store(path, {"R": noise}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())
    else:
        store(path, {"R": noise})
    whole = path.read_bytes()
    path.write_bytes(whole[: int(keep * len(whole)) if isinstance(keep, float) else keep])
    with pytest.raises(PictureError, match=r"truncated|first bytes differ") as caught:
        read_exr(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)
    assert capsys.readouterr().out == ""


def test_refuses_broken_pixels(tmp_path):
    path = store(tmp_path / "a.exr", {"R": RANDOM.random((100, 100), np.float32)})
    whole = bytearray(path.read_bytes())
    whole[-2000:-1000] = bytes(1000)
    path.write_bytes(whole)
    with pytest.raises(PictureError, match="truncated or broken"):
        read_exr(path)


def test_refuses_deep_pixels(tmp_path):
    deep = np.empty((2, 3), object)
    for index in np.ndindex(deep.shape):
        deep[index] = np.ones(2, np.float32)
    store(tmp_path / "a.exr", {"R": deep}, type=OpenEXR.deepscanline, compression=OpenEXR.ZIPS_COMPRESSION)
    with pytest.raises(PictureError, match="deep pixels"):
        read_exr(tmp_path / "a.exr")


def test_refuses_subsampled_channels(tmp_path):
    path = store(tmp_path / "a.exr", {"Y": np.ones((4, 4), np.float32)})
    full, halved = (step.to_bytes(4, "little") * 2 for step in (1, 2))
    content = path.read_bytes()
    place = content.index(full, content.index(b"chlist"))
    path.write_bytes(content[:place] + halved + content[place + 8 :])
    with pytest.raises(PictureError, match="channel Y is subsampled"):
        read_exr(path)


def test_luminance_with_chroma_is_not_grey(tmp_path):
    with pytest.raises(PictureError, match="R, G, B or a grey Y is wanted"):
        read_picture(store(tmp_path / "a.exr", {"Y": RED, "RY": GREEN, "BY": BLUE}))


@pytest.mark.parametrize("stored", ["not JSON", "[1]", 7])
def test_broken_metadata_is_ignored(tmp_path, stored):
    path = store(tmp_path / "a.exr", CLEAN, raytrace_jax=stored)
    with pytest.warns(RaytraceWarning, match="is not a JSON object"):
        assert read_exr(path).metadata == {}
