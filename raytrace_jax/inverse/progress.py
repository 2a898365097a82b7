"""What a fit has found so far, and who is told of it."""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

from ..util.background import Clock
from .judge.model_check import ModelCheck
from .judge.structure import explains, vuong_evidence
from .judge.uncertainty import Uncertainty
from .judge.views import ViewAlone
from .problem.problem import FitState, Problem
from .problem.unknowns import Images, Vector
from .result import FitStep, Minimum, Profile

Record = Callable[[float, bool, Vector], None]
"""A function that is called with (cost, accepted, unknowns) after each step."""


class LocalMinimum(NamedTuple):
    """A minimum with all that is known of it."""

    summary: Minimum
    y: Vector
    residual: Images

    @classmethod
    def of(cls, state: FitState, candidate: int, level: int) -> "LocalMinimum":
        """The minimum that a solve from a candidate came to on a level, yet without evidence against it."""
        value, rms = state.problem.values(state.y), state.rms_residual * state.problem.unit
        return cls(Minimum(candidate, value, rms, level, explains(state), 0.0), state.y, state.residuals)

    def judged_against(self, best: Images) -> "LocalMinimum":
        """A copy with the evidence that a better residual is better."""
        return self._replace(summary=dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual)))


@dataclasses.dataclass
class Findings:
    """What a fit has found; each phase adds to it, and an interrupt takes nothing away.

    Args:
        answer: the best unknowns so far, None before the first step.
        unseen: balls that the target does not show, with their free index and positions.
        check: whether the model is right, if that was looked at.
        alone: what each of several views tells.
        start_images: the picture of each view at the start, compared as the solution's is.
    """

    steps: tuple[FitStep, ...] = ()
    answer: Vector | None = None
    minima: tuple[LocalMinimum, ...] = ()
    solution: FitState | None = None
    uncertainty: Uncertainty | None = None
    unseen: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    profiles: tuple[Profile, ...] = ()
    check: ModelCheck | None = None
    start_images: Images = ()
    alone: tuple[ViewAlone, ...] = ()


@dataclasses.dataclass
class Progress:
    """The findings of a fit, and what tells its caller of them: of each step, and in words of each phase."""

    problem: Problem
    on_step: Callable[[FitStep], None] | None = None
    on_phase: Callable[[str], None] | None = None
    clock: Clock = dataclasses.field(default_factory=Clock)
    findings: Findings = dataclasses.field(default_factory=Findings)

    def phase(self, words: str) -> None:
        """Tell what the fit does next. Raises TimeoutError when the time is up."""
        if self.on_phase is not None and not self.clock.is_stopped:
            self.on_phase(words)
        self.clock.check()

    def of_level(self, candidate: int, level: int, blur: float = 0.0, leads: bool = True) -> Record:
        """What adds steps to the history, of one level of a candidate; `leads`: they are the best answer so far."""
        findings = self.findings

        def record(cost: float, accepted: bool, y: Vector) -> None:
            if leads:
                findings.answer = y
            number = sum((step.candidate, step.level) == (candidate, level) for step in findings.steps)
            cost, values = cost * self.problem.unit**2, self.problem.values(y)
            step = FitStep(candidate, level, blur, number, cost, accepted, values, self.clock.seconds)
            findings.steps += (step,)
            if self.on_step is not None and not self.clock.is_stopped:
                self.on_step(step)
            self.clock.check()

        return record
