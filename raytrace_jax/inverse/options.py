"""What a fit can be told, in words; free of JAX, for the command line."""

from typing import Literal

LossName = Literal["l2", "huber", "cauchy"]
"""The losses of `inverse.problem.losses`."""

LossChoice = Literal["auto", LossName]
"""`auto`: the loss that suits how the target was sampled."""

TargetSampling = Literal["auto", "box", "point"]
"""How a target's pixels were made: the mean over each, one ray, or whichever is nearer to it."""
