"""GIF and, by the program ffmpeg, MP4 animations of frames with words on each."""

import shutil
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from ..errors import RaytraceError
from ..util.files import atomic_write

SUFFIXES = (".gif", ".mp4")
MOST_GIF_FPS = 50  # What viewers show at full speed: two hundredths of a second a frame.

_PAIR = np.array([[0, 2], [3, 1]])
DITHER = 8 * ((4 * np.tile(_PAIR, (2, 2)) + np.kron(_PAIR, np.ones((2, 2)))) / 15 - 0.5)
"""Bayer's ordered pattern of 4 x 4 pixels, as wide as the steps between 256 colours of a picture usually are."""


def write_animation(path: Path, frames: Sequence[Image.Image], fps: int) -> None:
    """Write RGB frames of one size, by the suffix of the path, `.gif` or `.mp4`; the file appears when it is whole.

    Raises RaytraceError if the file cannot be written, or ffmpeg is missing or fails.
    """
    if path.suffix.lower() == ".mp4":
        return _write_mp4(path, frames, fps)
    first, *others = _with_palette(frames)
    length = 10 * max(1, round(100 / fps))  # In milliseconds; a GIF counts in hundredths of a second.
    with atomic_write(path) as temporary:
        first.save(temporary, save_all=True, append_images=others, duration=length, loop=0, optimize=False)


def require_ffmpeg(path: Path) -> str:
    """Where ffmpeg is. Raises RaytraceError that names the other format if it is not on the PATH."""
    program = shutil.which("ffmpeg")
    if program is None:
        raise RaytraceError(f"{path}: needs the program ffmpeg, which is not on the PATH; name a .gif file instead.")
    return program


def label_frames(frames: Sequence[Image.Image], name: str, values: Sequence[str]) -> list[Image.Image]:
    """Frames of one size, each above a black strip with `name = value`, on two lines where one has no room for it."""
    width, height = frames[0].size
    size = max(10, min(width, height) // 20)  # Pixels; smaller letters cannot be read.
    font, lines = ImageFont.load_default(size), [[f"{name} = {value}"] for value in values]
    if max(font.getlength(text) for [text] in lines) > width - 2:
        lines = [[shortened(name, font, width - 2), f"= {value}"] for value in values]
    labelled = []
    for frame, some in zip(frames, lines, strict=True):
        labelled.append(Image.new("RGB", (width, height + round(1.3 * size) * len(some)), "black"))
        labelled[-1].paste(frame)
        for number, text in enumerate(some, start=1):
            place = 1, height + number * round(1.3 * size) - 2
            ImageDraw.Draw(labelled[-1]).text(place, text, "white", font, anchor="ld")
    return labelled


def shortened(text: str, font: ImageFont.FreeTypeFont | ImageFont.ImageFont, width: int) -> str:
    """A text cut to a width in pixels, at its beginning, which says less than its end."""
    while font.getlength(text) > width and len(text) > 3:
        text = f"..{text.removeprefix('..')[1:]}"
    return text


def _with_palette(frames: Sequence[Image.Image]) -> list[Image.Image]:
    """The frames in the 256 colours that suit them best, with a fixed pattern that hides the steps between these."""
    # One palette for all, and a pattern that stands still: areas that do not change between frames do not flicker.
    # Eight frames, spread evenly over the animation, choose it.
    places = np.unique(np.linspace(0, len(frames) - 1, 8).round().astype(int))
    together = Image.fromarray(np.concatenate([np.asarray(frames[place]) for place in places]))
    palette = together.quantize(256, kmeans=2)
    width, height = frames[0].size
    pattern = DITHER[np.ix_(np.arange(height) % 4, np.arange(width) % 4)][..., None]

    def reduced(frame: Image.Image) -> Image.Image:
        pixels = np.clip(np.asarray(frame) + pattern, 0, 255).round().astype(np.uint8)
        return Image.fromarray(pixels).quantize(palette=palette, dither=Image.Dither.NONE)

    return [reduced(frame) for frame in frames]


def _write_mp4(path: Path, frames: Sequence[Image.Image], fps: int) -> None:
    width, height = frames[0].size
    raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-s", f"{width}x{height}", "-r", str(fps), "-i", "-"]
    # Players want colour at half the resolution, and so even sides.
    encoded = ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p", "-movflags", "+faststart"]
    command = [require_ffmpeg(path), "-loglevel", "error", "-y", *raw, *encoded]
    with atomic_write(path) as temporary:
        pixels = b"".join(frame.tobytes() for frame in frames)
        done = subprocess.run([*command, str(temporary)], input=pixels, capture_output=True)
        if done.returncode != 0:
            reason = (done.stderr.decode(errors="replace").strip().splitlines() or ["no reason given"])[-1]
            raise RaytraceError(f"{path}: cannot be written: ffmpeg says: {reason}")
