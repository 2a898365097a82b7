"""A camera, from the light of a scene to a JPEG or a PNG of 16 bits.

Scene light -> shift -> vignetting -> point spread -> gains -> offset -> shot and read noise -> clip -> gamma -> sRGB ->
8 or 16 bits -> file. Nothing of it is the package's, so that it can judge what the package says of a photograph.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
import OpenImageIO as oiio
from PIL import Image
from scipy import ndimage


class Chain(NamedTuple):
    """What a camera does to light; without arguments nothing but sRGB, 8 bits and JPEG.

    Args:
        psf: standard deviation of the Gaussian point spread, in pixels.
        gains: of red, green and blue.
        vignetting: the share of light that is lost in the picture's corners; it grows as the square of the distance
            from its middle.
        offset: light that is added everywhere after the gains; 1 saturates. It has shot noise as well.
        gamma: of the clipped light, before sRGB; 1 is none.
        shift: of the scene's light on the sensor, to the right and down, in pixels; vignetting stays.
        full_well: electrons of a light of 1; infinite is no noise at all.
        read_noise: its standard deviation, in electrons.
        quality: of the JPEG.
        seed: of the noise.
    """

    psf: float = 0.0
    gains: tuple[float, float, float] = (1.0, 1.0, 1.0)
    vignetting: float = 0.0
    offset: float = 0.0
    gamma: float = 1.0
    shift: tuple[float, float] = (0.0, 0.0)
    full_well: float = np.inf
    read_noise: float = 0.0
    quality: int = 90
    seed: int = 0


CAMERA = Chain(psf=1.1, gains=(0.97, 0.88, 0.8), vignetting=0.04, full_well=15_000, read_noise=8, quality=90)
"""That of the photographs that are fitted."""


def photograph(linear, chain, path):
    """Take a picture.

    Args:
        linear: "3 height width", the light of the scene, top row first; 1 saturates.
        chain: the camera.
        path: of the picture, `.jpg` or `.png` (16 bits); missing folders are made.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    light = noisy(exposure(linear, chain), chain)
    stored = np.moveaxis(srgb(np.clip(light, 0, 1) ** chain.gamma), 0, -1)
    if path.suffix.lower() in (".jpg", ".jpeg"):
        pixels = np.round(255 * stored).astype(np.uint8)
        Image.fromarray(pixels).save(path, "JPEG", quality=chain.quality, subsampling=0)
    elif path.suffix.lower() == ".png":
        write_png16(path, np.round(65535 * stored).astype(np.uint16))
    else:
        raise ValueError(f"{path}: .jpg or .png is wanted")


def exposure(linear, chain):
    """The mean signal, "3 height width", of which 1 saturates: all before the noise."""
    light = np.asarray(linear, np.float64)
    if any(chain.shift):
        right, down = chain.shift
        light = ndimage.shift(light, (0, down, right), order=3, mode="nearest")
    light = light * falloff(light.shape[1:], chain.vignetting)
    light = ndimage.gaussian_filter(light, (0, chain.psf, chain.psf), mode="nearest")
    return light * np.reshape(chain.gains, (3, 1, 1)) + chain.offset


def falloff(size, vignetting):
    """The share of light that arrives, "height width", for a picture of that height and width."""
    height, width = size
    row, column = np.mgrid[:height, :width]
    right, down = 2 * column + 1 - width, 2 * row + 1 - height
    return 1 - vignetting * (right**2 + down**2) / (width**2 + height**2)


def noisy(signal, chain):
    """The signal with the noise of its electrons, and of their reading."""
    if not np.isfinite(chain.full_well):
        return signal
    random = np.random.default_rng(chain.seed)
    electrons = np.maximum(signal, 0) * chain.full_well
    noise = random.poisson(electrons) - electrons + random.normal(0, chain.read_noise, signal.shape)
    return signal + noise / chain.full_well


def srgb(light):
    """IEC 61966-2-1, from light between 0 and 1."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 0.0031308) ** (1 / 2.4) - 0.055)


def write_png16(path, pixels):
    """Write "height width 3" of 16 bits as a PNG that says that it is sRGB."""
    height, width, channels = pixels.shape
    spec = oiio.ImageSpec(width, height, channels, oiio.UINT16)
    spec.attribute("oiio:ColorSpace", "sRGB")
    file = oiio.ImageOutput.create(str(path))
    if file is None:
        raise OSError(f"{path}: {oiio.geterror()}")
    written = file.open(str(path), spec) and file.write_image(np.ascontiguousarray(pixels))
    if not (written and file.close()):
        raise OSError(f"{path}: {file.geterror()}")
