"""Nuisance parameters: the target is `exposure` times the scene's picture plus `offset`, the same for R, G and B."""

from typing import NamedTuple

from raytrace_jax.inverse.problem.transforms import Transform


class Nuisance(NamedTuple):
    """A parameter that no scene has: its start, its natural scale and its bounds."""

    start: float
    scale: float
    transform: Transform


EXPOSURE, OFFSET = "exposure", "offset"

NUISANCES = {
    EXPOSURE: Nuisance(start=1.0, scale=1.0, transform=Transform("above")),
    OFFSET: Nuisance(start=0.0, scale=0.1, transform=Transform()),
}
