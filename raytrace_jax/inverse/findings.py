"""What a fit has found so far: minima, the solution, how sure it is."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.assumptions import ModelCheck
from raytrace_jax.inverse.problem.state import FitState
from raytrace_jax.inverse.result import Minimum, Profile
from raytrace_jax.inverse.statistics.goodness_of_fit import explains, vuong_evidence
from raytrace_jax.inverse.statistics.uncertainty import Uncertainty


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

    @classmethod
    def of(cls, state: FitState, candidate: int, level: int) -> "LocalMinimum":
        """The minimum that a solve from a candidate came to on a level, yet without evidence against it."""
        value, explained = state.problem.values(state.y), explains(state)
        return cls(Minimum(candidate, value, state.rms_residual, level, explained, 0.0), state.y, state.residual)

    def judged_against(self, best: Float[np.ndarray, "3 height width"]) -> "LocalMinimum":
        """A copy with the evidence that a better residual is better."""
        summary = dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual))
        return dataclasses.replace(self, summary=summary)


@dataclasses.dataclass(frozen=True)
class Findings:
    """What a fit has found so far; each stage adds to it, and an interrupt takes nothing away.

    Args:
        answer: the best unknowns so far, None before the first step.
        minima: all of them, best first.
        solution: where the whole picture was solved to.
        uncertainty: how sure that solution is.
        unseen: balls that the target does not show, with their free index and positions.
        profiles: the profiles that are done.
        check: whether the model is right, if that was looked at.
        start_image: the picture at the start, compared as the solution's is.
    """

    answer: Float[Array, " parameters"] | None = None
    minima: tuple[LocalMinimum, ...] = ()
    solution: FitState | None = None
    uncertainty: Uncertainty | None = None
    unseen: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    profiles: tuple[Profile, ...] = ()
    check: ModelCheck | None = None
    start_image: Float[np.ndarray, "3 height width"] | None = None
