"""The uncertainty of an estimate: covariance, the bound that no estimate beats, and undetermined parameters."""

import contextlib
import dataclasses
from collections.abc import Sequence

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Float

from ...util.numerics import MAD_TO_SIGMA, TINY, on_host, root_diagonal
from ..problem.linearize import RANK_TOLERANCE, outer
from ..problem.noise import rounding_scatter, score_covariance
from ..problem.problem import FitState
from ..problem.unknowns import Covariance, Values

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
            determine it, NaN where the fit was stopped before, the picture is far from explained, or sums of squares
            are beyond the dtype.
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

    @property
    def is_known(self) -> bool:
        """Whether any error is known."""
        return not np.all(np.isnan(self.standard_error))

    @classmethod
    def unknown(cls, count: int, sigma: float | None) -> "Uncertainty":
        """The uncertainty of `count` parameters of which nothing is known."""
        nan, used = np.full((count, count), np.nan), np.nan if sigma is None else sigma
        return cls(nan[0], nan, nan[0], used, np.zeros(count), sigma is not None, np.nan, np.nan, "", ())

    def withheld(self) -> "Uncertainty":
        """A copy whose errors are unknown: those of a place that is not the answer say nothing about the answer."""
        nothing = vars(Uncertainty.unknown(len(self.standard_error), None))
        errors = ("standard_error", "covariance", "cramer_rao", "resolution")
        return dataclasses.replace(self, **{name: nothing[name] for name in errors})

    def opened(self, names: Sequence[str], opened: Sequence[str]) -> "Uncertainty":
        """A copy in which some of the parameters are open: their errors are infinite, and they are undetermined."""
        error = np.where(np.isin(names, opened), np.inf, self.standard_error)
        undetermined = tuple(name for name in names if name in opened or name in self.undetermined)
        return dataclasses.replace(self, standard_error=error, undetermined=undetermined)


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
    is the sandwich `H^-1 M H^-1` (Huber 1967; White 1980), which holds whatever the noise's distribution. M is that of
    the noise and of the rounding of the target. If sigma is larger than the noise that the residuals show, the missing
    noise is added: no error is below the bound. H and M are taken in the directions in which the Jacobian's triangle R
    is the identity, since an inverse of `J^T J` would square the condition number.

    Several views have noise of their own: their H and M add up, and R is that of all rows.

    The covariance of displacements is added that the target's samples, or the solver, do not resolve although the
    derivative does. Where sums of squares are beyond the dtype nothing is known, and the errors are NaN.
    """
    states, sums = state.views, ("jacobian", "residual", "squares", "information", "curvature", "pixel_scatter")
    if all(np.isfinite(np.asarray(getattr(each.linearization, name))).all() for each in states for name in sums):
        with contextlib.suppress(np.linalg.LinAlgError), np.errstate(over="ignore", invalid="ignore"):
            uncertainty = _quantify(states, sigma)
            if not np.isnan(uncertainty.covariance).any():
                return uncertainty
    return Uncertainty.unknown(len(state.problem.unknowns.names), sigma)


def _quantify(states: Sequence[FitState], sigma: float | None) -> Uncertainty:
    """`quantify_uncertainty` of finite sums. Raises LinAlgError where LAPACK finds no eigenvalues."""
    first, problem = states[0], states[0].problem
    names, scale = problem.unknowns.names, problem.scale
    # From unknowns to values in natural scales.
    unit = scale / np.maximum(np.abs(problem.slopes(first.y)), TINY)
    noises = [noise_level(state) if sigma is None else sigma for state in states]
    noise = noises[0] if len(states) == 1 else float(np.sqrt(np.mean(np.square(noises))))
    triangle = np.concatenate([on_host(state.linearization.jacobian) * unit for state in states])

    # What is determined must not depend on units: columns of length one.
    lengths = np.linalg.norm(triangle, axis=0)
    length = np.where(lengths > 0, lengths, 1)
    _, strengths, directions = np.linalg.svd(triangle / length, full_matrices=False)
    rounding = float(np.finfo(problem.dtype).eps)
    # At least a thousand roundings, the digits of sums over a hundred thousand pixels; they rule in float32.
    tolerance = max(RANK_TOLERANCE, 1e3 * rounding)
    strong = strengths > tolerance * max(strengths[0], TINY)
    undetermined = (lengths == 0) | np.any(np.abs(directions[~strong]) > NULL_COMPONENT, axis=0)
    whiten = (directions[strong] / strengths[strong, None]).T / length[:, None]

    # H, in the directions in which R is the identity. Where it curves down there are outliers only, and R's is taken.
    curvatures = [by_value(state.linearization.curvature, unit) for state in states]
    bread = whiten.T @ sum(curvatures) @ whiten
    if len(bread) and np.linalg.eigvalsh(bread)[0] < LEAST_CURVATURE:
        bread = np.eye(len(bread))

    # The sandwich. A fit without noise is off by a hundred roundings of a natural scale: no error is less.
    half = np.linalg.solve(bread, whiten.T).T
    meat = sum(scores(state, unit, whiten, used) for state, used in zip(states, noises, strict=True))
    covariance = half @ meat @ half.T + (1e2 * rounding) ** 2 * np.eye(len(names))
    resolution = unresolved(states, unit, [half @ whiten.T @ curvature for curvature in curvatures])
    covariance += resolution

    # What no estimate can beat, and how well the noise explains what is left.
    information = np.sum([information_of(*each, unit, noise) for each in zip(states, noises, strict=True)], axis=0)
    spread = root_diagonal(covariance)
    least = inverse_root(information, tolerance**2)
    # A picture that fits exactly has no noise: infinity must not be multiplied by 0.
    bound = np.where(np.isfinite(least), noise * np.where(np.isfinite(least), least, 0), np.inf)
    undetermined |= spread > LARGEST_ERROR
    freedom = sum(state.problem.observation.count for state in states) - len(names)
    chi_square = sum(float((state.residual**2).sum()) for state in states) / max(freedom, 1)
    return Uncertainty(
        standard_error=np.where(undetermined & (spread <= LARGEST_ERROR), np.inf, spread * scale),
        covariance=covariance * np.outer(scale, scale),
        cramer_rao=bound * scale,
        sigma=noise,
        resolution=root_diagonal(resolution) * scale,
        sigma_given=sigma is not None,
        reduced_chi_square=float("nan") if sigma is None else chi_square / sigma**2,
        condition_number=float(strengths[0] / strengths[-1]) if strengths[-1] > 0 else float("inf"),
        weakest=direction_in_words(triangle, scale, names),
        undetermined=tuple(names[k] for k in np.flatnonzero(undetermined)),
    )


def scores(
    state: FitState, unit: Values, whiten: Float[np.ndarray, "parameters directions"], noise: float
) -> Float[np.ndarray, "directions directions"]:
    """The covariance of a picture's scores along directions: of its priors, its noise, and the rounding of its target.

    Args:
        unit: from unknowns to values in natural scales.
        whiten: the directions in such values, in which the Jacobian of all pictures is the identity.
        noise: that which counts: what is missing in the residuals is added.
    """
    problem, linearization, count = state.problem, state.linearization, whiten.shape[1]
    prior = (state.stage.noise**2 * on_host(problem.prior.precision) * problem.scale) ** 2
    covariance = whiten.T @ np.diag(prior) @ whiten
    if not count:
        return covariance
    jacobian = np.tensordot((unit[:, None] * whiten).T, on_host(linearization.pixel_jacobian), 1)
    weight, score = state.under_loss("weight"), state.under_loss("score")
    scatter = whiten.T @ by_value(linearization.pixel_scatter, unit) @ whiten
    covariance += score_covariance(jacobian, weight, score, np.asarray(linearization.matters), scatter)
    covariance += max(noise**2 - noise_level(state) ** 2, 0.0) * outer((jacobian * weight).reshape(count, -1))
    # Equal colours are rounded alike.
    observation = problem.observation
    picture, bias, root = map(on_host, (linearization.image, observation.bias, observation.root_weight))
    target = on_host(observation.target)
    return covariance + rounding_scatter(jacobian, weight * root, picture + bias, target)


def unresolved(states: Sequence[FitState], unit: Values, follows: Sequence[Covariance]) -> Covariance:
    """Covariance of values in natural scales that the target's samples and the solver do not resolve.

    Args:
        follows: how far the estimate follows that of each picture alone, which counts by its curvature.
    """
    covariance = np.zeros_like(follows[0])
    for state, share in zip(states, follows, strict=True):
        if state.confusion is not None:
            share = share if len(states) > 1 else np.eye(len(unit))
            covariance += share @ (state.confusion / np.outer(unit, unit)) @ share.T
    step = states[0].next_step
    return covariance if step is None else covariance + np.outer(step / unit, step / unit)


def information_of(state: FitState, used: float, unit: Values, noise: float) -> Covariance:
    """A picture's information on values in natural scales, times the square of the noise.

    Args:
        used, noise: standard deviation of the picture's own noise, and of that of all pictures.
    """
    # A picture without noise counts a million times as much as one with noise, not infinitely.
    ratio = 1.0 if used == noise else noise / max(used, 1e-3 * noise)
    prior = noise * on_host(state.problem.prior.precision) * state.problem.scale
    return by_value(state.linearization.information, unit) * ratio**2 + np.diag(prior**2)


def by_value(matrix: ArrayLike, unit: Values) -> Covariance:
    """A sum of products of derivatives by unknowns, by values in natural scales."""
    return on_host(matrix) * np.outer(unit, unit)


def correlation_of(covariance: Float[np.ndarray, "numbers numbers"]) -> Float[np.ndarray, "numbers numbers"]:
    """The correlation matrix of a covariance; a number without a spread correlates with no other."""
    spread = root_diagonal(covariance)
    length = np.where(spread == 0, 1, spread)
    correlation = covariance / np.outer(length, length)
    known = np.isfinite(spread)
    correlation[known, known] = 1.0
    return correlation


def inverse_root(information: np.ndarray, tolerance: float) -> np.ndarray:
    """Square roots of the diagonal of a symmetric matrix's inverse; infinity where it has none, as in `_quantify`."""
    lengths = root_diagonal(information)
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
