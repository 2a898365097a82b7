"""The contract of the observation: what each stage between a scene's radiance and a target's numbers owes to a fit."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from .observation import Observation
from .unknowns import Covariance, Image

Matters = Bool[np.ndarray, "3 height width"]


class Scores(NamedTuple):
    """The residuals of an optimum and their pull on the estimate, along directions in which `J^T W J` is the identity.

    Args:
        jacobian: derivative of each weighted residual along each direction.
        weight, score: `rho' / r` and `rho'` of the loss at each residual `r`.
        scatter: sum over pixels of the outer product of their scores, `sum_p (J_p^T rho'_p)(J_p^T rho'_p)^T`.
        matters: the numbers that count, of the pixels that depend on a free parameter.
        picture: what is compared with the target, with its bias.
        unseen: variance of the noise that was stated and that the residuals do not show.
    """

    jacobian: Float[np.ndarray, "directions 3 height width"]
    weight: Image
    score: Image
    scatter: Float[np.ndarray, "directions directions"]
    matters: Matters
    picture: Image
    observation: Observation
    unseen: float


class ObservationStage:
    """A stage of the observation `t = Q(C(D(S(L)))) + e`; one that does not err inherits all of this.

    A pixel samples the radiance L (S), the camera responds (D), a file is compressed (C) and has steps (Q), and there
    is noise (e). Solver, error bars, check of the model and last word ask each stage of a problem, and know none by
    name.
    """

    @property
    def extent(self) -> int:
        """Side in pixels of the squares over which its errors go together."""
        return 1

    @property
    def advice(self) -> str:
        """What a user can say of the stage that was not known to a fit which came to no rest; empty if nothing."""
        return ""

    def apply(self, observation: Observation, image: Image) -> Image:
        """What the stage makes of a picture that the camera has developed, on average over its chance."""
        return image

    def score_covariance(self, scores: Scores) -> Covariance:
        """The covariance that the stage adds to the sum of the scores, `sum J^T rho'`."""
        count = len(scores.jacobian)
        return np.zeros((count, count))

    def confusion(self, count: int) -> Covariance:
        """Covariance of unknowns, of which there are so many, whose pictures are the same after the stage."""
        return np.zeros((count, count))

    def bound(self, observation: Observation) -> Float[np.ndarray, "*shape"]:
        """The largest residual, in the target's unit, that the stage makes anywhere by itself."""
        return np.zeros(())

    def obscures(self, sigma: float) -> Bool[np.ndarray, "*shape"]:
        """The numbers in which the stage makes an unknown part of noise with this standard deviation."""
        return np.zeros((), bool)

    def jump(self, observation: Observation) -> float:
        """The largest residual, in the target's unit, that the stage makes at edges of a right picture."""
        return 0.0
