"""How a picture and the target are compared."""

import dataclasses

import numpy as np

from raytrace_jax.inverse.options import LossName
from raytrace_jax.scene.setting_words import EdgeMode


@dataclasses.dataclass(frozen=True)
class Comparison:
    """How picture and target are compared.

    Args:
        edges: how the picture is sampled.
        blur: standard deviation of the Gaussian blur of their difference, in pixels of the target.
        binning: how many pixels are averaged to one in each direction, in picture and target.
        loss: name of the loss.
        loss_scale: its scale; infinity with `l2`.
        noise: standard deviation of the residuals beside which priors count.
    """

    edges: EdgeMode
    blur: float = 0.0
    binning: int = 1
    loss: LossName = "l2"
    loss_scale: float = np.inf
    noise: float = 0.0
