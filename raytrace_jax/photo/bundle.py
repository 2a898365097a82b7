"""Least squares of a board's corners in photographs: cameras, ball and index together, and how sure all of them are."""

import functools
from collections.abc import Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy.optimize import least_squares

from raytrace_jax.photo.cameras import COUNT, LENS, POSE, project
from raytrace_jax.photo.lens import Turn
from raytrace_jax.photo.through_glass import CENTER, misses
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import TINY

ROBUST = 2.5
"""A corner that is off by more standard deviations counts less; in the last round none counts that is twice as far."""

TRUE_TO = 0.015
"""Corners are believed to so many pixels at best, beside their patch's own spread, for what moves one corner, a
reflection or the shape of the blur, moves its neighbours too. In rooms by POV-Ray .01 to .02 do the same; with .03 good
corners count for too little, and errors are too large."""

ROUNDS = 6
"""How often the weights follow the misses, with a least-squares search each time."""

PADDED = 256
"""Corners come in multiples of this, so that photographs share programs."""

BALL = slice(COUNT, COUNT + 5)
"""Places of the ball's numbers among those of a photograph; the camera's come first."""

OWN = np.r_[POSE, COUNT + CENTER.start : COUNT + CENTER.stop]
"""Places of the numbers that each photograph has of its own, its pose and the ball's middle; lens, index and radius are
common."""

Numbers = Float[Array, " numbers"]


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
        numbers: where to begin, the camera's and the ball's.
        scale: about how far each number may move; 0 holds it.
        size: width and height.
        direct, through: its corners.
        turn: how its lens follows from that of the first view, which may have been turned otherwise.
    """

    numbers: Float[np.ndarray, " numbers"]
    scale: Float[np.ndarray, " numbers"]
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


class Seen(NamedTuple):
    """What least squares found of one view.

    Args:
        numbers: the estimate.
        covariance: of the numbers, from all corners' scatter and what was known.
        sigma: the standard deviation of a coordinate in pixels, of what is seen directly and of what through the glass.
        used: which corners count.
    """

    numbers: Float[np.ndarray, " numbers"]
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    used: tuple[Bool[np.ndarray, " direct"], Bool[np.ndarray, " through"]]


class Adjusted(NamedTuple):
    """What least squares found.

    Args:
        views: each view's numbers.
        joint: all numbers: those of the first view, then of each other one what is its own (`OWN`).
        covariance: of all these.
        known: what was known of all these before.
        cost: half the sum of the squares, in standard deviations.
    """

    views: tuple[Seen, ...]
    joint: Float[np.ndarray, " joint"]
    covariance: Float[np.ndarray, "joint joint"]
    known: Known
    cost: float


def adjust(views: Sequence[PhotoView], known: Known) -> Adjusted:
    """Find the numbers at which corners miss least.

    Lens, index and radius are common to all views. In each what is seen directly and what through the glass has its own
    scatter, told from the median of its misses. Corners beyond `ROBUST` of it count as in Huber's loss (1964), in the
    last round those beyond twice that not at all.

    Args:
        views: photographs with one camera of one ball; the first begins with what is common. One without corners
            through the glass needs none of a ball's numbers.
        known: what is known before.

    Returns:
        The numbers, their covariance, the corners' scatter, and which corners count.
    """
    first = views[0]
    start = np.concatenate([first.numbers, *(view.numbers[OWN] for view in views[1:])])
    scale = np.concatenate([first.scale, *(view.scale[OWN] for view in views[1:])])
    more = (0, len(start) - len(first.numbers))
    known = Known(np.pad(known.mean, more), np.pad(known.root, ((0, 0), more)))
    places = [_places(k, len(first.numbers)) for k in range(len(views))]

    # The search moves the free numbers, each in its own scale, so that steps are alike.
    free = np.flatnonzero(scale > 0)
    spread = scale[free]
    groups = [group for view in views for group in (view.direct, view.through)]
    padded = [(_padded(view.direct), _padded(view.through)) for view in views]

    def joint_at(x):
        joint = np.array(start, float)
        joint[free] += x * spread
        return joint

    def numbers_at(joint, k: int):
        """A view's numbers, and how they follow from the free ones."""
        numbers, slope = np.array(joint[places[k]]), np.zeros((len(places[k]), len(start)))
        slope[np.arange(len(places[k])), places[k]] = 1.0
        numbers[LENS], turned = views[k].turn(numbers[LENS])
        slope[LENS] = turned @ slope[LENS]
        return numbers, slope

    # SciPy asks for rows and slopes one after the other at the same place: one program gives both, once.
    @functools.lru_cache(maxsize=2)
    def looked_up(key: bytes):
        joint, found = joint_at(np.frombuffer(key)), []
        for k, view in enumerate(views):
            numbers, chain = numbers_at(joint, k)
            values, slopes = _linearized(numbers, np.asarray(view.size, float), *padded[k])
            for value, slope, group in zip(values, slopes, (view.direct, view.through), strict=True):
                count = len(group.pixels)
                found.append((np.asarray(value)[:count], np.asarray(slope)[:count] @ chain[:, free] * spread))
        return found

    # A row of the system is a miss over its scatter, times its weight; what was known adds rows of its own.
    at_root = known.root[:, free] * spread
    at_start = known.root @ (start - known.mean)
    believed = [np.hypot(group.spread, TRUE_TO) for group in groups]
    x, factors, used = np.zeros(len(free)), [1.0] * len(groups), [np.ones(len(group.pixels), bool) for group in groups]
    weights = [one.astype(float) for one in used]

    def rows(x):
        parts = []
        for (value, slope), sigma, factor, weight in zip(
            looked_up(x.tobytes()), believed, factors, weights, strict=True
        ):
            by = (np.sqrt(weight) / (factor * sigma))[:, None]
            parts.append(((value * by).reshape(-1), (slope * by[..., None]).reshape(-1, len(x))))
        parts.append((at_root @ x + at_start, at_root))
        return tuple(np.concatenate(part) for part in zip(*parts, strict=True))

    # Scatter and weights follow from the misses at the present numbers, the numbers from these, and so on.
    for number in range(ROUNDS):
        lengths = [
            np.linalg.norm(value, axis=-1) / sigma
            for (value, _), sigma in zip(looked_up(x.tobytes()), believed, strict=True)
        ]
        # The median length of two normal coordinates of standard deviation 1 is sqrt(2 ln 2).
        factors = [float(np.median(n[u])) / 1.1774 if u.any() else 1.0 for n, u in zip(lengths, used, strict=True)]
        factors = [max(factor, 1.0) for factor in factors]
        off = [length / factor for length, factor in zip(lengths, factors, strict=True)]
        used = [one < 2 * ROBUST for one in off]
        last = number == ROUNDS - 1
        weights = [
            u.astype(float) if last else np.minimum(1, ROBUST / np.maximum(o, TINY))
            for u, o in zip(used, off, strict=True)
        ]
        x = least_squares(lambda x: rows(x)[0], x, jac=lambda x: rows(x)[1], max_nfev=60).x  # pyright: ignore[reportArgumentType]

    # The last round's rows tell how sure the numbers are.
    residual, jacobian = rows(x)
    covariance = np.zeros((len(start), len(start)))
    covariance[np.ix_(free, free)] = np.linalg.pinv(jacobian.T @ jacobian) * np.outer(spread, spread)
    sigma = [float(f * np.median(s)) if len(s) else 0.0 for f, s in zip(factors, believed, strict=True)]
    joint, seen = joint_at(x), []
    for k in range(len(views)):
        numbers, chain = numbers_at(joint, k)
        i, j = 2 * k, 2 * k + 1
        seen.append(Seen(numbers, chain @ covariance @ chain.T, (sigma[i], sigma[j]), (used[i], used[j])))
    return Adjusted(tuple(seen), joint, covariance, known, float(residual @ residual) / 2)


def _places(k: int, count: int) -> Int[np.ndarray, " numbers"]:
    """Where the numbers of a view are among all."""
    places = np.arange(count)
    if k:
        places[OWN] = count + (k - 1) * len(OWN) + np.arange(len(OWN))
    return places


@jit
def _linearized(numbers: Numbers, size: Float[Array, "2"], direct, through):
    """The misses of both groups of corners in pixels, and their derivatives by the numbers."""

    def both(numbers):
        (pixels, places), (pixels_through, places_through) = direct, through
        flat = jnp.concatenate([places, jnp.zeros_like(places[:, :1])], axis=1)
        camera = numbers[:COUNT]
        return project(camera, size, flat) - pixels, misses(camera, numbers[BALL], size, pixels_through, places_through)

    return both(numbers), jax.jacfwd(both)(numbers)


def _padded(corners: Corners) -> tuple[Float[np.ndarray, "padded 2"], Float[np.ndarray, "padded 2"]]:
    """Pixels and places, with zeros up to a multiple of `PADDED`."""
    more = -len(corners.pixels) % PADDED if len(corners.pixels) else PADDED
    wider = ((0, more), (0, 0))
    return np.pad(corners.pixels, wider), np.pad(corners.places, wider)
