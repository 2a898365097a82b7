"""How the whole picture is to be solved, as far as a user has said it and the target has told."""

import dataclasses

from raytrace_jax.inverse.options import FitOptions, LossName, TargetSampling
from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.scene.setting_words import EdgeMode


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
        is_own: whether the target is an edge-aware picture of this program, which lacks nothing of its kind.
    """

    edges: EdgeMode
    loss: LossName
    sigma: float | None
    max_steps: int
    level: int
    candidate: int
    target_samples: int | None = None
    is_own: bool = False

    @classmethod
    def of(cls, options: FitOptions, sampling: TargetSampling, level: int = 0, candidate: int = 0) -> "RefineOptions":
        """What a user's options come to for a target that was sampled in a known way."""
        suited: LossName = "cauchy" if sampling == "point" else "l2"
        return cls(
            edges="point" if sampling == "point" else options.edges,
            loss=suited if options.loss == "auto" else options.loss,
            sigma=options.sigma,
            max_steps=options.max_steps,
            level=level,
            candidate=candidate,
            target_samples=options.target_samples,
            is_own=sampling == "aware",
        )

    @property
    def first_comparison(self) -> Comparison:
        """How picture and target are compared at first: the few point samples that an edge has passed are outliers."""
        is_robust = self.edges == "point" and self.loss == "l2"
        return Comparison(self.edges, loss="cauchy" if is_robust else self.loss)
