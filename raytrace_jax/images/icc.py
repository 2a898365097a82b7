"""ICC profiles with a curve for each channel and a matrix, as cameras, screens and editors embed them.

The format is ICC.1:2022 (https://www.color.org/specification/ICC.1-2022-05.pdf): header and tags in 7.2 and 7.3, the
kinds of tags in 10. Profiles that are tables of colours, of printers and some scanners, are refused.
"""

import contextlib
import io
import struct

import numpy as np
from PIL import ImageCms

from .transfer import NEARLY, ColourSpace, Curve, srgb_to_linear

SRGB_TO_XYZ = np.array(
    [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
)
"""sRGB's light in CIE XYZ, adapted to the white of profiles, D50, by Bradford's transform."""


def read_profile(data: bytes) -> ColourSpace | None:
    """What an ICC profile says of the numbers of a picture; None where that is sRGB.

    Raises ValueError if it is broken or has no curves; the text completes "FILE: ".
    """
    try:
        tags, space = _tags(data), data[16:20]
        name = _name(data)
        if space == b"GRAY" and b"kTRC" in tags:
            curves, matrix = [_curve(tags[b"kTRC"])], None
        elif space == b"RGB " and {b"rTRC", b"gTRC", b"bTRC", b"rXYZ", b"gXYZ", b"bXYZ"} <= tags.keys():
            curves = [_curve(tags[b"%cTRC" % channel]) for channel in b"rgb"]
            primaries = [tags[b"%cXYZ" % channel] for channel in b"rgb"]
            if any(tag[:4] != b"XYZ " for tag in primaries):
                raise struct.error("no colour")
            matrix = _to_rec_709(np.stack([_fixed(tag, 8, 3) for tag in primaries], axis=1))
        else:
            said = f"has an ICC profile ({name}) that is a table of {space.decode('latin-1').strip()} colours"
            raise ValueError(f"{said}, and not curves: convert it to sRGB, or say what its numbers are (--transfer)")
    except (struct.error, IndexError, UnicodeDecodeError, np.linalg.LinAlgError) as cause:
        words = "has a broken ICC profile: convert it to sRGB, or say what its numbers are (--transfer)"
        raise ValueError(words) from cause
    # Tables and formulas of sRGB are rounded.
    probe = np.linspace(0, 1, 1025)
    if matrix is None and all(np.max(np.abs(one(probe) - srgb_to_linear(probe))) < 1e-3 for one in curves):
        return None

    def curve(encoded: np.ndarray) -> np.ndarray:
        return np.stack([curves[k % len(curves)](encoded[..., k]) for k in range(encoded.shape[-1])], axis=-1)

    return ColourSpace(name, curve, matrix)


def _name(data: bytes) -> str:
    with contextlib.suppress(ImageCms.PyCMSError):
        return ImageCms.getProfileDescription(io.BytesIO(data)).strip() or "without a name"
    return "without a name"


def _tags(data: bytes) -> dict[bytes, bytes]:
    if data[36:40] != b"acsp":
        raise struct.error("no profile")
    (count,) = struct.unpack_from(">I", data, 128)
    places = [struct.unpack_from(">4sII", data, 132 + 12 * k) for k in range(min(count, 200))]
    return {signature: data[start : start + size] for signature, start, size in places}


def _fixed(tag: bytes, start: int, count: int) -> np.ndarray:
    """Numbers of the kind s15Fixed16."""
    return np.array(struct.unpack_from(f">{count}i", tag, start)) / 65536


def _to_rec_709(to_xyz: np.ndarray) -> np.ndarray | None:
    """The matrix from a profile's light to Rec. 709's; None if they are one. Both have the white of profiles, D50."""
    matrix = np.linalg.solve(SRGB_TO_XYZ, to_xyz)
    matrix = matrix / matrix.sum(axis=1, keepdims=True)  # White stays white to the last digit.
    if not np.isfinite(matrix).all():
        raise np.linalg.LinAlgError("no white")
    return None if np.allclose(matrix, np.eye(3), atol=NEARLY) else matrix


def _curve(tag: bytes) -> Curve:
    """A tone curve (10.6 and 10.18)."""
    kind = tag[:4]
    if kind == b"curv":
        (count,) = struct.unpack_from(">I", tag, 8)
        if count == 0:
            return lambda encoded: encoded
        if count == 1:
            (exponent,) = struct.unpack_from(">H", tag, 12)
            return lambda encoded: encoded ** (exponent / 256)
        table = np.array(struct.unpack_from(f">{count}H", tag, 12)) / 65535
        return lambda encoded: np.interp(encoded, np.linspace(0, 1, count), table)
    if kind != b"para":
        raise struct.error("no curve")
    (form,) = struct.unpack_from(">H", tag, 8)
    given = _fixed(tag, 12, (1, 3, 4, 5, 7)[form])
    # All forms are the last one, with what they leave out at its neutral value.
    g, a, b, c, d, e, f = (*given, *(0, 1, 0, 0, 0, 0, 0)[len(given) :])
    if g <= 0 or a == 0:
        raise struct.error("no curve")
    if form in (1, 2):
        c, d, e, f = 0, -b / a, c, c
    return lambda encoded: np.where(encoded >= d, np.maximum(a * encoded + b, 0) ** g + e, c * encoded + f)
