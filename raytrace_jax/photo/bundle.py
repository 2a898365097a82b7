"""Least squares of a board's corners in photographs: cameras, ball and index together, and how sure all of them are."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import least_squares

from raytrace_jax.photo.geometry import AT, COUNT, Setup, misses, project
from raytrace_jax.photo.lens import LensPrior, Turn
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import TINY

Numbers = Float[Array, " numbers"]


@dataclass(frozen=True)
class AdjustmentOptions:
    """Options of the least squares.

    Args:
        robust: corners that are off by more standard deviations count less; in the last round none counts that is twice
            as far off.
        corner_floor: least standard deviation of a corner in pixels, beside its patch's own spread: what moves one
            corner, a reflection or the shape of the blur, moves its neighbours too. In rooms by POV-Ray .01 to .02 do
            the same; with .03 good corners count for too little, and errors are too large.
        rounds: how often the weights follow the misses, with a least-squares search each time.
    """

    robust: float = 2.5
    corner_floor: float = 0.015
    rounds: int = 6


class Corners(NamedTuple):
    """Corners in a photograph.

    Args:
        pixels: where they are seen.
        places: where they lie on the board.
        spread: the standard deviation of each that is known, in pixels.
    """

    pixels: Float[np.ndarray, "n 2"]
    places: Float[np.ndarray, "n 2"]
    spread: Float[np.ndarray, " n"]

    @classmethod
    def none(cls) -> "Corners":
        """No corners."""
        return cls(np.zeros((0, 2)), np.zeros((0, 2)), np.zeros(0))

    def where(self, chosen: Bool[np.ndarray, " n"]) -> "Corners":
        """The chosen corners."""
        return Corners(self.pixels[chosen], self.places[chosen], self.spread[chosen])


class PhotoView(NamedTuple):
    """A photograph in the adjustment.

    Args:
        setup: where to begin.
        scale: about how far each number may move; 0 holds it.
        size: width and height.
        direct, through: its corners.
        turn: how its lens follows from that of the first view, which may have been turned otherwise.
    """

    setup: Setup
    scale: Setup
    size: tuple[int, int]
    direct: Corners
    through: Corners
    turn: Turn = Turn()


class Known(NamedTuple):
    """What is known of the numbers before: a Gaussian.

    Args:
        mean: of each number of the first view; of what is not known it means nothing.
        root: a square root of the precision matrix; no rows know nothing.
    """

    mean: Float[np.ndarray, " numbers"]
    root: Float[np.ndarray, "rows numbers"]


def known_before(lens: LensPrior, radius: tuple[float, float]) -> Known:
    """What is known before: the lens, and the radius with its standard deviation; 0 is exact."""
    mean, root = np.zeros(COUNT), np.zeros((len(AT.lens) + 1, COUNT))
    mean[AT.lens], mean[AT.radius] = lens.mean, radius[0]
    variance = np.diagonal(lens.covariance)
    is_known = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if len(is_known):
        precision = np.linalg.inv(lens.covariance[np.ix_(is_known, is_known)])
        root[np.ix_(np.arange(len(is_known)), AT.lens[is_known])] = np.linalg.cholesky(precision).T
    if radius[1] > 0:
        root[-1, AT.radius] = 1 / radius[1]
    return Known(mean, root)


def step_scales(setup: Setup, radius: tuple[float, float], lens: LensPrior) -> Setup:
    """About how far each number may move; 0 for what is known exactly."""
    distance = float(np.linalg.norm(setup.translation))
    of_lens = np.array([1.0, 0.02, 0.02, 0.01, 0.01]) * (np.diagonal(lens.covariance) > 0)
    pose, ball = np.repeat([0.02, 0.02 * distance], 3), [0.05, *[0.1 * radius[0]] * 3, radius[1]]
    return Setup.of(np.concatenate([pose, of_lens, ball]))


class AdjustedView(NamedTuple):
    """What least squares found of one view.

    Args:
        setup: the estimate.
        covariance: of its numbers, from all corners' scatter and what was known.
        sigma: the standard deviation of a coordinate in pixels, of what is seen directly and of what through the glass.
        used: which corners count.
    """

    setup: Setup
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    used: tuple[Bool[np.ndarray, " direct"], Bool[np.ndarray, " through"]]

    @property
    def errors(self) -> Setup:
        """The standard deviation of each number."""
        return Setup.of(np.sqrt(np.diagonal(self.covariance)))


class Adjusted(NamedTuple):
    """What least squares found.

    Args:
        views: each view's numbers.
        joint: all numbers: those of the first view, then of each other one what is its own (`Setup.own`).
        covariance: of all these.
        known: what was known of all these before.
        cost: half the sum of the squares, in standard deviations.
    """

    views: tuple[AdjustedView, ...]
    joint: Float[np.ndarray, " joint"]
    covariance: Float[np.ndarray, "joint joint"]
    known: Known
    cost: float


def adjust(views: Sequence[PhotoView], known: Known, options: AdjustmentOptions = AdjustmentOptions()) -> Adjusted:
    """Find the numbers at which corners miss least.

    Lens, index and radius are common to all views. In each what is seen directly and what through the glass has its own
    scatter, told from the median of its misses. Corners beyond `robust` of it count as in Huber's loss (1964), in the
    last round those beyond twice that not at all.

    Args:
        views: photographs with one camera of one ball; the first begins with what is common. One without corners
            through the glass needs none of a ball's numbers.
        known: what is known before.

    Returns:
        The numbers, their covariance, the corners' scatter, and which corners count.
    """
    system = _System(views, known)
    believed = [np.hypot(group.spread, options.corner_floor) for group in system.groups]
    weights = [_Weights(1.0, np.ones(len(sigma), bool), np.ones(len(sigma))) for sigma in believed]
    x = np.zeros(len(system.free))

    # Scatter and weights follow from the misses at the present numbers, the numbers from these, and so on.
    residual, jacobian = np.zeros(0), np.zeros((0, len(x)))
    for number in range(options.rounds):
        off = [np.linalg.norm(value, axis=-1) for value, _ in system.misses(x)]
        is_last = number == options.rounds - 1
        weights = [
            _reweighted(length / sigma, before.used, options.robust, is_last)
            for length, sigma, before in zip(off, believed, weights, strict=True)
        ]
        by = [np.sqrt(one.weight) / (one.factor * sigma) for one, sigma in zip(weights, believed, strict=True)]

        def value(x, by=by):
            return system.rows(x, by)[0]

        def slope(x, by=by):
            return system.rows(x, by)[1]

        x = least_squares(value, x, jac=slope, max_nfev=60).x  # pyright: ignore[reportArgumentType]
        residual, jacobian = system.rows(x, by)

    # The last round's rows tell how sure the numbers are.
    covariance = system.covariance(jacobian)
    sigma = [
        float(one.factor * np.median(least)) if len(least) else 0.0
        for one, least in zip(weights, believed, strict=True)
    ]
    joint, found = system.joint(x), []
    for k in range(len(views)):
        numbers, chain = system.view(joint, k)
        i, j = 2 * k, 2 * k + 1
        used = weights[i].used, weights[j].used
        found.append(AdjustedView(Setup.of(numbers), chain @ covariance @ chain.T, (sigma[i], sigma[j]), used))
    return Adjusted(tuple(found), joint, covariance, system.known, float(residual @ residual) / 2)


class _Weights(NamedTuple):
    """How much each corner of a group counts, which ones count at all, and their scatter over the believed one."""

    factor: float
    used: Bool[np.ndarray, " n"]
    weight: Float[np.ndarray, " n"]


def _reweighted(
    length: Float[np.ndarray, " n"], used: Bool[np.ndarray, " n"], robust: float, is_last: bool
) -> _Weights:
    """The weights that follow from misses, whose lengths are in standard deviations."""
    # The median length of two normal coordinates of standard deviation 1 is sqrt(2 ln 2).
    factor = max(float(np.median(length[used])) / 1.1774, 1.0) if used.any() else 1.0
    used = length / factor < 2 * robust
    weight = used.astype(float) if is_last else np.minimum(1, robust / np.maximum(length / factor, TINY))
    return _Weights(factor, used, weight)


class _System:
    """The linearized misses of all corners by the free numbers of all views, each in its own scale."""

    def __init__(self, views: Sequence[PhotoView], known: Known):
        first, others = views[0], views[1:]
        self.views = views
        self.groups = [group for view in views for group in (view.direct, view.through)]
        self.start = np.concatenate([first.setup.vector, *(view.setup.own for view in others)])
        scale = np.concatenate([first.scale.vector, *(view.scale.own for view in others)])
        self.free = np.flatnonzero(scale > 0)
        self.scale = scale[self.free]
        more = (0, len(self.start) - COUNT)
        self.known = Known(np.pad(known.mean, more), np.pad(known.root, ((0, 0), more)))
        self._padded = [(padded(view.direct), padded(view.through)) for view in views]
        self._kept: tuple[bytes | None, list] = (None, [])

    def joint(self, x: Float[np.ndarray, " free"]) -> Float[np.ndarray, " joint"]:
        """All numbers, in their units."""
        joint = np.array(self.start)
        joint[self.free] += x * self.scale
        return joint

    def view(
        self, joint: Float[np.ndarray, " joint"], k: int
    ) -> tuple[Float[np.ndarray, " numbers"], Float[np.ndarray, "numbers joint"]]:
        """A view's numbers, and their derivative by all."""
        places = _places(k)
        numbers, slope = joint[places], np.eye(len(joint))[places]
        numbers[AT.lens], turned = self.views[k].turn(numbers[AT.lens])
        slope[AT.lens] = turned @ slope[AT.lens]
        return numbers, slope

    def misses(self, x: Float[np.ndarray, " free"]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Each group's misses in pixels, and their derivatives by `x`.

        SciPy asks for values and slopes one after the other at the same place: one program gives both, once.
        """
        if self._kept[0] != (key := x.tobytes()):
            joint, found = self.joint(x), []
            for k, view in enumerate(self.views):
                numbers, chain = self.view(joint, k)
                both = linearized(numbers, np.asarray(view.size, float), *self._padded[k])
                for value, slope, group in zip(*both, (view.direct, view.through), strict=True):
                    count = len(group.pixels)
                    found.append(
                        (np.asarray(value)[:count], np.asarray(slope)[:count] @ chain[:, self.free] * self.scale)
                    )
            self._kept = key, found
        return self._kept[1]

    def rows(self, x: Float[np.ndarray, " free"], by: Sequence[Float[np.ndarray, " n"]]):
        """The residual and its Jacobian: each corner's misses times its factor, then rows of what was known."""
        values, slopes = [], []
        for (value, slope), factor in zip(self.misses(x), by, strict=True):
            values.append((value * factor[:, None]).reshape(-1))
            slopes.append((slope * factor[:, None, None]).reshape(-1, len(x)))
        mean, root = self.known
        values.append(root @ (self.joint(x) - mean))
        slopes.append(root[:, self.free] * self.scale)
        return np.concatenate(values), np.concatenate(slopes)

    def covariance(self, jacobian: Float[np.ndarray, "rows free"]) -> Float[np.ndarray, "joint joint"]:
        """The covariance of all numbers; 0 of those that are held."""
        covariance = np.zeros((len(self.start), len(self.start)))
        of_free = np.linalg.pinv(jacobian.T @ jacobian) * np.outer(self.scale, self.scale)
        covariance[np.ix_(self.free, self.free)] = of_free
        return covariance


def _places(k: int) -> Int[np.ndarray, " numbers"]:
    """Where the numbers of a view are among all."""
    places = np.array(AT.vector)
    if k:
        places[AT.own] = COUNT + (k - 1) * len(AT.own) + np.arange(len(AT.own))
    return places


@jit
def linearized(numbers: Numbers, size: Float[Array, "2"], direct, through):
    """The misses of both groups of corners in pixels, and their derivatives by the numbers of a set-up."""

    def both(numbers):
        setup, (pixels, places), (pixels_through, places_through) = Setup.of(numbers), direct, through
        flat = jnp.concatenate([places, jnp.zeros_like(places[:, :1])], axis=1)
        return project(setup, size, flat) - pixels, misses(setup, size, pixels_through, places_through)

    return both(numbers), jax.jacfwd(both)(numbers)


def padded(corners: Corners) -> tuple[Float[np.ndarray, "padded 2"], Float[np.ndarray, "padded 2"]]:
    """Pixels and places, with zeros up to a multiple of 256, so that photographs share programs."""
    more = -len(corners.pixels) % 256 if len(corners.pixels) else 256
    wider = ((0, more), (0, 0))
    return np.pad(corners.pixels, wider), np.pad(corners.places, wider)
