"""The uncertainty of an estimate: covariance, the bound that no estimate beats, and undetermined parameters."""

import contextlib
import dataclasses

import numpy as np
from jaxtyping import Float

from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.problem.stages import Scores
from raytrace_jax.inverse.problem.unknowns import Covariance, Values
from raytrace_jax.util.numerics import MAD_TO_SIGMA, TINY

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


def quantify_uncertainty(state: FitState, sigma: float | None) -> Uncertainty:
    """Covariance, bounds and degeneracies at an unblurred optimum.

    At the optimum the scores add up to 0, `g = sum J^T rho'(r) = 0`. Noise moves them by a dg of covariance M, and the
    estimate follows by `-H^-1 dg`, H being the loss's second derivative without that of the picture. So the covariance
    is the sandwich `H^-1 M H^-1` (Huber 1967; White 1980), which holds whatever the noise's distribution. M is the sum
    of what the stages of the observation add to it. If sigma is larger than the noise that the residuals show, the
    missing noise is added: no error is below the bound. H and M are taken in the directions in which the Jacobian's
    triangle R is the identity, since an inverse of `J^T J` would square the condition number.

    The covariance of unknowns that a stage or the solver does not tell apart although the derivative does is added.
    Where sums of squares are beyond the dtype nothing is known, and the errors are NaN.
    """
    sums = ("jacobian", "residual", "squares", "information", "curvature", "pixel_scatter")
    if all(np.isfinite(np.asarray(getattr(state.linearization, name))).all() for name in sums):
        with contextlib.suppress(np.linalg.LinAlgError), np.errstate(over="ignore", invalid="ignore"):
            found = _quantify(state, sigma)
            if not np.isnan(found.covariance).any():
                return found
    return Uncertainty.unknown(len(state.problem.unknowns.names), sigma)


def _quantify(state: FitState, sigma: float | None) -> Uncertainty:
    """`quantify_uncertainty` of finite sums. Raises LinAlgError where LAPACK finds no eigenvalues."""
    problem, linearization, stage = state.problem, state.linearization, state.stage
    names = problem.unknowns.names
    slope, scale = problem.slopes(state.y), problem.scale
    unit = scale / np.maximum(np.abs(slope), TINY)  # From unknowns to values in natural scales.

    def by_value(matrix) -> np.ndarray:
        return np.asarray(matrix, np.float64) * np.outer(unit, unit)

    # The noise, and the problem's triangle R by values in natural scales.
    seen = noise_level(state)
    used = seen if sigma is None else sigma
    prior_row = np.asarray(problem.prior.precision, np.float64) * scale
    triangle = np.asarray(linearization.jacobian, np.float64) * unit

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
    fixed = np.diag((stage.noise * prior_row) ** 2)
    bread = whiten.T @ by_value(linearization.curvature) @ whiten
    if len(bread) and np.linalg.eigvalsh(bread)[0] < LEAST_CURVATURE:
        bread = np.eye(len(bread))

    # M, in the same directions: the noise of the priors, and what each stage of the observation adds.
    scores = Scores(
        jacobian=np.tensordot((unit[:, None] * whiten).T, np.asarray(linearization.pixel_jacobian, np.float64), 1),
        weight=state.under_loss("weight"),
        score=state.under_loss("score"),
        scatter=whiten.T @ by_value(linearization.pixel_scatter) @ whiten,
        matters=np.asarray(linearization.matters),
        picture=np.asarray(linearization.image, np.float64) + np.asarray(problem.observation.bias, np.float64),
        observation=problem.observation,
        unseen=max(used**2 - seen**2, 0.0),
    )
    meat = whiten.T @ (fixed * stage.noise**2) @ whiten
    meat += sum(one.score_covariance(scores) for one in problem.stages if len(meat))

    # The sandwich. A fit without noise is off by a hundred roundings of a natural scale: no error is less.
    half = np.linalg.solve(bread, whiten.T).T
    covariance = half @ meat @ half.T + (1e2 * rounding) ** 2 * np.eye(len(names))
    # What the solver and the stages do not tell apart, although the derivative does.
    left = sum((one.confusion(len(names)) for one in problem.stages), np.zeros_like(covariance))
    if state.next_step is not None:
        left = left + np.outer(state.next_step, state.next_step)
    resolution = left / np.outer(unit, unit)
    covariance += resolution

    # What no estimate can beat, and how well the noise explains what is left.
    spread = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    least = inverse_root(by_value(linearization.information) + np.diag((used * prior_row) ** 2), tolerance**2)
    # A picture that fits exactly has no noise: infinity must not be multiplied by 0.
    bound = np.where(np.isfinite(least), used * np.where(np.isfinite(least), least, 0), np.inf)
    undetermined |= spread > LARGEST_ERROR
    freedom = problem.observation.count - len(names)
    chi_square = float((state.residual**2).sum()) / max(freedom, 1)
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
