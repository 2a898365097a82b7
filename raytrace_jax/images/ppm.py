"""PPM pictures, plain (P3) and raw (P6), as courses write them (netpbm's manual, `ppm`)."""

import os
import re

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import DECODERS, ENCODERS
from raytrace_jax.util.files import atomic_write, read_bytes

LARGEST_MAXIMUM = 65535

HEADER = re.compile(rb"P[36]" + 3 * rb"(?:\s|#[^\n\r]*[\n\r])+(\d{1,9})" + rb"(?:#[^\n\r]*[\n\r])?\s")
"""Width, height and the largest number, with spaces or comments before each; one space, or a line's end, after it."""

COMMENT = re.compile(rb"#[^\n\r]*")


def read_ppm(path: str | os.PathLike[str], *, transfer: Transfer | None = None) -> np.ndarray:
    """Read a PPM picture as scene-linear float32 "3 height width", top row first.

    Args:
        path: the file.
        transfer: how its numbers were made, `course` or `srgb`; None is `course`, for the file does not say.

    Raises:
        PictureError: the file is missing, broken or truncated, holds several pictures, or numbers beyond its largest.
    """
    data = read_bytes(path, error=PictureError)
    head = HEADER.match(data)
    if head is None:
        raise PictureError(f"{path}: is a broken PPM picture: its head has no width, height and largest number.")
    width, height, maximum = map(int, head.groups())
    if not (width and height and 0 < maximum <= LARGEST_MAXIMUM):
        raise PictureError(
            f"{path}: is a broken PPM picture of {width} x {height} pixels with numbers up to {maximum}; they may go "
            f"to {LARGEST_MAXIMUM}."
        )
    numbers = _plain(path, data[head.end() :]) if data.startswith(b"P3") else _raw(data[head.end() :], maximum)
    wanted = 3 * width * height
    if len(numbers) != wanted:
        what = "is truncated" if len(numbers) < wanted else "has more behind its picture"
        raise PictureError(f"{path}: {what}: {len(numbers)} numbers, and 3 x {width} x {height} are wanted.")
    if numbers.max() > maximum:
        raise PictureError(f"{path}: has the number {numbers.max()}, and says that {maximum} is the largest.")
    colours = DECODERS[transfer or "course"](numbers.reshape(height, width, 3), maximum)
    return np.moveaxis(colours, -1, 0).astype(np.float32)


def has_long_numbers(path: str | os.PathLike[str]) -> bool:
    """Whether a PPM's numbers have more than 8 bits. Raises PictureError if the file is missing."""
    head = HEADER.match(read_bytes(path, error=PictureError))
    return head is not None and int(head[3]) > 255


def _plain(path: str | os.PathLike[str], body: bytes) -> np.ndarray:
    words = COMMENT.sub(b"", body).split()
    bad = next((word for word in words if not (word.isdigit() and len(word) < 10)), None)
    if bad is not None:
        raise PictureError(f"{path}: has {bad[:20].decode(errors='replace')!r} where a whole number is wanted.")
    return np.array(words, np.int64)


def _raw(body: bytes, maximum: int) -> np.ndarray:
    size = 1 if maximum < 256 else 2
    return np.frombuffer(body[: len(body) // size * size], f">u{size}").astype(np.int64)


def write_ppm(path: str | os.PathLike[str], rgb: np.ndarray, *, transfer: Transfer = "course") -> None:
    """Write a raw PPM of 8 bits; the file appears only when it is whole.

    Args:
        path: the file; missing folders are made.
        rgb: "3 height width", scene-linear, finite, top row first, clamped to [0, 1].
        transfer: `course` or `srgb`, which the file does not say.

    Raises:
        PictureError: the file cannot be written.
    """
    numbers = np.moveaxis(ENCODERS[transfer](rgb), 0, -1)
    height, width, _ = numbers.shape
    with atomic_write(path, error=PictureError) as temporary:
        temporary.write_bytes(b"P6\n%d %d\n255\n" % (width, height) + np.ascontiguousarray(numbers).tobytes())
