"""The storing of a target: the steps of its numbers, and lossy compression."""

import dataclasses

import numpy as np

from ...images.jpeg import JpegStorage
from ...images.transfer import rounding_of
from ...util.numerics import MAD_TO_SIGMA
from ..problem.observation import Observation
from ..problem.stages import ObservationStage, Scores
from ..problem.unknowns import Covariance, Image, PixelJacobian


class Rounding(ObservationStage):
    """Steps to which the target's numbers are rounded, alike wherever the colour is the same."""

    def score_covariance(self, scores: Scores) -> Covariance:
        """That of equal roundings of equal colours; where they take scores away they do not count."""
        weight = scores.weight * np.asarray(scores.observation.root_weight, np.float64)
        target = np.asarray(scores.observation.target, np.float64)
        added, axes = np.linalg.eigh(rounding_scatter(scores.jacobian, weight, scores.picture, target))
        return (axes * np.maximum(added, 0)) @ axes.T

    def bound(self, observation: Observation) -> Image:
        """Three quarters of a step: half of one, and the roundings of the picture."""
        return 1.5 * rounding_of(np.asarray(observation.target, np.float64))


@dataclasses.dataclass(frozen=True)
class Compression(ObservationStage):
    """A JPEG's compression, which keeps few of the finest patterns, and fewer of colours."""

    storage: JpegStorage

    @property
    def extent(self) -> int:
        """Side of the squares that are compressed together."""
        return self.storage.unit

    def apply(self, observation: Observation, image: Image) -> Image:
        """The picture as it is read back, on average.

        Edges become softer, and colours mix across them. Noise decides for many patterns whether they are kept, so that
        pictures with noise are compressed. It is taken to be white in the stored numbers, as the shot noise of a camera
        nearly is, and as large as the residual's.
        """
        storage, counts = self.storage, observation.counts
        # How large the target's noise is, in the stored numbers.
        numbers, target = storage.encode(image), storage.encode(np.asarray(observation.target, np.float64))
        off = (target - numbers)[:, counts]
        sigma = MAD_TO_SIGMA * np.median(np.abs(off - np.median(off, axis=1, keepdims=True)), axis=1)
        random, total = np.random.default_rng(0), np.zeros_like(image)
        # The noise that is left in a mean of 16 adds a sixteenth to the target's variance.
        draws = 16
        for _ in range(draws):
            total += storage.compress(numbers + sigma[:, None, None] * random.normal(size=image.shape))
        return total / draws


def rounding_scatter(jacobian: PixelJacobian, weight: Image, picture: Image, target: Image) -> Covariance:
    """The part of equal roundings of equal colours in the covariance of `sum(jacobian * weight * residual)`.

    A stored number is off by up to half a step, and by the same wherever the colour is the same: over whole squares of
    a board. So the target is stored again with its steps shifted by parts of one, and the covariance of the pulls is
    that over the shifts, less what they would have if each pixel were rounded on its own. Noise beside the rounding
    makes its errors independent: normal noise of `s` steps leaves `exp(-(2 pi s)^2)` of their correlation (Widrow and
    Kollar 2008, Quantization Noise).

    Args:
        weight: weight of each residual under the loss, and in the residual itself.
    """
    steps = 2 * rounding_of(target)
    stored = (weight > 0) & np.isfinite(steps) & (steps > 0)
    added = np.zeros((len(jacobian), len(jacobian)))
    if not stored.any():
        return added
    # Where each colour lies among the steps, counted from the darkest one.
    value, first = np.unique(target[stored], return_index=True)
    step = steps[stored][first]
    place = np.r_[0.0, np.cumsum(np.diff(value) * 2 / (step[1:] + step[:-1]))]
    # Noise of s steps moves a fraction of .8 s of all numbers beyond their step.
    size = np.interp(picture[stored], value, step)
    beyond = float(np.mean(np.abs(picture[stored] - target[stored]) > size / 2))
    kept = np.exp(-((2 * np.pi * beyond / 0.8) ** 2))
    # Most numbers of many pictures pull at nothing.
    stored &= np.any(jacobian != 0, axis=0)
    colour, size = np.interp(picture[stored], value, place), np.interp(picture[stored], value, step)
    pulling = jacobian[:, stored] * (weight[stored] * size)
    draws = 16
    for shift in (np.arange(draws) + 0.5) / draws:
        off = colour + shift - np.rint(colour + shift)
        together, alone = pulling @ off, pulling * off
        added += kept / draws * (np.outer(together, together) - alone @ alone.T)
    return added
