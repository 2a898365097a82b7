"""How sure an estimate is: its covariance, the bound that no estimate beats, and what the picture leaves open."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.problem import Measure, Problem, weighted_residual
from raytrace_jax.inverse.problem.residual import Linearization

RANK_TOLERANCE = 1e-9
"""A direction along which the picture changes this much less than along the strongest one is not determined."""

LARGEST_ERROR = 0.5
"""An error beyond this share of a parameter's natural scale leaves it open."""

ERRORS_GO_TOGETHER = 2.0
"""From this ratio on of scatter by squares of pixels to scatter by pixels, neighbours err together."""

SHARE_WORTH_NAMING = 0.05
"""Parameters with less than this share of the weakest combination are not named in it."""

MAD_TO_SIGMA = 1.4826
"""Standard deviation of Gaussian noise over the median of its magnitude."""


@dataclasses.dataclass(frozen=True)
class Certainty:
    """What the last linearisation says of the estimate; the arguments are those of `FitResult` of the same name.

    Args:
        undetermined: the parameters that the picture leaves open.
    """

    standard_error: Float[np.ndarray, " parameters"]
    correlation: Float[np.ndarray, "parameters parameters"]
    cramer_rao: Float[np.ndarray, " parameters"]
    sigma: float
    reduced_chi_square: float
    condition_number: float
    weakest: str
    undetermined: tuple[str, ...]


def noise_level(problem: Problem, found: Linearization, measure: Measure) -> float:
    """Standard deviation of the noise, from the residuals where the picture depends on a free parameter.

    Elsewhere a backdrop may fit exactly and would make it too small. A robust loss takes the median, least squares
    the mean square.
    """
    if measure.loss != "l2":
        return MAD_TO_SIGMA * float(found.typical)
    freedom = 3 * int(np.sum(found.matters)) - len(problem.unknowns.names)
    return float(np.sqrt(float(found.squares) / max(freedom, 1)))


def certainty(
    problem: Problem, found: Linearization, y: Float[Array, " parameters"], measure: Measure, sigma: float | None
) -> Certainty:
    """Covariance, bounds and degeneracies at an unblurred optimum.

    The covariance is the sandwich `H^-1 M H^-1`: `H` the loss's second derivative without that of the picture, `M` the
    scatter of the residuals' pulls, pixel by pixel, or by squares of pixels where neighbours err together (Huber 1967;
    White 1980). It holds whatever the noise's distribution, and for a model that misses something. Both are taken in
    the directions in which the Jacobian's triangle R is the identity (never as the inverse of `J^T J`, which squares
    the condition number).

    Args:
        problem: what was fitted.
        found: the problem at the optimum.
        y: the unknowns there.
        measure: how picture and target were compared there.
        sigma: the noise's standard deviation, if it is known.
    """
    names = problem.unknowns.names
    slope, scale = problem.slopes(y), problem.scale()
    unit = scale / np.maximum(np.abs(slope), 1e-300)  # From unknowns to values in natural scales.

    def by_value(matrix) -> np.ndarray:
        return np.asarray(matrix, np.float64) * np.outer(unit, unit)

    used = noise_level(problem, found, measure) if sigma is None else sigma
    prior_row = np.asarray(problem.prior.precision, np.float64) * scale
    triangle = np.asarray(found.jacobian, np.float64) * unit

    # What is determined must not depend on units: columns of length one.
    lengths = np.linalg.norm(triangle, axis=0)
    length = np.where(lengths > 0, lengths, 1)
    _, strengths, directions = np.linalg.svd(triangle / length, full_matrices=False)
    tolerance = max(RANK_TOLERANCE, 1e3 * float(np.finfo(problem.observation.target.dtype).eps))
    strong = strengths > tolerance * max(strengths[0], 1e-300)
    open_ = (lengths == 0) | np.any(np.abs(directions[~strong]) > 1e-3, axis=0)
    whiten = (directions[strong] / strengths[strong, None]).T / length[:, None]

    # The sandwich, in the directions in which R is the identity.
    fixed = np.diag((measure.noise * prior_row) ** 2)
    bread = whiten.T @ (by_value(found.curvature) + fixed) @ whiten
    if len(bread) and np.linalg.eigvalsh(bread)[0] < 0.05:  # Outliers only: the loss curves down.
        bread = np.eye(len(bread))
    pixels, blocks = (whiten.T @ by_value(m) @ whiten for m in (found.pixel_scatter, found.block_scatter))
    together = np.trace(blocks) > ERRORS_GO_TOGETHER * np.trace(pixels)
    scatter = (blocks if together else pixels) + whiten.T @ (fixed * measure.noise**2) @ whiten
    half = np.linalg.solve(bread, whiten.T).T
    covariance = half @ scatter @ half.T

    spread = np.sqrt(np.maximum(np.diagonal(covariance), 0))
    correlation = covariance / np.outer(np.where(spread > 0, spread, 1), np.where(spread > 0, spread, 1))
    np.fill_diagonal(correlation, 1.0)
    least = inverse_root(by_value(found.information) + np.diag((used * prior_row) ** 2), tolerance**2)
    # Not infinity times the zero noise of a picture that fits exactly.
    bound = np.where(np.isfinite(least), used * np.where(np.isfinite(least), least, 0), np.inf)
    open_ |= spread > LARGEST_ERROR
    freedom = problem.observation.count - len(names)
    chi_square = float((weighted_residual(problem, found) ** 2).sum()) / max(freedom, 1)
    return Certainty(
        standard_error=np.where(open_ & (spread <= LARGEST_ERROR), np.inf, spread * scale),
        correlation=correlation,
        cramer_rao=bound * scale,
        sigma=used,
        reduced_chi_square=float("nan") if sigma is None else chi_square / sigma**2,
        condition_number=float(strengths[0] / strengths[-1]) if strengths[-1] > 0 else float("inf"),
        weakest=in_words(triangle, scale, names),
        undetermined=tuple(name for name, is_open in zip(names, open_, strict=True) if is_open),
    )


def inverse_root(information: np.ndarray, tolerance: float) -> np.ndarray:
    """Square roots of the diagonal of a symmetric matrix's inverse; infinity where it has none."""
    lengths = np.sqrt(np.maximum(np.diagonal(information), 0))
    length = np.where(lengths > 0, lengths, 1)
    strengths, directions = np.linalg.eigh(information / np.outer(length, length))
    strong = strengths > max(tolerance, 1e-15) * max(strengths[-1], 1e-300)
    found = np.sqrt(np.sum(directions[:, strong] ** 2 / strengths[strong], axis=1)) / length
    return np.where((lengths == 0) | np.any(np.abs(directions[:, ~strong]) > 1e-3, axis=1), np.inf, found)


def in_words(triangle: np.ndarray, scale: np.ndarray, names: tuple[str, ...]) -> str:
    """The changes that, made together, change the picture least: `ball.radius +1, ball.center.z -2.1`.

    The first is the largest in natural scales; the others are in proportion to it, in their own units.
    """
    weakest = np.linalg.svd(triangle)[2][-1]
    order = [k for k in np.argsort(-np.abs(weakest)) if abs(weakest[k]) > SHARE_WORTH_NAMING * np.max(np.abs(weakest))]
    change = weakest * scale
    change = change / change[order[0]]
    return ", ".join(f"{names[k]} {change[k]:+.3g}" for k in order)
