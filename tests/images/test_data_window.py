"""Pictures of which an OpenEXR file stores a part, and headers that tell of more than there is memory for."""

import io
import struct

import numpy as np
import OpenEXR
import pytest
from image_files import CLEAN, RED, jpeg, photo, png_bytes
from PIL import Image
from scenes import assignment_scene, resolved

from raytrace_jax import (
    FitOptions,
    PictureError,
    RaytraceError,
    RaytraceWarning,
    fit,
    load_scene,
    read_exr,
    read_mask,
    read_picture,
    render,
    set_parameters,
)
from raytrace_jax.images.jpeg import jpeg_storage
from raytrace_jax.images.masks import clipped_pixels
from raytrace_jax.inverse.problem.observation import observe

SIZE = (16, 12)
HOLES = np.ones(SIZE[::-1], bool)
HOLES[:7, :10] = False
"""Which pixels are not stored: the data window goes beyond the display window on the left and above, and ends before
it on the right and below."""

ABSENT = "122 of its 192 pixels are not stored"


def store(path, data, display, channels=CLEAN):
    """Write a file with the windows (left, top, right, bottom)."""
    windows = {"dataWindow": data, "displayWindow": display}
    header = {name: (np.array(at[:2], np.int32), np.array(at[2:], np.int32)) for name, at in windows.items()}
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, dict(channels)).write(str(path))
    return path


@pytest.fixture
def part(tmp_path):
    """The path of a picture of 16 x 12 pixels, of which the upper left 10 x 7 are stored."""
    return store(tmp_path / "part.exr", (-3, -2, 9, 6), (0, 0, 15, 11))


def test_what_is_not_stored_has_no_weight(part):
    """As with a mask of one's own, also beside weights and after what counts nothing for other reasons."""
    with pytest.warns(RaytraceWarning, match=f"part.exr: {ABSENT}.*no weight") as told:
        target = read_picture(part)
    assert len(told) == 1 and target.shape == (3, *SIZE[::-1])
    np.testing.assert_array_equal(np.ma.getmaskarray(target), np.broadcast_to(HOLES, target.shape))
    np.testing.assert_array_equal(np.asarray(target)[0, :7, :10], RED[2:, 3:])
    assert not np.any(np.asarray(target)[:, HOLES])  # OpenEXR says black.

    settings, weights = resolved(size=SIZE), np.random.default_rng(0).uniform(0.5, 1, SIZE[::-1])
    for given in (None, weights):
        seen = observe(target, given, assignment_scene(), settings)
        wanted = observe(
            np.asarray(target), np.where(HOLES, 0, 1 if given is None else given), assignment_scene(), settings
        )
        np.testing.assert_array_equal(seen.root_weight, wanted.root_weight)
        np.testing.assert_array_equal(seen.target, wanted.target)
        assert seen.count == 3 * 70
    for how in ("auto", "drop", "keep"):
        assert np.all(clipped_pixels(part, target, how, clamps=False).weights == 1)


SCENE = """
settings main { model physical max_bounces 2 }
camera eye { pixeldim 16 12 viewpoint 0 0 5 lookat 0 0 0 fov 40 }
texture squares { kind checker color1 0.1 0.15 0.25 color2 0.9 0.85 0.8 square 0.5 offset 0.13 0.07 }
material board { emission 1 1 1 texture squares }
material crown { transmission 1 ior 1.5 }
rectangle backdrop { material board center 0 0 -2.5 right 6 0 0 up 0 6 0 }
sphere ball { material crown center 0.12 -0.07 0.15 radius 1 }
"""


@pytest.mark.slow
def test_a_part_of_a_picture_is_fitted(tmp_path):
    """The index is that of the picture, most of which is not stored: as black pixels these made 2.63 of 1.52."""
    (tmp_path / "scene.txt").write_text(SCENE)
    scene = load_scene(tmp_path / "scene.txt")
    image = np.asarray(render(set_parameters(scene, {"crown.ior": 1.52})).image, np.float32)
    colours = {name: np.ascontiguousarray(image[k, 2:10, 3:12]) for k, name in enumerate("RGB")}
    path = store(tmp_path / "a.exr", (3, 2, 11, 9), (0, 0, 15, 11), colours)
    with pytest.warns(RaytraceWarning, match="120 of its 192 pixels"):
        target = read_picture(path)
    result = fit(scene, target, ["crown.ior"], options=FitOptions(edges="point", search=False))
    assert float(result.scene["crown.ior"]) == pytest.approx(1.52, abs=1e-5)


def test_overscan_is_cut_without_a_word(tmp_path):
    path = store(tmp_path / "a.exr", (-3, -2, 9, 6), (0, 0, 8, 5))
    picture = read_picture(path)
    assert not np.ma.isMaskedArray(picture)
    np.testing.assert_array_equal(picture[0], RED[2:8, 3:12])


def test_each_part_has_its_own_window(tmp_path):
    """A pixel counts where all of its colours are stored, and a layer is asked about alone."""
    shown = (np.array([0, 0], np.int32), np.array([12, 8], np.int32))
    parts = []
    for name, first in (("whole", 0), ("left", 2)):
        window = (np.array([first, 0], np.int32), np.array([12, 8], np.int32))
        header = {"type": OpenEXR.scanlineimage, "dataWindow": window, "displayWindow": shown}
        colours = {f"{name}.{channel}": np.ascontiguousarray(pixels[:, first:]) for channel, pixels in CLEAN.items()}
        parts.append(OpenEXR.Part(header, colours, name))
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert not np.ma.isMaskedArray(read_picture(tmp_path / "a.exr", layer="whole"))
    with pytest.warns(RaytraceWarning, match="18 of its 117 pixels"):
        cut = read_picture(tmp_path / "a.exr", layer="left")
    absent = np.ma.getmaskarray(cut)
    assert absent[:, :, :2].all() and not absent[:, :, 2:].any()


def test_a_mask_is_0_where_it_is_not_stored(part):
    weights = read_mask(part)
    assert not np.ma.isMaskedArray(weights) and not weights[HOLES].any() and (weights[~HOLES] > 0).all()
    np.testing.assert_array_equal(read_exr(part).channels["R"] == 0, HOLES)


def test_a_texture_has_to_be_whole(part):
    scene = part.with_name("scene.txt")
    scene.write_text(
        "camera eye { pixeldim 4 3 viewpoint 0 0 5 lookat 0 0 0 }\n"
        f"texture wood {{ kind image file {part.name} }}\n"
        "material board { texture wood }\n"
        "rectangle wall { material board center 0 0 -5 right 1 0 0 up 0 1 0 }\n"
    )
    with pytest.raises(RaytraceError, match=f"scene.txt:2:.*part.exr: {ABSENT}.*a whole picture is wanted"):
        load_scene(scene)


SIDE = 60000
"""Of a picture of 86 GB as light."""


def jpeg_header(**options):
    """A JPEG whose frame says that it is larger."""
    content = bytearray(jpeg(np.zeros((16, 16, 3), np.uint8), **options))
    start = content.find(b"\xff\xc2" if options else b"\xff\xc0") + 5
    content[start : start + 4] = struct.pack(">HH", SIDE, SIDE)
    return bytes(content)


def tiff_header(compression):
    """A TIFF whose tags say that it is wider, higher, and of one strip."""
    file = io.BytesIO()
    Image.new("RGB", (16, 16)).save(file, "TIFF", compression=compression)
    content = bytearray(file.getvalue())
    (start,) = struct.unpack_from("<I", content, 4)
    for tag in range(start + 2, start + 2 + 12 * struct.unpack_from("<H", content, start)[0], 12):
        (number,) = struct.unpack_from("<H", content, tag)
        if number in (256, 257, 278):
            struct.pack_into("<HHII", content, tag, number, 4, 1, SIDE)
    return bytes(content)


HEADERS = {
    "a.png": png_bytes(SIDE, SIDE, 8, 2, [(0, bytes(100))]),
    "grey.png": png_bytes(SIDE, SIDE, 1, 0, [(0, bytes(100))], interlace=1),
    "a.jpg": jpeg_header(),
    "progressive.jpg": jpeg_header(progressive=True),
    "a.tif": tiff_header(None),
    "lzw.tif": tiff_header("tiff_lzw"),
    "a.hdr": b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n\2\2\0\0" % (SIDE, SIDE),
    "a.ppm": b"P6 %d %d 255\n\0\0\0" % (SIDE, SIDE),
    "plain.ppm": b"P3 %d %d 255\n0 0 0" % (SIDE, SIDE),
}


@pytest.fixture
def little(monkeypatch):
    """Let 20 GB be free, whichever machine this is."""
    monkeypatch.setattr("raytrace_jax.util.session.free_memory", lambda: 20_000_000_000)


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_beyond_memory_is_refused(name, little, tmp_path):
    (tmp_path / name).write_bytes(HEADERS[name])
    words = rf"{name}: its picture, 60000 x 60000 pixels, does not fit into memory: it needs about 86.4 GB"
    for reader in (read_picture, read_mask):
        with pytest.raises(PictureError, match=words):
            reader(tmp_path / name)


def test_windows_beyond_memory_are_refused(little, tmp_path):
    """The display window by the file's header alone; the data window too, of which the header is changed by hand."""
    words = ": its {} window, 100000 x 100000 pixels, does not fit into memory"
    shown = store(tmp_path / "shown.exr", (0, 0, 12, 8), (0, 0, 99999, 99999))
    stored = store(tmp_path / "stored.exr", (0, 0, 12, 8), (0, 0, 12, 8))
    content = stored.read_bytes()
    at = content.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    stored.write_bytes(content[:at] + struct.pack("<4i", 0, 0, 99999, 99999) + content[at + 16 :])
    for path, kind in ((shown, "display"), (stored, "data")):
        for reader in (read_exr, read_picture, read_mask):
            with pytest.raises(PictureError, match=path.name + words.format(kind)):
                reader(path)


def test_the_memory_for_light_is_asked_for(monkeypatch, tmp_path):
    """Channels are read into less memory than light takes: of 13 x 9 pixels 1,404 bytes, and 2,808 more."""
    path = store(tmp_path / "a.exr", (0, 0, 12, 8), (0, 0, 12, 8))
    asked = []
    monkeypatch.setattr("raytrace_jax.images.picture_file.lack_of_memory", lambda needed: asked.append(needed) or "")
    read_exr(path)
    assert max(asked) == 1404
    read_picture(path)
    assert max(asked) == 2808


def test_large_jpegs_are_no_bombs(monkeypatch, tmp_path):
    """Pillow's own limit, which is less than memory, is not asked."""
    monkeypatch.setattr(Image, "MAX_IMAGE_PIXELS", 100)
    path = photo(tmp_path / "a.jpg")
    assert jpeg_storage(path) is not None and read_picture(path).shape == (3, 32, 48)
