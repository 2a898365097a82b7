"""A place that a solve led to."""

import dataclasses

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.vuong import vuong_evidence
from raytrace_jax.inverse.result import Minimum


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
        """The same, with the evidence that a better residual is better."""
        summary = dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual))
        return dataclasses.replace(self, summary=summary)
