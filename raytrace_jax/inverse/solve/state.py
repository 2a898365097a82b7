"""Points where a solve begins and ends, on small pictures and on the whole one."""

import dataclasses

import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.residual import Linearization
from raytrace_jax.inverse.result import Minimum
from raytrace_jax.inverse.statistics.goodness_of_fit import vuong_evidence
from raytrace_jax.scene.setting_words import EdgeMode


@dataclasses.dataclass(frozen=True)
class LocalMinimum:
    """A minimum with all that is known of it.

    Args:
        summary: for the report.
        y: its unknowns.
        residual: its weighted residual.
    """

    summary: Minimum
    y: Float[Array, " parameters"]
    residual: Float[np.ndarray, "3 height width"]

    def judged_against(self, best: Float[np.ndarray, "3 height width"]) -> "LocalMinimum":
        """A copy with the evidence that a better residual is better."""
        summary = dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual))
        return dataclasses.replace(self, summary=summary)


@dataclasses.dataclass(frozen=True)
class FitState:
    """The state of a fit: a point, the problem there, and whether a solver came to rest.

    Args:
        problem: what was solved: the problem given, with the bias that the edge-aware picture was found to have.
        y: the unknowns.
        comparison: how picture and target were compared.
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
    settled: bool
    next_move: float = 0.0
    target_samples: int | None = None
    resolution: Float[np.ndarray, "parameters parameters"] | None = None

    @property
    def residual(self) -> Float[np.ndarray, "3 height width"]:
        """The weighted residual."""
        return self.problem.residual_of(self.linearization)

    @property
    def counts(self) -> Bool[np.ndarray, "height width"]:
        """Which pixels count."""
        return np.asarray(self.problem.observation.root_weight) > 0


@dataclasses.dataclass(frozen=True)
class RefineOptions:
    """How the whole picture is to be solved.

    Args:
        edges: how the picture is sampled.
        loss: name of the loss.
        sigma: standard deviation of the noise, if it is known.
        max_steps: steps of each solve at most.
        level: its number in the history.
        candidate: number of the start, in the history.
        target_samples: samples a pixel and side of a box-filtered target's regular grid, if it is known.
        attempt: number of the place from which it is solved again; 0 is the start.
        is_own: whether the target is an edge-aware picture of this program, which lacks nothing of its kind.
    """

    edges: EdgeMode
    loss: LossName
    sigma: float | None
    max_steps: int
    level: int
    candidate: int
    target_samples: int | None = None
    attempt: int = 0
    is_own: bool = False

    @property
    def name(self) -> str:
        """The name of this solve's stages in the journal."""
        again = f", attempt {self.attempt}" if self.attempt else ""
        return f"last level of candidate {self.candidate}, {self.loss}{again}"
