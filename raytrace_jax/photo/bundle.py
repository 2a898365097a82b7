"""Least squares of a board's corners in photographs: cameras, ball or tank and index together, and how sure all are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from ..util.compilation import jit
from ..util.numerics import TINY
from .geometry import (
    AT,
    COUNT,
    LOST,
    Seen,
    Setup,
    follow_directly,
    follow_through,
    inverse_of,
    pixel_rays,
    project,
)
from .lens import LensPrior, Turn
from .photograph import Corners

Numbers = Float[Array, " numbers"]


CORNER_FLOOR = 0.015
"""Least standard deviation of a corner in pixels, beside its patch's own spread: what moves one corner, a reflection or
the shape of the blur, moves its neighbours too. In rooms by POV-Ray .01 to .02 do the same; with .03 good corners count
for too little, and errors are too large."""

SCATTERS_MORE = 1.5
"""So many times the scatter of a tank's other corners is more than that of corners: something shifts them."""

NEIGHBOURS = 9
"""What shifts a corner shifts its eight neighbours alike, and counts once for all of them."""


class PhotoView(NamedTuple):
    """A photograph in the adjustment.

    Args:
        setup: where to begin.
        size: width and height.
        direct, through: its corners.
        turn: how its lens follows from that of the first view, which may have been turned otherwise.
    """

    setup: Setup
    size: tuple[int, int]
    direct: Corners
    through: Corners
    turn: Turn = Turn()


class Known(NamedTuple):
    """What is known of the numbers before: a Gaussian.

    Args:
        mean: of each number of the first view; of what is not known it means nothing.
        root: a square root of the precision matrix; no rows know nothing.
        scale: about how far each number may move, the translation in distances of the board; 0 holds it.
    """

    mean: Float[np.ndarray, " numbers"]
    root: Float[np.ndarray, "rows numbers"]
    scale: Float[np.ndarray, " numbers"]


Measured = Mapping[str, tuple[float, float]]
"""What was measured of a ball (`radius`, `liquid`, `depth`) or of a tank (`thickness`, `wall`, `wall_ior`, and for both
numbers of its `wedge` one), with standard deviations."""


def known_before(lens: LensPrior, measured: Measured = MappingProxyType({})) -> Known:
    """What is known before: the lens, and what was measured of ball or tank, if there is one.

    What has no error is held.
    """
    mean, rows = np.zeros(COUNT), []
    mean[AT.lens] = lens.mean
    variance = np.diagonal(lens.covariance)
    is_known = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if len(is_known):
        precision = np.linalg.inv(lens.covariance[np.ix_(is_known, is_known)])
        rows = list(np.linalg.cholesky(precision).T @ np.eye(COUNT)[AT.lens[is_known]])
    scale = Setup.of(np.zeros(COUNT))._replace(
        rotation=np.full(3, 0.02),
        translation=np.full(3, 0.02),
        fov=1.0 * (variance[0] > 0),
        distortion=0.02 * (variance[1:3] > 0),
        principal_offset=0.01 * (variance[3:] > 0),
        ior=0.05 * bool({"radius", "thickness"} & measured.keys()),
        center=np.full(3, 0.1 * measured.get("radius", (0.0, 0.0))[0]),
        tilt=np.full(2, 0.02 * ("thickness" in measured)),
    )
    for name, (value, error) in measured.items():
        at = getattr(AT, name)
        mean[at], scale = value, scale._replace(**{name: np.full(np.shape(at), error)})
        if error > 0:
            rows += list(np.eye(COUNT)[np.atleast_1d(at)] / error)
    if measured.get("wedge", (0.0, 0.0))[1] > 0:
        # Behind a wedge it matters where the tank stands: about as far before the board as it is thick, or at it.
        height, about = AT.center[2], measured["thickness"][0]
        mean[height], scale.center[2] = about, about
        rows.append(np.eye(COUNT)[height] / about)
    return Known(mean, np.reshape(rows, (-1, COUNT)), scale.vector)


@dataclass(frozen=True)
class AdjustedView:
    """What least squares found of one view.

    Args:
        setup: camera and ball.
        covariance: of their numbers, raveled, from all corners' scatter and what was known.
        sigma: standard deviations of corners that are seen directly, and through the glass, in pixels.
        direct, through: the corners that count.
        shared: by how much more than by their scatter corners err together, directly and through the tank.
    """

    setup: Setup
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    direct: Corners
    through: Corners
    shared: tuple[float, float] = field(default=(1.0, 1.0), kw_only=True)

    @property
    def errors(self) -> Setup:
        """The standard deviation of each number."""
        return Setup.of(np.sqrt(np.diagonal(self.covariance)))

    @property
    def lens(self) -> LensPrior:
        return LensPrior(self.setup.lens, self.covariance[np.ix_(AT.lens, AT.lens)])

    @property
    def ior(self) -> tuple[float, float]:
        """The index of ball or liquid over the air's, and its standard deviation."""
        return float(self.setup.ior), float(self.errors.ior)


class Adjusted(NamedTuple):
    """What least squares found.

    Args:
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


def adjust(views: Sequence[PhotoView], known: Known) -> Adjusted:
    """Find the numbers at which corners miss least.

    Lens, index and radius are common to all views. In each what is seen directly and what through the glass has its own
    scatter, told from the median of its misses. Corners beyond 2.5 times that count as in Huber's loss (1964), in the
    last round those beyond 5 times that not at all.

    Args:
        views: photographs with one camera of one ball; the first begins with what is common. One without corners
            through the glass needs no numbers of a ball or a tank.
        known: what is known before.
    """
    system = _System(views, known)
    believed = [np.hypot(group.spread, CORNER_FLOOR) for group in system.groups]
    x = np.zeros(len(system.free))
    used, factors = [np.ones(len(sigma), bool) for sigma in believed], []
    shared: list[tuple[float, float]] = []

    # Scatter and weights follow from the misses at the present numbers, the numbers from these, and so on.
    for rounds_left in reversed(range(6)):
        misses = zip(system.misses(x), believed, strict=True)
        lengths = [np.linalg.norm(value, axis=-1) / sigma for (value, _), sigma in misses]
        # The median length of two normal coordinates of standard deviation 1 is sqrt(2 ln 2).
        counting = [n[u] for n, u in zip(lengths, used, strict=True)]
        factors = [max(float(np.median(n)) / 1.1774, 1.0) if len(n) else 1.0 for n in counting]
        off = [n / factor for n, factor in zip(lengths, factors, strict=True)]
        used = [one < 5.0 for one in off]
        weights = [u.astype(float) for u in used]
        if rounds_left:
            weights = [np.minimum(1, 2.5 / np.maximum(one, TINY)) for one in off]
        shared = [
            _shared(factors[2 * k : 2 * k + 2], counting[2 * k : 2 * k + 2]) if view.setup.thickness > 0 else (1.0, 1.0)
            for k, view in enumerate(views)
        ]
        wider = np.multiply(factors, np.ravel(shared))
        rows = zip(weights, wider, believed, strict=True)
        system.factors = [np.sqrt(weight) / (factor * sigma) for weight, factor, sigma in rows]
        x = least_squares(system.residual, x, jac=system.jacobian, max_nfev=60).x  # pyright: ignore[reportArgumentType]

    # The last round's rows tell how sure the numbers are; the covariance of those that are held is 0.
    joint, jacobian = system.joint(x), system.jacobian(x)
    covariance = np.zeros((len(joint), len(joint)))
    # A product with itself has no variance below 0, however badly determined the numbers are.
    root = np.linalg.pinv(jacobian) * system.scale[:, None]
    covariance[np.ix_(system.free, system.free)] = root @ root.T
    sigma = [float(f * np.median(s)) if len(s) else 0.0 for f, s in zip(factors, believed, strict=True)]
    corners, found = [group.where(u) for group, u in zip(system.groups, used, strict=True)], []
    for k in range(len(views)):
        (numbers, chain), own = system.view(joint, k), slice(2 * k, 2 * k + 2)
        scatter = (sigma[2 * k], sigma[2 * k + 1])
        spread = chain @ covariance @ chain.T
        found.append(AdjustedView(Setup.of(numbers), spread, scatter, *corners[own], shared=shared[k]))
    return Adjusted(tuple(found), joint, covariance, system.known, float(np.sum(system.residual(x) ** 2)) / 2)


def _shared(factors: Sequence[float], groups: Sequence[np.ndarray]) -> tuple[float, float]:
    """By how much more than by their scatter the corners of two groups err together.

    Where one scatters more than the other by far and not by chance, the excess of its variance is that of something
    that shifts neighbours alike, which does not average out among them: a wall that is not flat, a liquid that is
    not mixed. It counts for as many times as there are neighbours.
    """
    least, counts = min(factors), [len(group) for group in groups]
    if min(counts) == 0:
        return 1.0, 1.0
    # A scatter that is told from the median of n lengths errs by 0.72 / sqrt(n) of itself.
    chance = 3 * 0.72 * np.sqrt(sum(1 / n for n in counts))
    first, second = (
        float(np.sqrt((least / one) ** 2 + NEIGHBOURS * (1 - (least / one) ** 2)))
        if one / least > max(SCATTERS_MORE, np.exp(chance))
        else 1.0
        for one in factors
    )
    return first, second


class _System:
    """The linearized misses of all corners by the free numbers of all views, each in its own scale."""

    def __init__(self, views: Sequence[PhotoView], known: Known):
        first, others = views[0], views[1:]
        self.views, self.groups = views, [group for view in views for group in (view.direct, view.through)]
        self.start = np.concatenate([first.setup.vector, *(view.setup.own for view in others)])
        scales = [_scale_of(view, known) for view in views]
        scale = np.concatenate([scales[0].vector, *(one.own for one in scales[1:])])
        self.free = np.flatnonzero(scale > 0)
        self.scale = scale[self.free]
        # What is known of a view's own numbers is known of those of each.
        more, alike = (0, len(self.start) - COUNT), known.root[:, AT.own]
        mean, root = np.pad(known.mean, more), [np.pad(known.root, ((0, 0), more))]
        for k in range(len(others)):
            places = COUNT + k * len(AT.own) + np.arange(len(AT.own))
            mean[places] = known.mean[AT.own]
            root.append(alike[alike[:, scale[places] > 0].any(axis=1)] @ np.eye(len(self.start))[places])
        self.known = Known(mean, np.concatenate(root), scale)
        self._padded = [(padded(view.direct), padded(view.through)) for view in views]
        self.factors: list[np.ndarray] = []  # Of each corner's misses in the residual.
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
        places = np.array(AT.vector)
        if k:
            places[AT.own] = COUNT + (k - 1) * len(AT.own) + np.arange(len(AT.own))
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
                    n = len(group.pixels)
                    found.append((np.asarray(value)[:n], np.asarray(slope)[:n] @ chain[:, self.free] * self.scale))
            self._kept = key, found
        return self._kept[1]

    def residual(self, x: Float[np.ndarray, " free"]) -> Float[np.ndarray, " rows"]:
        """The scaled misses of all corners, then those of what was known."""
        rows = [(value * by[:, None]).reshape(-1) for (value, _), by in zip(self.misses(x), self.factors, strict=True)]
        return np.concatenate([*rows, self.known.root @ (self.joint(x) - self.known.mean)])

    def jacobian(self, x: Float[np.ndarray, " free"]) -> Float[np.ndarray, "rows free"]:
        slopes = zip(self.misses(x), self.factors, strict=True)
        rows = [(slope * by[:, None, None]).reshape(-1, len(x)) for (_, slope), by in slopes]
        return np.concatenate([*rows, self.known.root[:, self.free] * self.scale])


def _scale_of(view: PhotoView, known: Known) -> Setup:
    """About how far each number of a view may move; a ball or a tank through which nothing is seen is held."""
    scale, distance = Setup.of(known.scale), np.linalg.norm(view.setup.translation)
    center, tilt = (one * (len(view.through.pixels) > 0) for one in (scale.center, scale.tilt))
    return scale._replace(translation=distance * scale.translation, center=center, tilt=tilt)


@jit
def linearized(numbers: Numbers, size: Float[Array, "2"], direct, through):
    """The misses of both groups of corners in pixels, as `misses`, and their derivatives by the numbers of a set-up.

    In air places that are seen directly are projected to pixels instead.
    """
    (pixels, places), count = (jnp.concatenate(both) for both in zip(direct, through, strict=True)), len(direct[0])
    flat = jnp.concatenate([direct[1], jnp.zeros_like(direct[1][:, :1])], axis=1)

    def look(numbers, step):
        setup = Setup.of(numbers)
        o, d = pixel_rays(setup, size, pixels + step)
        beside = jax.lax.cond(
            setup.depth > 0,
            lambda: follow_directly(setup, o[:, :count], d[:, :count]),
            lambda: Seen(project(setup, size, flat), jnp.zeros(count, o.dtype), jnp.ones(count, bool)),
        )
        behind = follow_through(setup, o[:, count:], d[:, count:])
        found = jax.tree.map(lambda *parts: jnp.concatenate(parts), beside, behind)
        return found.place, found

    # The step is of all pixels: its derivative is the local map. Several traces would take as much longer to compile.
    (slope, local_map), found = jax.jacfwd(look, (0, 1), has_aux=True)(numbers, jnp.zeros(2, pixels.dtype))
    is_projected = (Setup.of(numbers).depth <= 0) & (jnp.arange(len(pixels)) < count)
    inverse = jnp.where(is_projected[:, None, None], jnp.eye(2, dtype=pixels.dtype), inverse_of(local_map))
    off = found.place - jnp.where(is_projected[:, None], pixels, places)
    miss = jnp.where(found.valid[:, None], jnp.einsum("nij,nj->ni", inverse, off), LOST)
    slope = jnp.where(found.valid[:, None, None], jnp.einsum("nij,njk->nik", inverse, slope), 0.0)
    return (miss[:count], miss[count:]), (slope[:count], slope[count:])


def padded(corners: Corners) -> tuple[Float[np.ndarray, "padded 2"], Float[np.ndarray, "padded 2"]]:
    """Pixels and places, with zeros up to a multiple of 256, so that photographs share programs."""
    more = -len(corners.pixels) % 256 if len(corners.pixels) else 256
    wider = ((0, more), (0, 0))
    return np.pad(corners.pixels, wider), np.pad(corners.places, wider)
