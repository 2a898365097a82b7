"""The views of a fit beside each other: what each one tells alone, and whether one contradicts the others."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np

from ...util.digits import with_error
from ...util.numerics import TINY, on_host
from ..problem.linearize import gauss_newton_step
from ..problem.problem import FitState
from ..problem.unknowns import Covariance, Values
from .model_check import short_count
from .uncertainty import quantify_uncertainty


class ViewAlone(NamedTuple):
    """What one view tells of the free numbers, by the linear model at the estimate of all views.

    Args:
        standard_error: of noise alone; infinity where the view does not determine a number.
    """

    camera: str
    value: Values
    standard_error: Values


def each_alone(state: FitState, sigma: float | None) -> tuple[ViewAlone, ...]:
    """What each of several views tells alone: the step from the estimate to the minimum of its own sum of squares."""
    found = []
    for view in state.views:
        sure = quantify_uncertainty(dataclasses.replace(view, next_step=None), sigma)
        y = on_host(view.y) + gauss_newton_step(view.linearization)
        value = view.problem.values(view.problem.array(np.clip(y, *view.problem.unknowns.reach)))
        error = np.where(np.isnan(sure.standard_error), np.inf, sure.standard_error)
        found.append(ViewAlone(view.problem.scene.camera.name, value, error))
    return tuple(found)


def contradicting_view(
    alone: tuple[ViewAlone, ...],
    names: tuple[str, ...],
    value: Values,
    noise: Covariance,
    model: Covariance,
) -> str:
    """The view that contradicts the others most, in words; empty where none is 3 standard deviations off.

    The estimate of all views is as good as any, so that one of a part of them differs from it by the difference of
    their variances (Hausman 1978).

    Args:
        value, noise: the estimate of all views, and its covariance of noise.
        model: covariance of errors of the model, which move each view otherwise.
    """
    worst, words = 3.0, ""
    for view in alone:
        for k, name in enumerate(names):
            own, of_all = float(view.standard_error[k]), float(noise[k, k])
            if not math.isfinite(own):
                continue
            # A view that tells next to all of the estimate is no other one.
            variance = max(own**2 - of_all, max(own**2, of_all) / 9) + float(model[k, k])
            deviations = abs(float(view.value[k] - value[k])) / max(math.sqrt(variance), TINY)
            if deviations > worst:
                by_it, by_all = with_error(float(view.value[k]), own), with_error(float(value[k]), math.sqrt(of_all))
                worst = deviations
                words = (
                    f"the view {view.camera} contradicts the others: {name} is {by_it} by it alone, and {by_all} by "
                    f"all ({short_count(deviations)} times as far as by chance)"
                )
    return words
