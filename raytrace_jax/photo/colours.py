"""Dispersion from photographs: the corners of the board in red, green and blue.

Camera, ball or tank, and ruler are common to the three, so that differences of the index follow from where each channel
shows a corner, far better known than the index itself. What is seen directly tells how much larger the lens draws one
colour than another (lateral colour); what is seen through the glass shows that and the difference of the index.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..images.jpeg import JpegStorage
from .alignment import ColourPatches
from .geometry import Setup
from .locate import Located
from .photograph import Image, Places
from .sight import Projection

WAVELENGTHS = ((600.0, 8.0), (540.0, 8.0), (460.0, 8.0))
"""Mean wavelengths of a usual sensor's red, green and blue in daylight, with their standard deviations, in nm."""

LEAST_CONTRAST = 0.05
"""The least contrast of a channel, as a share of the largest, with which it shows corners."""


class ColourDifferences(NamedTuple):
    """How much the index of red, green and blue differs from that of their mean.

    Args:
        of_index, covariance: the differences.
        lateral: by how many pixels each channel shows the picture's corner farther out than their mean.
        scatter: of a corner, in pixels.
    """

    of_index: Float[np.ndarray, "3"]
    covariance: Float[np.ndarray, "3 3"]
    lateral: Float[np.ndarray, "3"]
    scatter: float

    def indices(self, mean: tuple[float, float]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 3"]]:
        """The index of each channel and their covariance, of a mean index with its standard deviation."""
        return mean[0] + self.of_index, mean[1] ** 2 + self.covariance


def colour_differences(image: Image, located: Located, storage: JpegStorage | None = None) -> ColourDifferences | None:
    """Measure the corners of a photograph in each channel; None of a grey one, or of one with too few corners.

    A JPEG whose colours have half the pixels pulls red and blue to grey. So patches of the photograph's mean, in which
    each channel is shifted as was measured, are compressed as the file was and measured again: what that loses of their
    shifts is added to the measured ones (indirect inference: Gourieroux, Monfort and Renault 1993).

    Args:
        image: scene-linear.
        located: camera, ball or tank, and corners in the mean of its channels.
        storage: how the file was compressed, if it was.
    """
    if not np.any(np.ptp(image, axis=0)):
        return None
    # The corners beside the glass and through it, and how the latter move with the index.
    # A hundred corners beside it tell the lens's four numbers.
    every = -(-len(located.direct.pixels) // 120) or 1
    direct = located.direct.where(np.arange(len(located.direct.pixels)) % every == 0)
    sight, groups = located.sight, (direct, located.through)
    looks = zip(groups, (sight.directly, sight.through), strict=True)
    patches = [ColourPatches(image, located.board, group, see, located.blur) for group, see in looks]
    beside, behind = (group.where(each.fits) for group, each in zip(groups, patches, strict=True))
    beside_count = len(beside.pixels)
    slopes = np.concatenate([np.zeros_like(beside.pixels), sight.index_slope(behind.pixels)])
    steps, contrast = (np.concatenate(part, 1) for part in zip(*(each.steps() for each in patches), strict=True))
    counts: Bool[np.ndarray, " n"] = np.all(np.isfinite(steps), axis=(0, 2))
    share = np.nanmean(np.where(counts, contrast, np.nan), axis=1) if counts.any() else np.zeros(3)
    is_enough = int(np.sum(counts)) >= 12 and int(np.sum(counts[beside_count:])) >= 6
    if not (is_enough and share.min() > LEAST_CONTRAST * share.max()):
        return None
    share /= share.sum()
    design = _design(np.concatenate([beside.pixels, behind.pixels]), slopes, located.size)
    spread = np.concatenate([beside.spread, behind.spread])

    def adjusted(steps: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Numbers of the design, the covariance of the last of each channel, and the scatter."""
        return _adjust((steps - np.tensordot(share, steps, 1))[:, counts], design[:, counts], spread[counts])

    numbers, covariance, scatter = adjusted(steps)
    if storage:
        rounds = [numbers]
        for _ in range(2):
            applied = np.einsum("cp,pni->cni", rounds[-1], design)
            split = zip(patches, np.split(applied, [beside_count], axis=1), strict=True)
            left = np.concatenate([each.steps(part, storage, share)[0] for each, part in split], axis=1)
            numbers, covariance, scatter = adjusted(steps + np.where(np.isfinite(left), applied - left, 0.0))
            rounds.append(numbers)
        # The numbers grow towards the true ones by a factor from round to round: a geometric series (Aitken 1926).
        first, second = np.diff(rounds, axis=0)
        factor = np.clip(np.sum(second[:, -1] * first[:, -1]) / max(np.sum(first[:, -1] ** 2), 1e-300), 0.0, 0.8)
        numbers = numbers + second * factor / (1 - factor)
        # A tenth of what was added is not believed.
        added = numbers[:, -1] - rounds[0][:, -1]
        covariance = covariance + 0.1**2 * np.outer(added, added)
    # All differences are in proportion to those that the geometry makes: where index and centre are off, so are they.
    off = Projection(_off_by_an_error(located), located.size).index_slope(behind.pixels) - slopes[beside_count:]
    share_off = np.sum(off * slopes[beside_count:]) / max(np.sum(slopes**2), 1e-300)
    covariance = covariance + np.outer(numbers[:, -1], numbers[:, -1]) * share_off**2
    return ColourDifferences(numbers[:, -1], covariance, numbers[:, 2] + numbers[:, 3], scatter)


def _off_by_an_error(located: Located) -> Setup:
    """The set-up whose index is larger by its standard deviation, and whose other numbers follow."""
    (index,) = located.setup.places("index")
    column = located.covariance[:, index]
    return located.setup.at(located.setup.vector + column / np.sqrt(max(column[index], 1e-300)))


def _design(pixels: Places, slopes: Places, size: tuple[int, int]) -> Float[np.ndarray, "5 n 2"]:
    """How corners move in the picture with a lens's lateral colour, and with the index.

    The rows are a shift along both axes, the scale, which is a pixel at the picture's corner, its growth with the
    squared distance from the middle, and the index.
    """
    middle = (np.array(size) - 1) / 2
    away = (pixels - middle) / np.linalg.norm(middle)
    right, down = (np.broadcast_to(axis, pixels.shape) for axis in np.eye(2))
    return np.stack([right, down, away, away * np.sum(away**2, axis=1, keepdims=True), slopes])


def _adjust(
    differences: Float[np.ndarray, "3 n 2"], design: Float[np.ndarray, "numbers n 2"], spread: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "3 numbers"], Float[np.ndarray, "3 3"], float]:
    """Least squares of all channels with one design; corners beyond 2.5 times the usual miss count as in Huber's loss.

    Channels err together: their covariance is that of their misses (seemingly unrelated regressions: Zellner 1962).
    """
    weight, rows = (np.median(spread) / spread) ** 2, design.reshape(len(design), -1)
    count = differences.shape[1]
    robust, numbers, misses = np.ones(count), np.zeros((3, len(rows))), differences
    normal = np.eye(len(rows))
    for _ in range(6):
        both = np.repeat(weight * robust, 2)
        normal = (rows * both) @ rows.T
        numbers = np.linalg.solve(normal, (rows * both) @ differences.reshape(3, -1).T).T
        misses = differences - np.einsum("cp,pni->cni", numbers, design)
        lengths = np.sqrt(weight * np.max(np.sum(misses**2, axis=2), axis=0))
        robust = np.minimum(1.0, 2.5 * np.median(lengths) / np.maximum(lengths, 1e-12))
    scaled = misses * np.sqrt(weight * robust)[:, None]
    among = np.einsum("cni,dni->cd", scaled, scaled) / max(2 * count - len(rows), 1)
    return numbers, among * np.linalg.inv(normal)[-1, -1], float(np.sqrt(np.trace(among) / 3))


def joined(each: Sequence[ColourDifferences]) -> ColourDifferences:
    """The differences of one ball or liquid from several photographs, each with the weight of its variance."""
    weight = np.array([1 / np.trace(one.covariance) for one in each])
    weight /= weight.sum()
    covariance = sum(w**2 * one.covariance for w, one in zip(weight, each, strict=True))
    of_index, lateral = (weight @ np.array([getattr(one, name) for one in each]) for name in ("of_index", "lateral"))
    return ColourDifferences(of_index, np.asarray(covariance), lateral, float(weight @ [one.scatter for one in each]))
