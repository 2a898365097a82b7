"""Pictures that are not read: what they are by their first bytes, and what to do with them."""

import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

RAW = "a raw file of a camera: develop it (docs/photograph.md says how)"

_RAW_STARTS = (
    b"IIRO", b"IIRS", b"MMOR", b"IIU\0", b"FUJIFILMCCD-RAW", b"FOVb", b"\0MRM", b"II\x1a\0\0\0HEAPCCDR",
    b"II*\0\x10\0\0\0CR", b"II*\0\x08\0\0\0IIII", b"MM\0*\0\0\0\x08MMMM",
)  # fmt: skip
"""Raw files that are no plain TIFFs: of Olympus, Panasonic and Leica, Fujifilm, Sigma, Minolta, Canon and Phase One."""

_RAW_SUFFIXES = (
    ".3fr", ".arw", ".cr2", ".dcr", ".dng", ".erf", ".fff", ".gpr", ".iiq", ".kdc", ".mef", ".mos", ".nef", ".nrw",
    ".orf", ".pef", ".raf", ".raw", ".rw2", ".rwl", ".sr2", ".srf", ".srw",
)  # fmt: skip

# Tags of TIFF/EP and DNG, and their values that only raw files have.
_SUBFILE, _COMPRESSION, _PHOTOMETRIC, _INNER = 254, 259, 262, 330
_MOSAIC, _DNG = {33421, 33422}, {50706}
_RAW_PHOTOMETRIC, _RAW_COMPRESSION = {32803, 34892}, {32767, 32769, 32770, 34713, 65000, 65535}

_CONVERTED = {
    b"GIF8": "a GIF picture",
    b"BM": "a BMP picture",
    b"8BPS": "a Photoshop document",
    b"\0\0\0\x0cjP  ": "a JPEG 2000 picture",
    b"\xff\x4f\xff\x51": "a JPEG 2000 picture",
    b"\0\0\0\x0cJXL ": "a JPEG XL picture",
    b"\xff\x0a": "a JPEG XL picture",
    b"II\xbc\x01": "a JPEG XR picture",
    b"P1": "a PBM picture",
    b"P4": "a PBM picture",
    b"P2": "a PGM picture",
    b"P5": "a PGM picture",
    b"P7": "a PAM picture",
    b"SDPX": "a DPX picture",
    b"XPDS": "a DPX picture",
    b"DDS ": "a DDS picture",
    b"qoif": "a QOI picture",
    b"SIMPLE  =": "a FITS picture",
    b"<svg": "an SVG drawing",
    b"%PDF": "a PDF document",
}
_OTHER = {b"camera": "a model file", b"PF": "a PFM picture", b"Pf": "a PFM picture"}

# Brands of pictures in boxes (ISO/IEC 14496-12), and how they are named; both may call themselves `mif1` first.
_AVIF = {b"avif", b"avis"}
_HEIC = {b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"mif2", b"msf1"}


def describe(start: bytes, wanted: str) -> str:
    """What a file that is not read is, and what to do; it completes "FILE: is ".

    Args:
        start: its first bytes, 64 of them if there are.
        wanted: what to give instead, as a clause.
    """
    if start.startswith(_RAW_STARTS) or start[4:12] == b"ftypcrx ":
        return RAW
    name = _name(start, _CONVERTED) or _in_boxes(start)
    if name is not None:
        return f"{name}, and {wanted}: convert it, as by `magick FILE FILE.png` (ImageMagick)"
    name = _name(start, _OTHER) or f"of an unknown format (it starts with {start[:4]!r})"
    return f"{name if start else 'empty'}, and {wanted}"


def is_raw(path: str | os.PathLike[str], start: bytes, directories: Iterable[Mapping[int, Any]]) -> bool:
    """Whether a TIFF is a raw file, whose first picture may be a preview.

    Args:
        path: the file; its name tells of those whose tags are their makers' own.
        start: its first bytes.
        directories: the tags of its pictures, the first one first.
    """
    if start.startswith(_RAW_STARTS) or Path(path).suffix.lower() in _RAW_SUFFIXES:
        return True
    for number, tags in enumerate(directories):
        if tags.get(_PHOTOMETRIC) in _RAW_PHOTOMETRIC or tags.get(_COMPRESSION) in _RAW_COMPRESSION:
            return True
        # A first picture that is a smaller copy (1) stands before the one that was taken.
        if not (_MOSAIC | _DNG).isdisjoint(tags) or (number == 0 and tags.get(_SUBFILE) == 1 and _INNER in tags):
            return True
    return False


def _name(start: bytes, names: Mapping[bytes, str]) -> str | None:
    return next((name for magic, name in names.items() if start.startswith(magic)), None)


def _in_boxes(start: bytes) -> str | None:
    if start.startswith(b"RIFF"):
        return "a WebP picture" if start[8:12] == b"WEBP" else None
    if start[4:8] != b"ftyp":
        return None
    brands = {start[k : k + 4] for k in range(8, min(len(start), int.from_bytes(start[:4], "big")), 4)}
    if brands & _AVIF:
        return "an AVIF picture"
    return "a HEIC picture, as telephones write them" if brands & _HEIC else "a film (MPEG-4)"
