"""The compression of a JPEG file, which can be done to other pictures."""

import io
from typing import NamedTuple

import numpy as np
from PIL import Image, JpegImagePlugin

from ..errors import PictureError
from ..util.files import StrPath, as_path
from . import Transfer
from .exif import BACK, orientation_of, upright
from .transfer import DECODERS, ENCODERS, Colours


class JpegStorage(NamedTuple):
    """The compression of one file."""

    tables: tuple[tuple[int, ...], ...]  # Of quantization, of brightness and of colour.
    subsampling: int  # Says how many pixels share a colour, as Pillow numbers it.
    transfer: Transfer
    orientation: int  # As EXIF numbers it.
    size: tuple[int, int]  # (width, height) of the whole upright picture.
    window: tuple[int, int, int, int]  # (x, y, width, height) of the part of it that is compressed.

    @property
    def unit(self) -> int:
        """Side in pixels of the squares whose patterns are kept or dropped: 16 where pixels share colours."""
        return 8 if self.subsampling == 0 else 16

    def encode(self, picture: Colours) -> Colours:
        """The numbers of a scene-linear picture as they are stored, not rounded to 8 bits: from 0 to 255."""
        return ENCODERS[self.transfer](picture, bits=16) / (2**16 - 1) * 255

    def compress(self, numbers: Colours) -> Colours:
        """The scene-linear picture that is read back of numbers from 0 to 255.

        Its squares begin where those of the file do; beyond the part's border the picture goes on as it is there.
        """
        _, height, width = numbers.shape
        left, top, columns, rows = self.window
        largest = 16  # A JPEG whose colours have half the pixels compresses squares of so many pixels a side together.
        after, below = -(left + columns - self.size[0]) % largest, -(top + rows - self.size[1]) % largest
        before, above = left % largest, top % largest
        pixels = np.moveaxis(np.clip(np.round(numbers), 0, 255).astype(np.uint8), 0, -1)
        pixels = np.pad(pixels, ((above, below), (before, after), (0, 0)), mode="edge")
        turned = upright(pixels, BACK.get(self.orientation, self.orientation))
        file = io.BytesIO()
        tables = [list(table) for table in self.tables]
        Image.fromarray(np.ascontiguousarray(turned)).save(file, "JPEG", qtables=tables, subsampling=self.subsampling)
        stored = upright(np.asarray(Image.open(file)), self.orientation)[above:, before:]
        return DECODERS[self.transfer](np.moveaxis(stored, -1, 0))[:, :height, :width]


def jpeg_storage(path: StrPath, transfer: Transfer = "srgb") -> JpegStorage | None:
    """The compression of a JPEG file; None for a grey one and for one that does not store brightness and colour apart.

    Args:
        transfer: how the numbers of the file were made, `course` or `srgb`, as for `read_picture`.

    Raises:
        PictureError: the file cannot be read.
    """
    try:
        # Not by `Image.open`, which refuses large pictures.
        with JpegImagePlugin.JpegImageFile(as_path(path, PictureError)) as image:
            sampling, orientation = JpegImagePlugin.get_sampling(image), orientation_of(path)
            is_not_ycc = image.mode != "RGB" or image.info.get("adobe_transform") == 0
            width, height = image.size if orientation < 5 else image.size[::-1]
            tables = tuple(tuple(table) for _, table in sorted(image.quantization.items()))
    except (OSError, SyntaxError) as cause:
        raise PictureError(f"{path}: cannot be read: {cause}") from cause
    if is_not_ycc or sampling < 0 or not 1 <= len(tables) <= 2:
        return None
    return JpegStorage(tables, sampling, transfer, orientation, (width, height), (0, 0, width, height))
