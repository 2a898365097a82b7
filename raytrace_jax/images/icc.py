"""ICC profiles with a curve for each channel and a matrix, as cameras, screens and editors embed them.

The format is ICC.1:2022 (https://www.color.org/specification/ICC.1-2022-05.pdf): header and tags in 7.2 and 7.3, the
kinds of tags in 10. Profiles that are tables of colours, of printers and some scanners, are refused.
"""

import struct
from collections.abc import Callable

import numpy as np

from raytrace_jax.images.transfer import NEARLY, ColourSpace, srgb_to_linear

SRGB_TO_XYZ = np.array(
    [[0.4360747, 0.3850649, 0.1430804], [0.2225045, 0.7168786, 0.0606169], [0.0139322, 0.0971045, 0.7141733]]
)
"""sRGB's light in CIE XYZ, adapted to the white of profiles, D50, by Bradford's transform."""

Curve = Callable[[np.ndarray], np.ndarray]


def read_profile(data: bytes) -> ColourSpace | None:
    """What an ICC profile says of the numbers of a picture; None where that is sRGB.

    Raises:
        ValueError: it is broken, or has no curves; the text completes "FILE: ".
    """
    try:
        tags, space = _tags(data), data[16:20]
        name = _description(tags.get(b"desc", b"")) or "without a name"
        if space == b"GRAY" and b"kTRC" in tags:
            curves, matrix = [_curve(tags[b"kTRC"])], None
        elif space == b"RGB " and {b"rTRC", b"gTRC", b"bTRC", b"rXYZ", b"gXYZ", b"bXYZ"} <= tags.keys():
            curves = [_curve(tags[b"%cTRC" % channel]) for channel in b"rgb"]
            primaries = [tags[b"%cXYZ" % channel] for channel in b"rgb"]
            if any(tag[:4] != b"XYZ " for tag in primaries):
                raise struct.error("no colour")
            matrix = _to_rec_709(np.stack([_fixed(tag, 8, 3) for tag in primaries], axis=1))
        else:
            kind = space.decode("latin-1").strip()
            raise ValueError(
                f"has an ICC profile ({name}) that is a table of {kind} colours, and one with a curve for each channel "
                "is wanted: convert the picture to sRGB, or say what its numbers are (--transfer)"
            )
    except (struct.error, IndexError, UnicodeDecodeError, np.linalg.LinAlgError) as cause:
        words = "has a broken ICC profile: convert it to sRGB, or say what its numbers are (--transfer)"
        raise ValueError(words) from cause
    # Tables and formulas of sRGB are rounded.
    probe = np.linspace(0, 1, 1025)
    if matrix is None and all(np.max(np.abs(one(probe) - srgb_to_linear(probe))) < 1e-3 for one in curves):
        return None

    def curve(encoded: np.ndarray) -> np.ndarray:
        if len(curves) == 1:
            return curves[0](encoded)
        return np.stack([one(encoded[..., k]) for k, one in enumerate(curves)], axis=-1)

    return ColourSpace(name, curve, matrix)


def _tags(data: bytes) -> dict[bytes, bytes]:
    """The contents of the tags by their signature."""
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
    if given[0] <= 0 or (form in (1, 2) and given[1] == 0):
        raise struct.error("no curve")
    # All forms are the last one, with what they leave out at its neutral value.
    g, a, b, c, d, e, f = {
        0: lambda g: (g, 1, 0, 0, 0, 0, 0),
        1: lambda g, a, b: (g, a, b, 0, -b / a, 0, 0),
        2: lambda g, a, b, c: (g, a, b, 0, -b / a, c, c),
        3: lambda g, a, b, c, d: (g, a, b, c, d, 0, 0),
        4: lambda *all_: all_,
    }[form](*given)
    return lambda encoded: np.where(encoded >= d, np.maximum(a * encoded + b, 0) ** g + e, c * encoded + f)


def _description(tag: bytes) -> str:
    """The name of a profile, in plain text or the first of several languages (10.15 and, before version 4, 6.5.17)."""
    if tag[:4] == b"desc":
        (count,) = struct.unpack_from(">I", tag, 8)
        return tag[12 : 12 + count].split(b"\0")[0].decode("latin-1").strip()
    if tag[:4] == b"mluc":
        size, start = struct.unpack_from(">II", tag, 20)
        return tag[start : start + size].decode("utf-16-be").strip()
    return ""
