"""A calibrated lens as a file: TOML with its numbers, their covariance and the size of its pictures."""

import os
import tomllib

import numpy as np

from raytrace_jax.errors import RaytraceError
from raytrace_jax.photo.locate import Lens
from raytrace_jax.util.files import read_bytes, write_text

SAME_SHAPE = 1e-3
"""Ratios of width to height that differ by less are one: a picture may have been made smaller since."""


def write_lens(path: str | os.PathLike[str], lens: Lens, size: tuple[int, int], comment: str) -> None:
    """Write a lens.

    Args:
        path: the file.
        lens: its numbers.
        size: width and height of the pictures that it was found from.
        comment: a line on where it comes from.
    """
    rows = ",\n  ".join("[" + ", ".join(f"{x:.12g}" for x in row) + "]" for row in lens.covariance)
    text = (
        f"# {comment}\n"
        "# Full horizontal angle of view in degrees, k1 and k2, and the covariance of the three.\n"
        f"fov = {lens.mean[0]:.12g}\nk1 = {lens.mean[1]:.12g}\nk2 = {lens.mean[2]:.12g}\n"
        f"size = [{size[0]}, {size[1]}]\ncovariance = [\n  {rows},\n]\n"
    )
    write_text(path, text)


def read_lens(path: str | os.PathLike[str], size: tuple[int, int]) -> Lens:
    """Read a lens for pictures of a size.

    Args:
        path: a file as `raytrace-jax calibrate` writes it.
        size: width and height of the picture that it is for.

    Returns:
        The lens.

    Raises:
        RaytraceError: the file is none of a lens, or of pictures of another shape.
    """
    try:
        kept = tomllib.loads(read_bytes(path).decode())
        mean = np.array([float(kept[name]) for name in ("fov", "k1", "k2")])
        covariance = np.array(kept["covariance"], float)
        width, height = (int(side) for side in kept["size"])
        fits = covariance.shape == (3, 3) and np.isfinite(covariance).all() and np.isfinite(mean).all()
        fits = fits and 0 < mean[0] < 180 and min(width, height) > 0
    except (ValueError, KeyError, TypeError, ArithmeticError):
        fits, mean, covariance, width, height = False, np.zeros(3), np.zeros((3, 3)), 1, 1
    if not fits or np.any(np.linalg.eigvalsh(covariance) <= 0):
        raise RaytraceError(f"{path}: is no lens; one as `raytrace-jax calibrate` writes it is wanted.")
    if abs(width / height * size[1] / size[0] - 1) > SAME_SHAPE:
        raise RaytraceError(
            f"{path}: is the lens of pictures of {width} x {height} pixels, and this one has {size[0]} x {size[1]}: "
            "calibrate with pictures of the same shape, taken as this one was."
        )
    return Lens(mean, covariance)
