"""Least squares of a board's corners in photographs: cameras, ball or tank and index together, and how sure all are."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float
from scipy.optimize import least_squares

from ..util.compilation import jit
from ..util.digits import Measurement
from ..util.numerics import TINY, root_diagonal
from .geometry import LENS, LOST, Ball, Camera, Liquid, Numbers, Seen, Setup, Tank, inverse_of
from .lens import LensPrior, PictureSize, Turn
from .photograph import Corners

Free = Float[np.ndarray, " free"]
"""The free numbers of an adjustment, each in its own scale."""

Joint = Float[np.ndarray, " joint"]
"""All numbers of an adjustment, as `Adjusted` has them."""

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
    size: PictureSize
    direct: Corners
    through: Corners
    turn: Turn = Turn()


class Prior(NamedTuple):
    """What is known of the numbers before: a Gaussian.

    Args:
        mean: of each number of the first view; of what is not known it means nothing.
        root: a square root of the precision matrix; no rows know nothing.
        scale: about how far each number may move, the translation in distances of the board; 0 holds it.
    """

    mean: Numbers
    root: Float[np.ndarray, "rows numbers"]
    scale: Numbers


Measured = Mapping[str, Measurement]
"""What was measured of a ball (`radius`, `liquid`, `depth`) or of a tank (`thickness`, `wall`, `wall_index`, and for
both numbers of its `wedge` one), with standard deviations."""


def known_before(lens: LensPrior, measured: Measured = MappingProxyType({})) -> Prior:
    """What is known before: the lens, and what was measured of ball or tank, if there is one.

    What has no error is held.
    """
    glass = Ball() if "radius" in measured else Tank() if "thickness" in measured else None
    form = Setup(Camera(), glass, Liquid() if "liquid" in measured else None)
    mean, rows, unit = form.vector, [], np.eye(len(form.numbers))
    mean[LENS] = lens.mean
    variance = np.diagonal(lens.covariance)
    is_known = np.flatnonzero(np.isfinite(variance) & (variance > 0))
    if len(is_known):
        precision = np.linalg.inv(lens.covariance[np.ix_(is_known, is_known)])
        rows = list(np.linalg.cholesky(precision).T @ unit[LENS][is_known])
    scale = np.array([one.scale for one in form.numbers])
    scale[LENS] *= variance > 0
    scale[form.places("center")] *= measured.get("radius", (0.0, 0.0))[0]
    for name, (value, error) in measured.items():
        at = form.places(name)
        mean[at], scale[at] = value, error
        if error > 0:
            rows += list(unit[at] / error)
    if measured.get("wedge", (0.0, 0.0))[1] > 0:
        # Behind a wedge it matters where the tank stands: about as far before the board as it is thick, or at it.
        height, about = form.places("center.z"), measured["thickness"][0]
        mean[height] = scale[height] = about
        rows += list(unit[height] / about)
    return Prior(mean, np.reshape(rows, (-1, len(mean))), scale)


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
        return self.setup.at(root_diagonal(self.covariance))

    @property
    def lens(self) -> LensPrior:
        return LensPrior(self.setup.vector[LENS], self.covariance[np.ix_(LENS, LENS)])

    @property
    def ior(self) -> Measurement:
        """The index of ball or liquid over the air's, and its standard deviation."""
        return float(self.setup.glass.ior), float(self.errors.glass.ior)


class Adjusted(NamedTuple):
    """What least squares found.

    Args:
        joint: all numbers: those of the first view, then of each other one what is its own (`Number.is_own`).
        covariance: of all these.
        known: what was known of all these before.
        cost: half the sum of the squares, in standard deviations.
        chains: the derivative of each view's numbers by all.
    """

    views: tuple[AdjustedView, ...]
    joint: Joint
    covariance: Float[np.ndarray, "joint joint"]
    known: Prior
    cost: float
    chains: tuple[Float[np.ndarray, "numbers joint"], ...]


def adjust(views: Sequence[PhotoView], known: Prior) -> Adjusted:
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
            _shared(factors[2 * k :][:2], counting[2 * k :][:2]) if isinstance(view.setup.glass, Tank) else (1.0, 1.0)
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
    of_views = [system.view(joint, k) for k in range(len(views))]
    for k, (numbers, chain) in enumerate(of_views):
        own = slice(2 * k, 2 * k + 2)
        spread, (beside, behind) = chain @ covariance @ chain.T, sigma[own]
        setup = views[k].setup.at(numbers)
        found.append(AdjustedView(setup, spread, (beside, behind), *corners[own], shared=shared[k]))
    cost, chains = float(np.sum(system.residual(x) ** 2)) / 2, tuple(chain for _, chain in of_views)
    return Adjusted(tuple(found), joint, covariance, system.known, cost, chains)


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

    def __init__(self, views: Sequence[PhotoView], known: Prior):
        self.views, self.groups = views, [group for view in views for group in (view.direct, view.through)]
        # A number that all have in common is the first view's.
        index: dict[tuple[int, str], int] = {}
        self.places = [
            [index.setdefault((k * one.is_own, one.name), len(index)) for one in view.setup.numbers]
            for k, view in enumerate(views)
        ]
        (self.start, scale, mean), root, unit = np.zeros((3, len(index))), [], np.eye(len(index))
        for k, view in enumerate(views):
            mine = [(j, one.name) for j, one in enumerate(view.setup.numbers) if one.is_own or k == 0]
            places, in_first = (np.array([index[group, name] for _, name in mine]) for group in (k, 0))
            # A ball or a tank through which nothing is seen is held.
            factors = {"shift": np.linalg.norm(view.setup.camera.translation)}
            factors |= {} if len(view.through.pixels) else {"center": 0.0, "tilt": 0.0}
            self.start[places] = view.setup.vector[[j for j, _ in mine]]
            scale[places] = known.scale[in_first] * [factors.get(name.partition(".")[0], 1.0) for _, name in mine]
            # What is known of a view's own numbers is known of those of each.
            mean[places], rows = known.mean[in_first], known.root[:, in_first]
            root.append(rows[rows[:, scale[places] > 0].any(axis=1)] @ unit[places])
        self.free = np.flatnonzero(scale > 0)
        self.scale = scale[self.free]
        self.known = Prior(mean, np.concatenate(root), scale)
        self._padded = [(padded(view.direct), padded(view.through)) for view in views]
        self.factors: list[np.ndarray] = []  # Of each corner's misses in the residual.
        self._kept: tuple[bytes | None, list] = (None, [])

    def joint(self, x: Free) -> Joint:
        """All numbers, in their units."""
        joint = np.array(self.start)
        joint[self.free] += x * self.scale
        return joint

    def view(self, joint: Joint, k: int) -> tuple[Numbers, Float[np.ndarray, "numbers joint"]]:
        """A view's numbers, and their derivative by all."""
        numbers, slope = joint[self.places[k]], np.eye(len(joint))[self.places[k]]
        numbers[LENS], places, factors = self.views[k].turn(numbers[LENS])
        slope[LENS] = factors[:, None] * slope[LENS][places]
        return numbers, slope

    def misses(self, x: Free) -> list[tuple[np.ndarray, np.ndarray]]:
        """Each group's misses in pixels, and their derivatives by `x`.

        SciPy asks for values and slopes one after the other at the same place: one program gives both, once.
        """
        if self._kept[0] != (key := x.tobytes()):
            joint, found = self.joint(x), []
            for k, view in enumerate(self.views):
                numbers, chain = self.view(joint, k)
                both = linearized(view.setup.at(numbers), np.asarray(view.size, float), *self._padded[k])
                for value, slope, group in zip(*both, (view.direct, view.through), strict=True):
                    n = len(group.pixels)
                    found.append((np.asarray(value)[:n], np.asarray(slope)[:n] @ chain[:, self.free] * self.scale))
            self._kept = key, found
        return self._kept[1]

    def residual(self, x: Free) -> Float[np.ndarray, " rows"]:
        """The scaled misses of all corners, then those of what was known."""
        rows = [(value * by[:, None]).reshape(-1) for (value, _), by in zip(self.misses(x), self.factors, strict=True)]
        return np.concatenate([*rows, self.known.root @ (self.joint(x) - self.known.mean)])

    def jacobian(self, x: Free) -> Float[np.ndarray, "rows free"]:
        slopes = zip(self.misses(x), self.factors, strict=True)
        rows = [(slope * by[:, None, None]).reshape(-1, len(x)) for (_, slope), by in slopes]
        return np.concatenate([*rows, self.known.root[:, self.free] * self.scale])


@jit
def linearized(setup: Setup, size: Float[Array, "2"], direct, through):
    """How far both groups of corners are from where their places are seen, in pixels; the derivatives by all numbers.

    That is the error on the board, carried back by the local map, which counts as constant; in air places that are seen
    directly are projected to pixels instead. A pixel whose ray does not come through errs by `LOST`, so that no
    adjustment gains by losing corners.
    """
    (pixels, places), count = (jnp.concatenate(both) for both in zip(direct, through, strict=True)), len(direct[0])
    flat = jnp.concatenate([direct[1], jnp.zeros_like(direct[1][:, :1])], axis=1)
    numbers, setup_of = ravel_pytree(setup)

    def look(numbers, step):
        setup = setup_of(numbers)
        o, d = setup.camera.rays(size, pixels + step)
        if setup.liquid is None:
            beside = Seen(setup.camera.project(size, flat), jnp.zeros(count, o.dtype), jnp.ones(count, bool))
        else:
            beside = setup.beside.follow(o[:, :count], d[:, :count])
        seen = jax.tree.map(lambda *parts: jnp.concatenate(parts), beside, setup.follow(o[:, count:], d[:, count:]))
        return seen.place, seen

    # The step is of all pixels: its derivative is the local map. Several traces would take as much longer to compile.
    (slope, local_map), seen = jax.jacfwd(look, (0, 1), has_aux=True)(numbers, jnp.zeros(2, pixels.dtype))
    is_projected = (setup.liquid is None) & (jnp.arange(len(pixels)) < count)
    inverse = jnp.where(is_projected[:, None, None], jnp.eye(2, dtype=pixels.dtype), inverse_of(local_map))
    off = seen.place - jnp.where(is_projected[:, None], pixels, places)
    error = jnp.where(seen.valid[:, None], jnp.einsum("nij,nj->ni", inverse, off), LOST)
    slope = jnp.where(seen.valid[:, None, None], jnp.einsum("nij,njk->nik", inverse, slope), 0.0)
    return (error[:count], error[count:]), (slope[:count], slope[count:])


def padded(corners: Corners) -> tuple[Float[np.ndarray, "padded 2"], Float[np.ndarray, "padded 2"]]:
    """Pixels and places, with zeros up to a multiple of 256, so that photographs share programs."""
    more = -len(corners.pixels) % 256 if len(corners.pixels) else 256
    wider = ((0, more), (0, 0))
    return np.pad(corners.pixels, wider), np.pad(corners.places, wider)
