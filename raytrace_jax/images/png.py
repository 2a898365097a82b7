"""PNG pictures of 8 or 16 bits, under one of two transfers from scene-linear colour to stored numbers.

`course` is the course's: truncation, no gamma. `srgb` is what screens expect: IEC 61966-2-1, rounded. Files that are
written say which (`png_transfer`), and what a file says is obeyed.
"""

import io
import os
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, get_args

import numpy as np
from jaxtyping import ArrayLike
from PIL import Image

from raytrace_jax.errors import PictureError, PictureWarning
from raytrace_jax.images.colour_spaces import ColourSpace, largest_number, srgb_to_linear, tell_primaries
from raytrace_jax.images.exif import upright
from raytrace_jax.images.metadata import to_json
from raytrace_jax.images.opening import opened, pixels_of, reason
from raytrace_jax.images.options import Bits, Transfer
from raytrace_jax.images.png_chunks import HEADER_END, Png, parse_png, pixels_alone
from raytrace_jax.images.png_transfer import (
    metadata_chunk,
    stated_maker,
    stated_metadata,
    stated_transfer,
    transfer_chunks,
)
from raytrace_jax.util.files import atomic_write, read_bytes


def encode_course(rgb: ArrayLike, *, bits: Bits = 8) -> np.ndarray:
    """Return floor(maximum * clamp(C)) with the maximum 255 (uint8) or 65535 (uint16), the shape of `rgb`."""
    maximum = 2**bits - 1
    return np.floor(maximum * _clamped(rgb)).astype(f"u{bits // 8}")


def encode_srgb(rgb: ArrayLike, *, bits: Bits = 8) -> np.ndarray:
    """Return the sRGB encoding (IEC 61966-2-1) of clamp(C), rounded to uint8 or uint16, the shape of `rgb`."""
    linear = _clamped(rgb)
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    return np.round((2**bits - 1) * encoded).astype(f"u{bits // 8}")


def decode_course(stored: np.ndarray, maximum: int | None = None) -> np.ndarray:
    """Return the scene-linear float64 colours that `encode_course` stored, without bias.

    Args:
        stored: integers.
        maximum: the largest number that stands for a colour; None is the largest of their dtype, uint8 or uint16.

    A stored k covers [k, k + 1) / maximum, so its middle is the estimate: k / maximum alone is half a step too
    dark on average. The ends differ: the maximum is stored by colours clamped to exactly 1 only, and nearly
    all zeros of a picture are its background, exactly 0.
    """
    maximum = largest_number(stored) if maximum is None else maximum
    middle = (stored + 0.5) / maximum
    return np.where(stored == 0, 0.0, np.where(stored == maximum, 1.0, middle))


def decode_srgb(stored: np.ndarray, maximum: int | None = None) -> np.ndarray:
    """Return the scene-linear float64 colours of sRGB-encoded integers, `maximum` as for `decode_course`."""
    return srgb_to_linear(stored / (largest_number(stored) if maximum is None else maximum))


ENCODERS: dict[Transfer, Callable[..., np.ndarray]] = {"course": encode_course, "srgb": encode_srgb}
DECODERS: dict[Transfer, Callable[..., np.ndarray]] = {"course": decode_course, "srgb": decode_srgb}


def write_png(
    path: str | os.PathLike[str],
    rgb: ArrayLike | Mapping[str, ArrayLike],
    *,
    transfer: Transfer = "course",
    bits: Bits = 8,
    metadata: Mapping[str, object] | None = None,
) -> None:
    """Write an RGB picture; the file appears only when it is whole.

    Args:
        path: the file; missing folders are made.
        rgb: "3 height width", scene-linear, top row first, clamped to [0, 1]; or channels, of which R, G and B count.
        transfer: `course` or `srgb`.
        bits: 8 or 16 a sample.
        metadata: how the picture was made, as for `write_exr`; a text of JSON in the file.

    Raises:
        PictureError: the shape is wrong, a colour is NaN or infinite, the transfer or the number of bits does
            not exist, the metadata is not JSON, the file cannot be written.
    """
    where = f"{path}: cannot be written"
    _refuse_unknown(where, "transfer", transfer, tuple(ENCODERS))
    _refuse_unknown(where, "number of bits", bits, get_args(Bits))
    if isinstance(rgb, Mapping):
        missing = [name for name in "RGB" if name not in rgb]
        if missing:
            raise PictureError(f"{where}: channels R, G and B are wanted, and {', '.join(missing)} is not there")
        rgb = np.stack([np.asarray(rgb[name]) for name in "RGB"])
    colours = np.asarray(rgb)
    if colours.ndim != 3 or colours.shape[0] != 3 or colours.size == 0:
        raise PictureError(f"{where}: its shape is {colours.shape}, and (3, height, width) is wanted")
    if not np.isfinite(colours).all():
        raise PictureError(f"{where}: {(~np.isfinite(colours)).sum()} of its numbers are NaN or infinite")
    samples = np.ascontiguousarray(np.moveaxis(ENCODERS[transfer](colours, bits=bits), 0, -1))
    said = transfer_chunks(transfer) + (metadata_chunk(to_json(path, metadata)) if metadata else b"")
    with atomic_write(path, error=PictureError) as temporary:
        encoded = _encode_rgb16(samples, temporary, where) if bits == 16 else _encode_rgb8(samples)
        temporary.write_bytes(encoded[:HEADER_END] + said + encoded[HEADER_END:])


def read_png(path: str | os.PathLike[str], *, transfer: Transfer | None = None) -> np.ndarray:
    """Read a PNG picture of any kind as scene-linear float32 "3 height width"; a grey one three times.

    Args:
        path: the file.
        transfer: how its numbers were made: `course` or `srgb`; None is what the file says (its ICC profile too), and
            `course` if it says nothing.

    Raises:
        PictureError: the file is missing, not a PNG, truncated or broken; a pixel is not opaque; the
            transfer does not exist; what the file says of its colours is not known.

    Warns:
        PictureWarning: the file has several pictures, of which one is read; it was turned upright; its primaries are
            not those of sRGB.
    """
    if transfer is not None:
        _refuse_unknown(f"{path}: cannot be read", "transfer", transfer, tuple(DECODERS))
    data = read_bytes(path, error=PictureError)
    if not data:
        raise PictureError(f"{path}: is empty")
    try:
        png = parse_png(data)
        stated = transfer or stated_transfer(png.chunks) or "course"
        samples = _rgb_alpha16(path, png) if png.bits == 16 else _rgb_alpha8(data)
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause
    if b"acTL" in png.chunks:
        warnings.warn(f"{path}: is animated, and only its first picture is read.", PictureWarning, stacklevel=2)
    samples = upright(samples, path)
    colours, alpha = samples[..., :3], samples[..., 3:]
    translucent = (alpha < largest_number(alpha)).sum()
    if translucent:
        raise PictureError(f"{path}: {translucent} of its pixels are transparent, and an opaque picture is wanted")
    if isinstance(stated, ColourSpace):
        decoded = stated.decode(colours)
        tell_primaries(path, stated)
    else:
        decoded = DECODERS[stated](colours)
    return np.ascontiguousarray(np.moveaxis(decoded, -1, 0), np.float32)


def states_transfer(path: str | os.PathLike[str]) -> bool:
    """Whether a PNG file says how its numbers were made. Raises PictureError as `read_png`."""
    try:
        return stated_transfer(_chunks(path)) is not None
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause


def png_origin(path: str | os.PathLike[str]) -> tuple[dict[str, Any], str]:
    """What `write_png` was given as metadata, and the program that rendered a PNG, both empty where it does not say.

    Raises:
        PictureError: as `read_png`.
    """
    chunks = _chunks(path)
    return stated_metadata(chunks), stated_maker(chunks)


def _chunks(path: str | os.PathLike[str]) -> Mapping[bytes, bytes]:
    try:
        return parse_png(read_bytes(path, error=PictureError)).chunks
    except ValueError as cause:
        raise PictureError(f"{path}: {cause}") from cause


def _clamped(rgb: ArrayLike) -> np.ndarray:
    return np.clip(np.asarray(rgb, np.float64), 0.0, 1.0)


def _encode_rgb8(samples: np.ndarray) -> bytes:
    file = io.BytesIO()
    Image.fromarray(samples).save(file, "PNG")
    return file.getvalue()


def _rgb_alpha8(data: bytes) -> np.ndarray:
    """Return uint8 "height width 4" of a PNG with at most 8 bits a sample: grey, RGB or palette."""
    try:
        with Image.open(io.BytesIO(data), formats=["PNG"]) as image:
            return np.asarray(image.convert("RGBA"))
    except Image.DecompressionBombError as cause:
        raise ValueError(f"is too large: {cause}") from cause
    except (OSError, SyntaxError) as cause:
        raise ValueError(f"is a truncated or broken PNG file: {cause}") from cause


def _encode_rgb16(samples: np.ndarray, path: Path, where: str) -> bytes:
    """A PNG of uint16 "height width 3", which Pillow cannot write, by way of a file."""
    import OpenImageIO as oiio  # Not above: see `opening`.

    height, width, channels = samples.shape
    # OpenImageIO goes by names, and a temporary file has none that tells.
    named = path.with_name(f"{path.name}.png")
    try:
        file = oiio.ImageOutput.create(str(named))
        assert file is not None, "OpenImageIO writes PNG"
        is_written = file.open(str(named), oiio.ImageSpec(width, height, channels, oiio.UINT16))
        if not (is_written and file.write_image(samples) and file.close()):
            raise PictureError(f"{where}: {reason(file.geterror())}")
        # What it says of colours is its own.
        return pixels_alone(named.read_bytes())
    finally:
        named.unlink(missing_ok=True)


def _rgb_alpha16(path: str | os.PathLike[str], png: Png) -> np.ndarray:
    """Return uint16 "height width samples" of a PNG with 16 bits a sample, which Pillow cuts to 8.

    The samples are red, green, blue and, if stored, alpha.
    """
    if png.has_transparent_colour:
        raise ValueError("makes one of its colours transparent, and an opaque picture is wanted")
    with opened(path) as file:
        samples = pixels_of(file, "uint16", path)
    if samples.shape[-1] > 2:
        return samples
    return np.concatenate([samples[..., :1]] * 3 + [samples[..., 1:]], axis=-1)


def _refuse_unknown(where: str, what: str, came: object, known: tuple[object, ...]) -> None:
    if came not in known:
        raise PictureError(f"{where}: there is no {what} {came!r}; there are {' and '.join(map(str, known))}")
