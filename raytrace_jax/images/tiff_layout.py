"""How a TIFF stores its numbers, where OpenImageIO does not undo it or programs disagree (TIFF 6.0, 3, 8 and 14)."""

import os
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from raytrace_jax.errors import PictureError

BITS, COMPRESSION, PHOTOMETRIC, PREDICTOR, INNER = 258, 259, 262, 317, 330
UNCOMPRESSED, DIFFERENCES = 1, (2, 3)
WHITE_IS_ZERO = 0
COLOURS = {8: "CIE L*a*b*", 9: "ICC L*a*b*", 10: "ITU L*a*b*", 32844: "LogL", 32845: "LogLuv"}
"""Photometric interpretations that are not light or sRGB."""


def undo_layout(stored: np.ndarray, path: str | os.PathLike[str]) -> np.ndarray:
    """The numbers of a TIFF as OpenImageIO has read them, with black at zero and scaled to the largest exactly.

    Args:
        stored: unsigned integers or floats, "height width channels".
        path: the file they are from.

    Raises:
        PictureError: a layout that programs read differently, or colours that are no light.
    """
    tags = next(directories(path))
    bits = int(np.max(tags.get(BITS, 1)))
    colours = COLOURS.get(int(tags.get(PHOTOMETRIC, 1)))
    if colours is not None:
        raise PictureError(f"{path}: its colours are {colours}; RGB is wanted")
    if tags.get(PREDICTOR, 1) in DIFFERENCES and tags.get(COMPRESSION, UNCOMPRESSED) == UNCOMPRESSED:
        raise PictureError(
            f"{path}: says that it stores differences (predictor {tags[PREDICTOR]}) without compression, which "
            "programs read differently: save it without predictor"
        )
    is_white_zero = tags.get(PHOTOMETRIC) == WHITE_IS_ZERO
    if stored.dtype.kind != "u":
        if is_white_zero:
            raise PictureError(f"{path}: has floats of which white is zero, which are no light")
        return stored
    if bits < 16 and bits != 8:
        # Scaled by copying bits: in the code's own steps they are exact.
        largest = 2**bits - 1
        codes = np.round(stored * (largest / np.iinfo(stored.dtype).max))
        stored = np.round(codes * (65535 / largest)).astype(np.uint16)
    # OpenImageIO turns numbers of which white is zero, but only up to 8 bits.
    return np.iinfo(stored.dtype).max - stored if is_white_zero and bits > 8 else stored


def directories(path: str | os.PathLike[str], first: int | None = None) -> Iterator[ImageFileDirectory_v2]:
    """The tags of a TIFF's pictures, of any layout: of the first one, and then of all others and those inside them.

    Args:
        path: the file.
        first: where the first one stands; None is where the file says.
    """
    with Path(path).open("rb") as file:
        header = file.read(8)
        header += file.read(8) if header[2] == 43 or header[3] == 43 else b""
        places, known = [ImageFileDirectory_v2(header).next if first is None else first], set()
        while places:
            place = places.pop(0)
            if place and place not in known:
                known.add(place)
                tags = ImageFileDirectory_v2(header)
                file.seek(place)
                tags.load(file)
                yield tags
                inner = tags.get(INNER, ())
                places += [tags.next, *(inner if isinstance(inner, tuple) else (inner,))]
