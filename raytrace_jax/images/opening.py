"""Pictures opened by OpenImageIO as what they are, not as what they are called.

It is imported where it is called: JAX keeps what a compiled function's module has imported to the very end, and there
OpenImageIO complains of everything that is kept.
"""

import contextlib
import os
import shutil
import struct
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.other_formats import RAW, is_raw
from raytrace_jax.images.tiff_layout import directories
from raytrace_jax.util.files import read_bytes

SUFFIXES = {b"\xff\xd8": ".jpg", b"\x89P": ".png"}
"""Suffixes of files by how these begin; all others are taken for TIFFs."""

HARMLESS = "JPEG error: Warning"
"""How words begin on what JPEGs say of themselves that libjpeg does not know."""

NAMED = {".jpg": {".jpg", ".jpeg", ".jpe"}, ".tif": {".tif", ".tiff"}, ".png": {".png"}}


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """A PNG, JPEG or TIFF, its alpha not multiplied in. Raises PictureError if it cannot be read, and of a raw file."""
    import OpenImageIO as oiio

    how = oiio.ImageSpec()
    how.attribute("oiio:UnassociatedAlpha", 1)
    start = read_bytes(path, count=16, error=PictureError)
    suffix = SUFFIXES.get(start[:2], ".tif")
    if suffix == ".tif" and _is_raw(path, start):
        raise PictureError(f"{path}: is {RAW}")
    with contextlib.ExitStack() as stack:
        named = Path(path)
        if named.suffix.lower() not in NAMED[suffix]:
            named = Path(stack.enter_context(tempfile.TemporaryDirectory())) / f"picture{suffix}"
            shutil.copyfile(path, named)
        file = oiio.ImageInput.open(str(named), how)
        if file is None:
            raise PictureError(f"{path}: cannot be read: {reason(oiio.geterror())}")
        stack.callback(file.close)
        # A progressive JPEG is read to its end already here.
        if file.has_error and not (words := file.geterror()).startswith(HARMLESS):
            raise PictureError(f"{path}: cannot be read: {reason(words)}")
        yield file


def _is_raw(path: str | os.PathLike[str], start: bytes) -> bool:
    with warnings.catch_warnings(), contextlib.suppress(OSError, SyntaxError, ValueError, LookupError, struct.error):
        warnings.simplefilter("ignore")  # What Pillow says of broken tags, of which OpenImageIO will speak.
        return is_raw(path, start, directories(path))
    return False


def pixels_of(file: Any, kind: str, path: str | os.PathLike[str]) -> np.ndarray:
    """The numbers of an opened picture, "height width channels", of a kind that OpenImageIO has a name for.

    Raises:
        PictureError: they cannot be read.
    """
    spec = file.spec()
    pixels = file.read_image(0, 0, 0, spec.nchannels, kind)
    if pixels is None or file.has_error:
        raise PictureError(f"{path}: cannot be read: {reason(file.geterror())}")
    return np.asarray(pixels).reshape(spec.height, spec.width, spec.nchannels)


def reason(words: str) -> str:
    """The first line of what OpenImageIO says, without a full stop."""
    return (words.strip().splitlines() or ["it is broken"])[0].rstrip(".")
