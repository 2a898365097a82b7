import math

import hypothesis.extra.numpy as hnp
import jax.numpy as jnp
import numpy as np
import OpenEXR
import pytest
from hypothesis import given
from hypothesis import strategies as st
from image_files import BLUE, CLEAN, DEPTH, GREEN, RED

from raytrace_jax import PictureError, read_exr, read_picture, write_exr

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=5,
)
SHAPES = hnp.array_shapes(min_dims=2, max_dims=2, max_side=20)


def floats(dtype):
    """Without both limits hypothesis draws doubles and throws away those that are too large."""
    end = float(np.finfo(dtype).max)
    return st.floats(-end, end, width=np.finfo(dtype).bits)


@given(
    pixels=hnp.arrays(np.float32, SHAPES, elements=floats(np.float32)),
    metadata=st.dictionaries(st.text(), JSON, max_size=3),
)
def test_floats_and_metadata_survive_exactly(tmp_path_factory, pixels, metadata):
    path = tmp_path_factory.getbasetemp() / "round_trip.exr"
    write_exr(path, {"R": pixels, "d.vitreous.ior.R": -pixels}, metadata=metadata)
    picture = read_exr(path)
    assert list(picture.channels) == ["R", "d.vitreous.ior.R"]
    assert picture.channels["R"].tobytes() == pixels.tobytes()
    assert picture.channels["d.vitreous.ior.R"].tobytes() == (-pixels).tobytes()
    assert picture.metadata == metadata
    assert picture.compression == "ZIP"


@given(pixels=hnp.arrays(np.float16, SHAPES, elements=floats(np.float16)))
def test_halfs_come_back_exactly(tmp_path_factory, pixels):
    path = tmp_path_factory.getbasetemp() / "half.exr"
    write_exr(path, {"R": pixels}, half=True)
    np.testing.assert_array_equal(read_exr(path).channels["R"], pixels)


@pytest.mark.parametrize("dtype", [np.float64, np.float16, np.int32, np.uint8, np.bool_, jnp.bfloat16, jnp.float32])
def test_takes_every_real_type(tmp_path, dtype):
    values = jnp.array([[0, 1, 1], [1, 0, 1]], dtype) if dtype is jnp.bfloat16 else np.eye(2, 3, dtype=dtype)
    write_exr(tmp_path / "a.exr", {"Y": values})
    stored = read_exr(tmp_path / "a.exr").channels["Y"]
    assert stored.dtype == np.float32
    np.testing.assert_array_equal(stored, np.asarray(values, np.float32))


def test_takes_views_of_any_strides(tmp_path):
    views = {"R": RED.T, "G": GREEN.T[::-1, ::-1], "B": np.broadcast_to(BLUE[0, :, None], (13, 9))}
    write_exr(tmp_path / "a.exr", views)
    np.testing.assert_array_equal(read_picture(tmp_path / "a.exr"), np.stack(list(views.values())))


def test_other_programs_read_the_file(tmp_path):
    write_exr(tmp_path / "a.exr", {**CLEAN, "depth.Z": DEPTH})
    (part,) = OpenEXR.File(str(tmp_path / "a.exr"), separate_channels=True).parts
    assert part.type() == OpenEXR.scanlineimage
    assert part.compression() == OpenEXR.ZIP_COMPRESSION
    assert part.header["software"] == "raytrace_jax"
    assert sorted(part.channels) == ["B", "G", "R", "depth.Z"]
    np.testing.assert_array_equal(part.channels["R"].pixels[0], RED[0])


def test_metadata_takes_array_numbers(tmp_path):
    metadata = {
        "ior": np.float64(1.337),
        "seed": np.int64(2**53 + 1),
        "center": jnp.arange(3),
        "nested": {"pi": math.pi},
    }
    write_exr(tmp_path / "a.exr", CLEAN, metadata=metadata)
    wanted = {"ior": 1.337, "seed": 2**53 + 1, "center": [0, 1, 2], "nested": {"pi": math.pi}}
    assert read_exr(tmp_path / "a.exr").metadata == wanted


@pytest.mark.parametrize(
    ("channels", "options", "words"),
    [
        ({}, {}, "not no channels"),
        ({"R": RED, "G": GREEN[:3]}, {}, r"one shape are wanted, not R \(9, 13\), G \(3, 13\)"),
        ({"R": -np.inf * np.ones((2, 2))}, {}, "channel R has 4 pixels that are NaN, infinite or masked"),
        (np.ma.masked_equal(np.ones((3, 2, 2), int), 1), {}, "channel R has 4 pixels that are NaN, infinite or masked"),
        ({"R": RED.astype(object)}, {}, "channel R is an array of the dtype object, and real numbers are wanted"),
        ({"R": np.full((2, 2), -70000.0)}, {"half": True}, "channel R reaches 70000, and half ends at 65504"),
        ({"R": np.full((2, 2), 1e39)}, {}, "channel R reaches 1e.39, and half ends at"),
        ({"RGB": np.zeros((2, 2, 3))}, {}, r"channel RGB has the shape \(2, 2, 3\)"),
        (np.zeros((4, 2, 2)), {}, r"\(3, height, width\) or channels .* not ndarray of shape \(4, 2, 2\)"),
        (None, {}, "this is an array of the dtype object, and real numbers are wanted"),
        ({"": RED}, {}, "'' is not a channel name"),
        (CLEAN, {"metadata": {"ior": math.nan}}, "cannot be stored as JSON"),
        (CLEAN, {"metadata": {"path": object()}}, "JSON cannot hold <object"),
    ],
)
def test_refuses_what_the_file_cannot_hold(tmp_path, channels, options, words):
    path = tmp_path / "a.exr"
    with pytest.raises(PictureError, match=words) as caught:
        write_exr(path, channels, **options)
    assert str(caught.value).startswith(f"{path}: cannot be written")
    assert not list(tmp_path.iterdir())


def test_failed_writing_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "a.exr"
    write_exr(path, CLEAN)

    def write_half(self, file):
        file.write(b"half")
        raise RuntimeError("Failed to write pixel data. No space left on device.")

    monkeypatch.setattr(OpenEXR.File, "write", write_half)
    with pytest.raises(PictureError, match=f"{path}: cannot be written: .* No space left on device"):
        write_exr(path, {"R": RED})
    monkeypatch.undo()
    assert sorted(read_exr(path).channels) == ["B", "G", "R"]
    assert list(tmp_path.iterdir()) == [path]
