"""The base classes of formats: the numbers of a picture's file, what they mean, and where they are from."""

import contextlib
import json
import shutil
import tempfile
import warnings
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from PIL.ExifTags import Base

from ..errors import PictureError, RaytraceError, RaytraceWarning
from ..util.files import StrPath, strict
from ..util.session import lack_of_memory
from ..util.text import is_unicode
from . import Transfer
from .exif import BROKEN, exif_of, orientation_of, upright
from .transfer import DECODERS, NEARLY, ColourSpace, Meaning, largest_number

KEY = "raytrace_jax"
"""The attribute of an OpenEXR file, and the keyword of a PNG file's text, that holds how a picture was made."""


MEMORY = 24
"""Bytes that a pixel takes when it becomes light: three float32 numbers and their copy."""


class PictureOrigin(NamedTuple):
    """Where a picture comes from, as its file says, if it is OpenEXR or PNG."""

    how_made: dict[str, Any]  # The metadata that this program writes.
    maker: str  # The program that rendered it (`generatedBy`).


class PictureFile:
    """A file of one format; nothing is read before it is asked for. All raise PictureError where the file is broken."""

    format = ""
    usual: Transfer = "srgb"
    """How integers were made where the file does not say it."""

    def __init__(self, path: StrPath) -> None:
        self.path = path

    def bits(self) -> int:
        """Of integers, 8 or 16; 0 is floats, which are scene-linear."""
        return 0

    def meaning(self) -> Meaning:
        """How the file says that its numbers were made from light; None where it does not say."""
        try:
            return self.stated()
        except ValueError as cause:
            raise self.error(str(cause)) from cause

    def stated(self) -> Meaning:
        """As `meaning`, but for a ValueError where it cannot be, whose text completes "FILE: "."""
        return None

    def pixel_aspect(self) -> float:
        """The width of a pixel over its height, upright; 1 where the file does not say it."""
        return 1.0

    def origin(self) -> PictureOrigin:
        return PictureOrigin({}, "")

    def numbers(self) -> np.ndarray:
        """The numbers as they are stored, "height width 3", upright: floats or unsigned integers."""
        raise NotImplementedError

    def weights(self) -> np.ndarray:
        """The picture as a mask, "height width": the mean of its channels, 0 where the file stores no pixels."""
        return np.ma.filled(self.light(), 0).mean(axis=0)

    def light(self, transfer: Transfer | None = None) -> np.ndarray:
        """The scene-linear float32 picture, "3 height width", top row first; warnings tell of other primaries.

        Where the file stores no pixels it is masked (`numpy.ma`).
        The transfer says how integers were made; None is what the file says, else what is usual.
        """
        if transfer is not None and transfer not in DECODERS:
            raise self.error(f"cannot be read: there is no transfer {transfer!r}; there are {' and '.join(DECODERS)}")
        numbers, is_float = self.numbers(), self.bits() == 0
        stated = transfer or self.meaning() or self.usual
        if isinstance(stated, ColourSpace):
            probe = np.linspace(0, 1, 65)[:, None] * np.ones(3)
            if is_float and np.max(np.abs(stated.curve(probe) - probe)) >= 1e-3:
                raise self.error(f"has floats, which are scene-linear, and says that they are not ({stated.name})")
            if stated.to_rec_709 is not None:
                self.tell(f"its primaries are others ({stated.name}): its light is converted to Rec. 709's, sRGB's.")
            numbers = stated.decode(numbers)
        elif not is_float:
            numbers = DECODERS[stated](numbers)
        if not np.isfinite(numbers).all():
            raise self.error(f"{(~np.isfinite(numbers)).sum()} of its numbers are NaN or infinite")
        aspect = self.pixel_aspect()
        if abs(aspect - 1) > NEARLY:
            self.tell(f"its pixels are {aspect:.4g} times as wide as high; they are read as square: resample it.")
        return np.ascontiguousarray(np.moveaxis(numbers, -1, 0), np.float32)

    def error(self, words: str) -> PictureError:
        return PictureError(f"{self.path}: {words}")

    def tell(self, words: str) -> None:
        warnings.warn(f"{self.path}: {words}", RaytraceWarning, stacklevel=4)


class LibraryFile(PictureFile):
    """A file that OpenImageIO reads, as what it is and not as it is named.

    OpenImageIO is imported where it is called: JAX keeps what a compiled function's module has imported to the very
    end, and there OpenImageIO complains of everything that is kept.
    """

    suffixes: tuple[str, ...] = ()
    """The names that OpenImageIO knows the format by."""

    def size(self) -> tuple[int, int]:
        """(width, height) as the file's first bytes tell it, before OpenImageIO reads any; 0 where they are broken."""
        tags = exif_of(self.path)
        with contextlib.suppress(*BROKEN):
            return int(tags.get(Base.ImageWidth, 0)), int(tags.get(Base.ImageLength, 0))
        return 0, 0

    def check_size(self) -> None:
        refuse_beyond_memory(self.path, "picture", *self.size(), bytes_per_pixel=MEMORY)

    @cached_property
    def spec(self) -> Any:
        self.check_size()  # Already here: OpenImageIO reads some files to their end when it opens them.
        with self._opened() as file:
            return file.spec()

    def bits(self) -> int:
        return {"uint8": 8, "half": 0, "float": 0, "double": 0}.get(str(self.spec.format), 16)

    def pixel_aspect(self) -> float:
        """By how many pixels there are to a length, across and down, or, of a JPEG without lengths, by their ratio."""
        across, down = (self.spec.get_float_attribute(f"{axis}Resolution", 0.0) for axis in "XY")
        # OpenImageIO has the ratio of a JPEG's densities upside down, but for those that are told as a ratio.
        told = self.spec.get_float_attribute("PixelAspectRatio", 1.0)
        aspect = down / across if across > 0 and down > 0 else told if told > 0 else 1.0
        return 1 / aspect if orientation_of(self.path) > 4 else aspect

    def stored(self) -> np.ndarray:
        """All channels of the file's one picture, "height width channels", upright; an alpha is not multiplied in."""
        spec = self.spec
        with self._opened() as file:
            if file.seek_subimage(1, 0):
                raise self.error("has several pages, and one picture is wanted")
            file.seek_subimage(0, 0)
            file.geterror()  # A missing second page is no error.
            is_for_print = spec.get_string_attribute("jpeg:ColorSpace") in ("CMYK", "YCbCrK")
            if is_for_print or "CMYK" in spec.get_string_attribute("tiff:ColorSpace"):
                raise self.error("is CMYK, for print; RGB is wanted")
            bits, dtype = self.bits(), str(spec.format)
            if bits == 16 and dtype != "uint16":
                raise self.error(f"has numbers of the kind {dtype}; integers of up to 16 bits or floats are wanted")
            pixels = file.read_image(0, 0, 0, spec.nchannels, dtype if bits else "float")
            if pixels is None or file.has_error:
                raise self.error(f"cannot be read: {_reason(file.geterror())}")
        return upright(np.reshape(pixels, (spec.height, spec.width, spec.nchannels)), orientation_of(self.path))

    def numbers(self) -> np.ndarray:
        """Red, green and blue, by the names of the channels; a grey channel three times."""
        stored, names = self.stored(), [name.upper() for name in self.spec.channelnames]
        if self.spec.alpha_channel >= 0:
            transparent = np.sum(stored[..., self.spec.alpha_channel] != largest_number(stored))
            if transparent:
                raise self.error(f"{transparent:,} of its pixels are transparent, and opaque ones are wanted")
        if {"R", "G", "B"} <= set(names):
            return stored[..., [names.index(name) for name in "RGB"]]
        colours = self._colours(stored)
        if colours.shape[-1] != 1:
            raise self.error(f"has the channels {', '.join(self.spec.channelnames)}, and R, G and B are wanted")
        return np.repeat(colours, 3, axis=-1)

    def weights(self) -> np.ndarray:
        """A painted mask, "height width", 0 to 1: how bright a pixel is, without any gamma, times how opaque it is."""
        stored = self.stored()
        values = np.asarray(stored, np.float64) / largest_number(stored)
        opacity = values[..., self.spec.alpha_channel] if self.spec.alpha_channel >= 0 else 1.0
        return self._colours(values).mean(axis=-1) * opacity

    def _colours(self, stored: np.ndarray) -> np.ndarray:
        """The channels that are not alpha."""
        return stored[..., [k for k in range(stored.shape[-1]) if k != self.spec.alpha_channel]]

    @contextlib.contextmanager
    def _opened(self) -> Iterator[Any]:
        import OpenImageIO as oiio

        how = oiio.ImageSpec()
        how.attribute("oiio:UnassociatedAlpha", 1)
        with contextlib.ExitStack() as stack:
            named = Path(self.path)
            # OpenImageIO's names are UTF-8, those of files need not be.
            if named.suffix.lower() not in self.suffixes or not is_unicode(str(named)):
                named = Path(stack.enter_context(tempfile.TemporaryDirectory())) / f"picture{self.suffixes[0]}"
                shutil.copyfile(self.path, named)
            file = oiio.ImageInput.open(str(named), how)
            if file is None:
                raise self.error(f"cannot be read: {_reason(oiio.geterror())}")
            stack.callback(file.close)
            # A progressive JPEG is read to its end already here.
            # What it warns of is what a JPEG says of itself that libjpeg does not know.
            if file.has_error and not (words := file.geterror()).startswith("JPEG error: Warning"):
                raise self.error(f"cannot be read: {_reason(words)}")
            yield file


def _reason(words: str) -> str:
    """The first line of what OpenImageIO says, without a full stop."""
    return (words.strip().splitlines() or ["it is broken"])[0].rstrip(".")


def refuse_beyond_memory(path: StrPath, what: str, width: int, height: int, *, bytes_per_pixel: int) -> None:
    """Raise PictureError where there is no memory for what a file says that it has, before any is asked for.

    A file of some bytes may say that it has any size. The bytes are the least that a reader needs, so that no picture
    is refused which can be read.
    """
    if lack := lack_of_memory(width * height * bytes_per_pixel):
        raise PictureError(f"{path}: its {what}, {width} x {height} pixels, does not fit into memory: it {lack}")


def to_json(path: StrPath, metadata: Mapping[str, object]) -> str:
    """Anything JSON can hold, NumPy and JAX numbers and arrays too. Raises PictureError, naming the file, else."""
    try:
        return json.dumps(strict(metadata, nulls=False))
    except RaytraceError as cause:
        raise PictureError(f"{path}: cannot be written: the metadata cannot be stored as JSON: {cause}") from cause
