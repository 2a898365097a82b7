"""The one loop of all solvers: look where the method proposes, and let it say what is best and where to look next."""

import dataclasses
from collections.abc import Callable
from typing import Generic, TypeVar

from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.state import FitState

Memory = TypeVar("Memory")

Record = Callable[[int, float, bool, Float[Array, " parameters"]], None]
"""What is called with (number, cost, accepted, unknowns) after each step."""


@dataclasses.dataclass(frozen=True)
class Step(Generic[Memory]):
    """Where a method stands, and where it wants to go.

    Args:
        best: where the solve ends if it ends now, and whether it is at rest there.
        accepted: whether the place that was seen last is the best.
        to: the unknowns where to look next; None ends the solve.
        memory: what the method wants to know at the next place.
    """

    best: FitState
    accepted: bool
    to: Float[Array, " parameters"] | None
    memory: Memory


def iterate(
    step: Step[Memory],
    look: Callable[[Step[Memory], Float[Array, " parameters"]], FitState],
    propose: Callable[[Step[Memory], FitState], Step[Memory]],
    most: int,
    record: Record,
) -> FitState:
    """Step until the method proposes no further place, or `most` places were seen.

    Args:
        step: where the method begins, and looks first.
        look: what is seen at given unknowns, after a step.
        propose: the method: the next step, from the last one and what was seen after it.
        most: places to look at.
        record: is told of the best after each step.

    Returns:
        The best of the last step.
    """
    for number in range(most):
        if step.to is None:
            break
        step = propose(step, look(step, step.to))
        record(number, step.best.linearization.cost, step.accepted, step.best.y)
    return step.best
