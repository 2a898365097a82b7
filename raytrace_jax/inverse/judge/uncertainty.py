"""The uncertainty of an estimate: covariance, the bound that no estimate beats, and undetermined parameters."""

import contextlib
import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from ...util.numerics import MAD_TO_SIGMA, TINY
from ..problem.problem import FitState
from ..problem.stages import Scores
from ..problem.unknowns import Covariance, Values

RANK_TOLERANCE = 1e-9
"""A direction along which the picture changes this much less than along the strongest one is not determined."""

NULL_COMPONENT = 1e-3
"""A parameter whose component along a null direction exceeds this is reported as undetermined."""

LEAST_CURVATURE = 0.05
"""The loss must curve up by this fraction of least squares' curvature in every direction: a Cauchy loss of Gaussian
noise has 0.7, and what is near 0 or below sees outliers only. 0.2 and 0.5 make error bars a seventh to three quarters
as large where two fifths are outliers or the model is wrong (experiments/tuning)."""

LARGEST_ERROR = 0.5
"""An error beyond this fraction of a parameter's natural scale leaves it undetermined. With 1 a ball of a
five-hundredth of transparency passes for determined (experiments/tuning)."""


@dataclasses.dataclass(frozen=True)
class Uncertainty:
    """The uncertainty of an estimate if noise is the only source of error.

    Args:
        standard_error: one standard deviation of each estimate that noise makes; infinity where the picture does not
            determine it, NaN where the fit was stopped before, or sums of squares are beyond the dtype.
        cramer_rao: the least standard deviation that any unbiased estimate can have, for Gaussian noise of `sigma`.
        sigma: standard deviation of the target's noise in one channel of a pixel of weight 1.
        resolution: the part of `standard_error` that is the step which the solver did not take, and by which places lie
            apart whose pictures of the target's samples are the same; 0 where nothing is known of it.
        sigma_given: whether `sigma` was given, or estimated from the residual where the picture depends on a parameter.
        reduced_chi_square: sum of squared residuals over sigma squared and the degrees of freedom; 1 is right, NaN
            where `sigma` was not given.
        condition_number: that of the Jacobian with columns scaled to length one; infinity if it is singular.
        weakest: the combination of parameters that the picture determines least, in words.
        undetermined: the parameters that the picture does not determine.
    """

    standard_error: Values
    covariance: Covariance
    cramer_rao: Values
    sigma: float
    resolution: Values
    sigma_given: bool
    reduced_chi_square: float
    condition_number: float
    weakest: str
    undetermined: tuple[str, ...]

    @property
    def correlation(self) -> Covariance:
        return correlation_of(self.covariance)

    @classmethod
    def unknown(cls, count: int, sigma: float | None) -> "Uncertainty":
        """The uncertainty of so many parameters of which nothing is known."""
        nan, used = np.full((count, count), np.nan), np.nan if sigma is None else sigma
        return cls(nan[0], nan, nan[0], used, np.zeros(count), sigma is not None, np.nan, np.nan, "", ())


def noise_level(state: FitState) -> float:
    """Standard deviation of the noise, from residuals where the picture depends on a free parameter.

    Elsewhere a backdrop may fit exactly. A robust loss takes it from the median, least squares from the mean square.
    """
    linearization = state.linearization
    if state.stage.loss != "l2":
        return MAD_TO_SIGMA * float(linearization.typical)
    freedom = int(np.sum(linearization.matters)) - len(state.problem.unknowns.names)
    return float(np.sqrt(float(linearization.squares) / max(freedom, 1)))


def quantify_uncertainty(state: FitState, sigma: float | None, *others: FitState) -> Uncertainty:
    """Covariance, bounds and degeneracies at an unblurred optimum.

    At the optimum the scores add up to 0, `g = sum J^T rho'(r) = 0`. Noise moves them by a dg of covariance M, and the
    estimate follows by `-H^-1 dg`, H being the loss's second derivative without that of the picture. So the covariance
    is the sandwich `H^-1 M H^-1` (Huber 1967; White 1980), which holds whatever the noise's distribution. M is the sum
    of what the stages of the observation add to it. If sigma is larger than the noise that the residuals show, the
    missing noise is added: no error is below the bound. H and M are taken in the directions in which the Jacobian's
    triangle R is the identity, since an inverse of `J^T J` would square the condition number.

    Several pictures that share the unknowns have noise of their own: their H and M add up, and R is that of all rows.

    The covariance of unknowns that a stage or the solver does not tell apart although the derivative does is added.
    Where sums of squares are beyond the dtype nothing is known, and the errors are NaN.

    Args:
        others: other pictures at the same unknowns, whose residuals have the same unit; `next_step` is that of `state`.
    """
    states, sums = (state, *others), ("jacobian", "residual", "squares", "information", "curvature", "pixel_scatter")
    if all(np.isfinite(np.asarray(getattr(one.linearization, name))).all() for one in states for name in sums):
        with contextlib.suppress(np.linalg.LinAlgError), np.errstate(over="ignore", invalid="ignore"):
            found = _quantify(states, sigma)
            if not np.isnan(found.covariance).any():
                return found
    return Uncertainty.unknown(len(state.problem.unknowns.names), sigma)


class Share(NamedTuple):
    """What one picture adds to an estimate, by values in natural scales.

    Args:
        unit: from unknowns to values in natural scales.
        triangle: that of the Jacobian, with the priors' rows.
        curvature: `J^T C J` with the priors'.
        prior: the priors' `1 / deviation`.
        seen, used: the noise that the residuals show, and the one that counts.
    """

    state: FitState
    unit: Values
    triangle: Float[np.ndarray, "rows parameters"]
    curvature: Covariance
    prior: Values
    seen: float
    used: float

    @classmethod
    def of(cls, state: FitState, unit: Values, scale: Values, sigma: float | None) -> "Share":
        """The share of a picture whose noise is sigma, or as its residuals show it."""
        seen, linearization = noise_level(state), state.linearization
        triangle = np.asarray(linearization.jacobian, np.float64) * unit
        prior = np.asarray(state.problem.prior.precision, np.float64) * scale
        curvature = by_value(linearization.curvature, unit)
        return cls(state, unit, triangle, curvature, prior, seen, seen if sigma is None else sigma)

    def meat(self, whiten: Float[np.ndarray, "parameters directions"]) -> Float[np.ndarray, "directions directions"]:
        """The covariance of its scores along directions: the noise of the priors, and what each stage adds."""
        problem, linearization = self.state.problem, self.state.linearization
        jacobian = np.asarray(linearization.pixel_jacobian, np.float64)
        scores = Scores(
            jacobian=np.tensordot((self.unit[:, None] * whiten).T, jacobian, 1),
            weight=self.state.under_loss("weight"),
            score=self.state.under_loss("score"),
            scatter=whiten.T @ by_value(linearization.pixel_scatter, self.unit) @ whiten,
            matters=np.asarray(linearization.matters),
            picture=np.asarray(linearization.image, np.float64) + np.asarray(problem.observation.bias, np.float64),
            observation=problem.observation,
            unseen=max(self.used**2 - self.seen**2, 0.0),
        )
        noise = self.state.stage.noise
        meat = whiten.T @ (np.diag((noise * self.prior) ** 2) * noise**2) @ whiten
        return meat + sum(one.score_covariance(scores) for one in problem.stages if len(meat))

    def confusion(self) -> Covariance:
        """That of the unknowns which its stages do not tell apart, although the derivative does."""
        count = len(self.unit)
        return sum((one.confusion(count) for one in self.state.problem.stages), np.zeros((count, count)))

    def information(self, sigma: float) -> Covariance:
        """Its information on the values, times the square of sigma."""
        found = by_value(self.state.linearization.information, self.unit)
        # A picture without noise counts a million times as much as one with noise, not infinitely.
        ratio = 1.0 if self.used == sigma else sigma / max(self.used, 1e-3 * sigma)
        return found * ratio**2 + np.diag((sigma * self.prior) ** 2)


def _quantify(states: Sequence[FitState], sigma: float | None) -> Uncertainty:
    """`quantify_uncertainty` of finite sums. Raises LinAlgError where LAPACK finds no eigenvalues."""
    first, problem = states[0], states[0].problem
    names, scale = problem.unknowns.names, problem.scale
    unit = scale / np.maximum(np.abs(problem.slopes(first.y)), TINY)
    shares = [Share.of(state, unit, scale, sigma) for state in states]
    used = shares[0].used if len(shares) == 1 else float(np.sqrt(np.mean([share.used**2 for share in shares])))
    triangle = np.concatenate([share.triangle for share in shares])

    # What is determined must not depend on units: columns of length one.
    lengths = np.linalg.norm(triangle, axis=0)
    length = np.where(lengths > 0, lengths, 1)
    _, strengths, directions = np.linalg.svd(triangle / length, full_matrices=False)
    rounding = float(np.finfo(problem.observation.target.dtype).eps)
    # At least a thousand roundings, the digits of sums over a hundred thousand pixels; they rule in float32.
    tolerance = max(RANK_TOLERANCE, 1e3 * rounding)
    strong = strengths > tolerance * max(strengths[0], TINY)
    undetermined = (lengths == 0) | np.any(np.abs(directions[~strong]) > NULL_COMPONENT, axis=0)
    whiten = (directions[strong] / strengths[strong, None]).T / length[:, None]

    # H, in the directions in which R is the identity. Where it curves down there are outliers only, and R's is taken.
    bread = whiten.T @ sum(share.curvature for share in shares) @ whiten
    if len(bread) and np.linalg.eigvalsh(bread)[0] < LEAST_CURVATURE:
        bread = np.eye(len(bread))

    # The sandwich. A fit without noise is off by a hundred roundings of a natural scale: no error is less.
    half = np.linalg.solve(bread, whiten.T).T
    meat = sum(share.meat(whiten) for share in shares)
    covariance = half @ meat @ half.T + (1e2 * rounding) ** 2 * np.eye(len(names))
    # What the solver and the stages do not tell apart. The estimate is the mean of those by each picture alone, which
    # count by their curvature: an error of one moves it by as much.
    left = np.zeros_like(covariance)
    for share in shares:
        follows = half @ whiten.T @ share.curvature if len(shares) > 1 else np.eye(len(names))
        follows = follows * unit[:, None] / unit  # By unknowns.
        left = left + follows @ share.confusion() @ follows.T
    if first.next_step is not None:
        left = left + np.outer(first.next_step, first.next_step)
    resolution = left / np.outer(unit, unit)
    covariance += resolution

    # What no estimate can beat, and how well the noise explains what is left.
    spread = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    least = inverse_root(np.sum([share.information(used) for share in shares], axis=0), tolerance**2)
    # A picture that fits exactly has no noise: infinity must not be multiplied by 0.
    bound = np.where(np.isfinite(least), used * np.where(np.isfinite(least), least, 0), np.inf)
    undetermined |= spread > LARGEST_ERROR
    freedom = sum(state.problem.observation.count for state in states) - len(names)
    chi_square = sum(float((state.residual**2).sum()) for state in states) / max(freedom, 1)
    return Uncertainty(
        standard_error=np.where(undetermined & (spread <= LARGEST_ERROR), np.inf, spread * scale),
        covariance=covariance * np.outer(scale, scale),
        cramer_rao=bound * scale,
        sigma=used,
        resolution=np.sqrt(np.maximum(np.diagonal(resolution), 0)) * scale,
        sigma_given=sigma is not None,
        reduced_chi_square=float("nan") if sigma is None else chi_square / sigma**2,
        condition_number=float(strengths[0] / strengths[-1]) if strengths[-1] > 0 else float("inf"),
        weakest=direction_in_words(triangle, scale, names),
        undetermined=tuple(names[k] for k in np.flatnonzero(undetermined)),
    )


def by_value(matrix: ArrayLike, unit: Values) -> Covariance:
    """A sum of products of derivatives by unknowns, by values in natural scales."""
    return np.asarray(matrix, np.float64) * np.outer(unit, unit)


def correlation_of(covariance: Float[np.ndarray, "numbers numbers"]) -> Float[np.ndarray, "numbers numbers"]:
    """The correlation matrix of a covariance; a number without a spread correlates with no other."""
    spread = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    length = np.where(spread == 0, 1, spread)
    correlation = covariance / np.outer(length, length)
    known = np.isfinite(spread)
    correlation[known, known] = 1.0
    return correlation


def inverse_root(information: np.ndarray, tolerance: float) -> np.ndarray:
    """Square roots of the diagonal of a symmetric matrix's inverse; infinity where it has none, as in `_quantify`."""
    lengths = np.sqrt(np.maximum(np.diagonal(information), 0))
    length = np.where(lengths > 0, lengths, 1)
    strengths, directions = np.linalg.eigh(information / np.outer(length, length))
    strong = strengths > max(tolerance, 1e-15) * max(strengths[-1], TINY)  # A few roundings of float64.
    roots = np.sqrt(np.sum(directions[:, strong] ** 2 / strengths[strong], axis=1)) / length
    return np.where((lengths == 0) | np.any(np.abs(directions[:, ~strong]) > NULL_COMPONENT, axis=1), np.inf, roots)


def direction_in_words(triangle: np.ndarray, scale: np.ndarray, names: tuple[str, ...]) -> str:
    """The joint change of parameters that changes the picture least: `ball.radius +1, ball.center.z -2.1`.

    The first parameter is the one that changes most in natural scales, by 1. The others are in proportion, in their own
    units.
    """
    weakest = np.linalg.svd(triangle)[2][-1]
    # What has less than a twentieth changes the combination's length by a thousandth, and is not named.
    order = [k for k in np.argsort(-np.abs(weakest)) if abs(weakest[k]) > 0.05 * np.max(np.abs(weakest))]
    change = weakest * scale
    change = change / change[order[0]]
    return ", ".join(f"{names[k]} {change[k]:+.3g}" for k in order)
