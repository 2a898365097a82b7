"""Pictures opened by OpenImageIO as what they are, not as what they are called.

It is imported where it is called: JAX keeps what a compiled function's module has imported to the very end, and there
OpenImageIO complains of everything that is kept.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from raytrace_jax.errors import PictureError
from raytrace_jax.util.files import read_bytes

SUFFIXES = {b"\xff\xd8": ".jpg", b"\x89P": ".png"}
"""Suffixes of files by how these begin; all others are taken for TIFFs."""

NAMED = {".jpg": {".jpg", ".jpeg", ".jpe"}, ".tif": {".tif", ".tiff"}, ".png": {".png"}}


@contextlib.contextmanager
def opened(path: str | os.PathLike[str]) -> Iterator[Any]:
    """A PNG, JPEG or TIFF, its alpha not multiplied in. Raises PictureError if OpenImageIO cannot open it."""
    import OpenImageIO as oiio

    how = oiio.ImageSpec()
    how.attribute("oiio:UnassociatedAlpha", 1)
    suffix = SUFFIXES.get(read_bytes(path, count=2, error=PictureError), ".tif")
    with contextlib.ExitStack() as stack:
        named = Path(path)
        if named.suffix.lower() not in NAMED[suffix]:
            named = Path(stack.enter_context(tempfile.TemporaryDirectory())) / f"picture{suffix}"
            shutil.copyfile(path, named)
        file = oiio.ImageInput.open(str(named), how)
        if file is None:
            raise PictureError(f"{path}: cannot be read: {reason(oiio.geterror())}")
        stack.callback(file.close)
        yield file


def reason(words: str) -> str:
    """The first line of what OpenImageIO says, without a full stop."""
    return (words.strip().splitlines() or ["it is broken"])[0].rstrip(".")
