"""What a fit returns."""

import dataclasses
from typing import Literal

import numpy as np
from jaxtyping import Float

from ..scene import Scene
from ..settings import RenderSettings

Status = Literal["converged", "not_converged", "interrupted"]


@dataclasses.dataclass(frozen=True)
class FitStep:
    """One step of the solver.

    Args:
        level: number of the pyramid level, from 0, the coarsest.
        blur: standard deviation of that level's Gaussian blur, in pixels; 0 on the last.
        step: number of the step within the level, from 0, the start.
        cost: half the sum of squared residuals on that level, after the step.
        accepted: whether the step was taken.
        value: the free parameters after the step, in the order of `FitResult.names`.
        seconds: time since the fit began.
    """

    level: int
    blur: float
    step: int
    cost: float
    accepted: bool
    value: Float[np.ndarray, " parameters"]
    seconds: float


@dataclasses.dataclass(frozen=True)
class FitResult:
    """The estimate, how sure it is, and how it came about.

    Args:
        status: `converged`: the solver came to rest and the picture is explained; `not_converged`: anything else that
            ran to its end; `interrupted`: stopped by the user or a budget.
        message: one sentence on why, and on what to do.
        names: the free scalar parameters, as the user spelled them.
        value: their estimates.
        initial: where they started.
        standard_error: one standard deviation of each estimate; infinity where the picture does not determine it.
        correlation: correlation matrix of the estimates.
        rms_residual: root mean square of picture minus target over all pixels and channels, unblurred.
        scene: the scene at the estimate.
        settings: what was rendered.
        target, start_image, image: the target, the picture at the start and at the estimate.
        history: every step of the solver.
    """

    status: Status
    message: str
    names: tuple[str, ...]
    value: Float[np.ndarray, " parameters"]
    initial: Float[np.ndarray, " parameters"]
    standard_error: Float[np.ndarray, " parameters"]
    correlation: Float[np.ndarray, "parameters parameters"]
    rms_residual: float
    scene: Scene
    settings: RenderSettings
    target: Float[np.ndarray, "3 height width"]
    start_image: Float[np.ndarray, "3 height width"]
    image: Float[np.ndarray, "3 height width"]
    history: tuple[FitStep, ...]
