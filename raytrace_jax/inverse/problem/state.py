"""Where a fit stands: unknowns, the problem linearised there, and what that tells of the target."""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.inverse.problem.comparison import Comparison, evaluate
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization


@dataclasses.dataclass(frozen=True)
class FitState:
    """The state of a fit: a point, the problem there, and whether a solver came to rest.

    Args:
        problem: what is solved: the problem given, with the bias that the edge-aware picture was found to have.
        y: the unknowns.
        comparison: how picture and target are compared.
        linearization: the problem there.
        settled: whether the solver came to rest.
        next_move: how long the step after the last would be in standard errors, where steps ended on their own.
        target_samples: samples a pixel and side of the regular grid whose means a box-filtered target's pixels are;
            None where none is known.
        resolution: how far apart unknowns may be that the picture of such samples, or of what was stored, does not
            tell apart, as a covariance of the unknowns; None where none is known.
    """

    problem: Problem
    y: Float[Array, " parameters"]
    comparison: Comparison
    linearization: Linearization
    settled: bool = False
    next_move: float = 0.0
    target_samples: int | None = None
    resolution: Float[np.ndarray, "parameters parameters"] | None = None

    @classmethod
    def at(cls, problem: Problem, y: Float[Array, " parameters"], comparison: Comparison) -> "FitState":
        """The state at unknowns to which no solver has come yet."""
        return cls(problem, y, comparison, problem.linearize(y, comparison))

    @property
    def residual(self) -> Float[np.ndarray, "3 height width"]:
        """The unblurred, weighted residual."""
        return self.problem.residual(np.asarray(self.linearization.image), self.comparison.binning)

    @property
    def rms_residual(self) -> float:
        """Root mean square of the unblurred, weighted residual over the numbers that count."""
        count = max(self.problem.binned(self.comparison.binning).count, 1)
        return float(np.linalg.norm(self.residual) / np.sqrt(count))

    @property
    def counts(self) -> Bool[np.ndarray, "height width"]:
        """Which pixels count."""
        return np.asarray(self.problem.binned(self.comparison.binning).root_weight) > 0

    def under_loss(
        self, what: Literal["residual", "weight", "score"], scale: float | None = None
    ) -> Float[np.ndarray, "3 height width"]:
        """What the loss makes of each residual, at its own scale or at another one; see `Loss`."""
        scale = self.comparison.loss_scale if scale is None else scale
        return evaluate(self.comparison.loss, what, self.residual, scale)
