"""How a target's pixels were made."""

from typing import Literal

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.solve.pixel_samples import supersampled
from raytrace_jax.scene.setting_words import MAX_SAMPLES


def likelier_sampling(problem: Problem, y: Float[Array, " parameters"]) -> Literal["box", "point"]:
    """How a target was sampled, judged near the answer: as the kind of picture that is nearer to it on average.

    The two kinds differ in the pixels that an edge cuts: one ray sees one side, four rays begin to see the mean. The
    mean magnitude of the residual counts these pixels, and is not ruled by a few that are off for other reasons.
    """
    samples = problem.base.samples

    def distance(samples: int) -> float:
        return float(np.mean(np.abs(problem.residual(supersampled(problem, y, samples)))))

    return "box" if distance(min(2 * samples, MAX_SAMPLES)) < distance(samples) else "point"
