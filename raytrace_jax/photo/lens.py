"""What is known of a camera's lens, and a file for it: TOML with its numbers, their covariance, its pictures' size."""

import tomllib
import warnings
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import RaytraceError, RaytraceWarning
from ..images.exif import BACK
from ..util.files import StrPath, read_bytes, write_text

PictureSize = tuple[int, int]
"""Width and height in pixels."""

LensNumbers = Float[np.ndarray, "5"]
"""Angle of view in degrees, k1, k2, and the principal point in widths of the picture."""

USUAL = np.array([0.1, 0.05, 0.01, 0.01])
"""Standard deviations of k1, k2 and the principal point of a lens that was not calibrated.

Cameras correct distortion, or nearly, and lenses are placed to a hundredth of their picture's width."""


class LensPrior(NamedTuple):
    """What is known of a camera's lens before.

    Args:
        mean: its angle of view, k1 and k2, and its principal point, as `photo.cameras` has them.
        covariance: of these five; infinite where nothing is known.
    """

    mean: LensNumbers
    covariance: Float[np.ndarray, "5 5"]

    @property
    def errors(self) -> LensNumbers:
        return np.sqrt(np.diagonal(self.covariance))

    def camera_matrix(self, size: PictureSize, fov: float) -> Float[np.ndarray, "3 3"]:
        """OpenCV's camera matrix for pictures of this width and height, with this angle of view in degrees."""
        focal = size[0] / (2 * np.tan(np.radians(fov) / 2))
        across, down = (np.asarray(size) - 1) / 2 + self.mean[3:] * size[0]
        return np.array([[focal, 0, across], [0, focal, down], [0, 0, 1]])

    @property
    def opencv_distortion(self) -> Float[np.ndarray, "4"]:
        """OpenCV's distortion: k1 and k2, and none aside."""
        return np.array([*self.mean[1:3], 0.0, 0.0])

    @property
    def has_fov(self) -> bool:
        """Whether anything is known of the angle of view."""
        return bool(np.isfinite(self.covariance[0, 0]))


def uncalibrated(fov: float | None = None, spread: float = 0.0) -> LensPrior:
    """A lens of which at most the angle of view is known, in degrees, with its standard deviation."""
    variance = spread**2 if fov else np.inf
    return LensPrior(np.array([fov or 0.0, 0, 0, 0, 0]), np.diag([variance, *USUAL**2]))


class Turn(NamedTuple):
    """How the lens of a picture follows from that of another one by the same camera, which EXIF may turn otherwise.

    Args:
        size: width and height of both on the sensor.
        before, after: how EXIF says that the other one, and this one, are turned; 1 is as the sensor has it.
    """

    size: PictureSize = (1, 1)
    before: int = 1
    after: int = 1

    def of(self, lens: LensPrior) -> LensPrior:
        """The lens, with its covariance, which may be infinite."""
        mean, places, factors = self(lens.mean)
        return LensPrior(mean, lens.covariance[np.ix_(places, places)] * np.outer(factors, factors))

    def __call__(self, mean: LensNumbers):
        """The lens's numbers, which one of the other's each follows from, and its derivative by that one."""
        places, factors = np.arange(5), np.ones(5)
        if self.before == self.after:
            return mean, places, factors
        # To the sensor and from there, each with the size before.
        upright = self.size if self.before < 5 else (self.size[1], self.size[0])
        for orientation, size in ((BACK.get(self.before, self.before), upright), (self.after, self.size)):
            mean, here, by = _turned(mean, orientation, size)
            places, factors = places[here], by * factors[here]
        return mean, places, factors


def _turned(mean: LensNumbers, orientation: int, size: PictureSize):
    """As `Turn`, of one turn to or from the sensor."""
    mean, places, factors = np.array(mean), np.arange(5), np.ones(5)
    if orientation > 4:
        # Rows become columns: the angle is that of the other side, and so are the widths.
        share, slope = size[1] / size[0], np.tan(np.radians(mean[0]) / 2)
        mean[0] = np.degrees(2 * np.arctan(slope * share))
        mean[3:] = mean[[4, 3]] / share
        places[3:] = 4, 3
        factors[0], factors[3:] = share * (1 + slope**2) / (1 + (slope * share) ** 2), 1 / share
    signs = np.array([1, 1, 1, -1 if orientation in (2, 3, 6, 7) else 1, -1 if orientation in (3, 4, 7, 8) else 1])
    return mean * signs, places, signs * factors


def write_lens(path: StrPath, lens: LensPrior, size: PictureSize, comment: str) -> None:
    """Write a lens, with a comment on where it comes from; `size` is that of its pictures, as the sensor has them."""
    rows = ",\n  ".join("[" + ", ".join(f"{x:.12g}" for x in row) + "]" for row in lens.covariance)
    text = (
        f"# {comment}\n"
        "# Full horizontal angle of view in degrees, k1 and k2, how far the principal point is to the right of and\n"
        "# below the middle, in widths of the picture, as the sensor has it: turns by EXIF are undone; and the\n"
        "# covariance of the five.\n"
        f"fov = {lens.mean[0]:.12g}\nk1 = {lens.mean[1]:.12g}\nk2 = {lens.mean[2]:.12g}\n"
        f"center = [{lens.mean[3]:.12g}, {lens.mean[4]:.12g}]\n"
        f"size = [{size[0]}, {size[1]}]\ncovariance = [\n  {rows},\n]\n"
    )
    write_text(path, text)


def read_lens(path: StrPath, size: PictureSize) -> LensPrior:
    """Read a lens, as `raytrace-jax calibrate` writes it, for a picture of this size on the sensor.

    Of a lens whose pictures are as high as this one is wide, as programs turn them, a RaytraceWarning tells.

    Raises:
        RaytraceError: the file is none of a lens, or of pictures of another shape.
    """
    try:
        kept = tomllib.loads(read_bytes(path).decode())
        mean = np.array([*(float(kept[name]) for name in ("fov", "k1", "k2")), *map(float, kept["center"])])
        covariance = np.array(kept["covariance"], float)
        width, height = (int(side) for side in kept["size"])
        np.linalg.cholesky(covariance)  # It is positive definite, and finite.
        fits = covariance.shape == (5, 5) and mean.shape == (5,) and np.isfinite([*mean, *covariance.ravel()]).all()
        if not (fits and 0 < mean[0] < 180 and min(width, height) > 0):
            raise ValueError
    except (ValueError, KeyError, TypeError, ArithmeticError):  # LinAlgError is a ValueError.
        raise RaytraceError(f"{path}: is no lens; one as `raytrace-jax calibrate` writes it is wanted.") from None
    # A picture that was made smaller since has the same shape but for rounding.
    lens, share = LensPrior(mean, covariance), size[0] / size[1]
    if abs(width / height / share - 1) < 1e-3:
        return lens
    if abs(height / width / share - 1) > 1e-3:
        raise RaytraceError(
            f"{path}: is the lens of pictures of {width} x {height} pixels, and this one has {size[0]} x {size[1]}: "
            "calibrate with pictures of the same shape, taken as this one was."
        )
    warnings.warn(
        f"{path}: is the lens of pictures of {width} x {height} pixels, and this one has {size[0]} x {size[1]}: it is "
        "turned by a quarter, and to which side is not known. Calibrate with pictures that say how they are turned.",
        RaytraceWarning,
        stacklevel=2,
    )
    # Of two principal points that are as likely, on opposite sides of the middle, mean and covariance.
    lens = Turn((width, height), after=6).of(lens)
    offset = lens.mean * [0, 0, 0, 1, 1]
    return LensPrior(lens.mean - offset, lens.covariance + np.outer(offset, offset))
