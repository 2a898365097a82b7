"""TIFFs of all layouts are read to the last step, whichever number is white, or refused: none is read wrongly."""

import struct
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from raytrace_jax import PictureError, read_picture
from raytrace_jax.images.transfer import srgb_to_linear

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
def test_a_tiff_is_read_to_its_last_step_or_refused(
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


@pytest.mark.parametrize(("photometric", "words"), [(8, "its colours are CIE"), (32803, "is a raw file of a camera")])
def test_colours_that_are_no_light_are_refused(photometric, words, tmp_path):
    codes = np.random.default_rng(0).integers(0, 256, size=(HEIGHT, WIDTH, 3))
    how = {"white_is_zero": False, "predictor": 1, "compression": 1, "order": "<", "reversed_bits": False}
    data = tiff(codes, 8, **how)
    place = data.index(struct.pack("<HHI", 262, 3, 1)) + 8
    (tmp_path / "a.tif").write_bytes(data[:place] + struct.pack("<H", photometric) + data[place + 2 :])
    with pytest.raises(PictureError, match=words):
        read_picture(tmp_path / "a.tif")
