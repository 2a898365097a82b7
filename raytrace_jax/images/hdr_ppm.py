"""Radiance HDR and PPM files: OpenImageIO reads them, and what it would read wrongly is refused here."""

import re
from functools import cached_property

import numpy as np
from PIL import Image

from ..errors import PictureError
from ..util.files import StrPath, atomic_write, read_bytes
from . import Transfer
from .picture_file import LibraryFile
from .transfer import ENCODERS, REC_709

HDR_HEADER = re.compile(rb"(#\?(?:[^\r\n]+\r?\n)*)\r?\n-Y +(?P<height>\d{1,9}) +\+X +(?P<width>\d{1,9}) *\r?\n")
"""Lines up to an empty one, and the size of a picture that is stored from its upper left."""

HDR_SAYS = re.compile(rb"^(EXPOSURE|GAMMA|PIXASPECT|COLORCORR|PRIMARIES|FORMAT(?!=32-bit_rle_rgbe\s*$))=(.*)", re.M)
HDR_READ = {b"COLORCORR": [(1, 1, 1)], b"PRIMARIES": [REC_709, (0,) * 8], b"FORMAT": []}
"""Numbers by which a header changes no colour, where it is not 1 alone; Photoshop writes primaries of 0."""

SAVE = "save it as OpenEXR with the program that made it"

PPM_HEADER = re.compile(
    rb"P[36](?:\s|#[^\n\r]*[\n\r])+(?P<width>\d{1,9})(?:\s|#[^\n\r]*[\n\r])+(?P<height>\d{1,9})"
    rb"(?:\s|#[^\n\r]*[\n\r])+(0*(?:255|65535))\s"
)
"""Width, height and the largest number, with spaces or comments before each, and one space behind them."""


class HeadedFile(LibraryFile):
    """A file that begins with a text, in which its size is."""

    header: re.Pattern[bytes]
    complaint: str
    """What is wrong with a file that does not begin so."""

    @cached_property
    def head(self) -> re.Match[bytes]:
        head = self.header.match(read_bytes(self.path, error=PictureError))
        if head is None:
            raise self.error(self.complaint)
        return head

    def size(self) -> tuple[int, int]:
        return int(self.head["width"]), int(self.head["height"])

    def body(self) -> bytes:
        """What follows the head, of a picture that fits into memory."""
        self.check_size()
        return self.head.string[self.head.end() :]


class HdrFile(HeadedFile):
    """A Radiance HDR (https://radsite.lbl.gov/radiance/refer/Notes/picture_format.html): colours m 2^(e - 136)."""

    format, suffixes, header = "Radiance HDR", (".hdr",), HDR_HEADER
    complaint = f"has no header with a size such as '-Y 480 +X 640', or is turned: {SAVE}"

    def stored(self) -> np.ndarray:
        """As of any file, if its numbers are light that OpenImageIO reads."""
        body, (width, height) = self.body(), self.size()
        for name, value in HDR_SAYS.findall(self.head[1]):
            try:
                numbers = tuple(map(float, value.split()))
            except ValueError:
                numbers = ()
            if numbers not in HDR_READ.get(name, [(1,)]):
                said = f"{name.decode()}={value.strip()[:60].decode('latin-1')}"
                raise self.error(f"says {said}, which is not read: {SAVE}")
        # A byte stands for 16 pixels at most: runs of 127 take two bytes in each of four channels.
        if width * height > 16 * len(body):
            raise self.error("is truncated: some of its pixels are missing")
        # OpenImageIO takes the pixel 1 1 1 n, "the last one n times" in the old coding, for a grey 2^(n - 136).
        if b"\1\1\1" in body and (body[:2] != b"\2\2" or (np.frexp(super().stored())[0] == 0.5).all(axis=-1).any()):
            raise self.error(f"may have runs of pixels in Radiance's old coding, which is not read: {SAVE}")
        return super().stored()


class PpmFile(HeadedFile):
    """A PPM, plain (P3) or raw (P6), as courses write them (netpbm's manual, `ppm`); it says nothing of its numbers."""

    format, suffixes, usual, header = "PPM", (".ppm",), "course", PPM_HEADER
    complaint = (
        "is a broken PPM picture or of other numbers, and a head with a width, a height and 255 or 65535 as the "
        "largest number is wanted: `pamdepth 255` converts it"
    )

    def stored(self) -> np.ndarray:
        """As of any file, if it has as many numbers as its head says, and none is beyond the largest."""
        body, (width, height, largest) = self.body(), map(int, self.head.groups())
        wanted = 3 * width * height
        if self.head[0].startswith(b"P3"):
            words = re.sub(rb"#[^\n\r]*", b"", body).split()
            is_whole = len(words) == wanted and all(w.isdigit() and len(w) < 10 and int(w) <= largest for w in words)
        else:
            is_whole = len(body) == wanted * (1 if largest == 255 else 2)
        if not is_whole:
            raise self.error(f"is not whole: 3 x {width} x {height} numbers from 0 to {largest} are wanted, no more")
        return super().stored()


def write_ppm(path: StrPath, rgb: np.ndarray, *, transfer: Transfer = "course") -> None:
    """Write colours "3 height width", scene-linear, finite, top row first, as a raw PPM of 8 bits, clamped to [0, 1].

    The file does not say its transfer, and appears only when it is whole. Raises PictureError if it cannot be written.
    """
    with atomic_write(path, error=PictureError) as temporary:
        Image.fromarray(np.ascontiguousarray(np.moveaxis(ENCODERS[transfer](rgb), 0, -1))).save(temporary, "PPM")
