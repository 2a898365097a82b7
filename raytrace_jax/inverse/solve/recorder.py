"""What a fit tells on its way and keeps for an interrupt: steps, phases, the clock, and what it found."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any

from jaxtyping import Array, Float

from raytrace_jax.inverse.findings import Findings
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.result import FitStep
from raytrace_jax.inverse.solve.iterate import Record


class Recorder:
    """Keeps history and findings, tells the caller of each step, and watches the clock.

    Args:
        problem: what is fitted.
        on_step: called after each step of the solver.
        on_phase: called with a few words on what happens now.
        max_seconds: time after which to raise `TimeoutError`.
    """

    def __init__(
        self,
        problem: Problem,
        on_step: Callable[[FitStep], None] | None,
        on_phase: Callable[[str], None] | None,
        max_seconds: float | None,
    ):
        self.problem, self.max_seconds = problem, max_seconds
        self.on_step, self.on_phase = on_step, on_phase
        self.started = time.monotonic()
        self.is_stopped = False
        self.history: list[FitStep] = []
        self.findings = Findings()

    @property
    def seconds(self) -> float:
        """Time since the fit began."""
        return time.monotonic() - self.started

    def phase(self, words: str) -> None:
        """Say what happens now."""
        if self.on_phase is not None and not self.is_stopped:
            self.on_phase(words)
        self.check_clock()

    def check_clock(self) -> None:
        """Raise TimeoutError when the time is up, or the work was asked to stop."""
        is_over = self.max_seconds is not None and self.seconds > self.max_seconds
        if is_over or self.is_stopped:
            raise TimeoutError

    def stop(self) -> None:
        """Have the work end where it asks for the time next; nothing is told of it any more."""
        if self.on_phase is not None:
            self.on_phase("stopping ...")
        self.is_stopped = True

    def found(self, **what: Any) -> None:
        """Add fields of the `Findings`, which outlive an interrupt."""
        self.findings = dataclasses.replace(self.findings, **what)

    def level(self, candidate: int, level: int, blur: float = 0.0, leads: bool = True) -> Record:
        """The callback for one level of one candidate, whose steps go on after those that the history has of it.

        `leads` says that its steps are the best answer so far.
        """
        first = sum(step.candidate == candidate and step.level == level for step in self.history)

        def record(step: int, cost: float, accepted: bool, y: Float[Array, " parameters"]) -> None:
            values = self.problem.values(y)
            if leads:
                self.found(answer=y)
            self.history.append(FitStep(candidate, level, blur, first + step, cost, accepted, values, self.seconds))
            if self.on_step is not None and not self.is_stopped:
                self.on_step(self.history[-1])
            self.check_clock()

        return record
