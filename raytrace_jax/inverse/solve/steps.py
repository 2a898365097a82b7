"""A solver's steps within bounds, and the record of what a fit has found so far."""

import dataclasses
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ...scene.scene import Scene
from ...util.numerics import on_device
from ..judge.assumptions import ModelCheck
from ..judge.structure import explains, vuong_evidence
from ..judge.uncertainty import Uncertainty
from ..problem.linearize import Linearization
from ..problem.problem import FitState, Problem
from ..problem.unknowns import Image, Unknowns, Vector
from ..result import FitStep, Minimum, Profile

Record = Callable[[float, bool, Vector], None]
"""A function that is called with (cost, accepted, unknowns) after each step."""


def shorten_step(problem: Problem, origin: Vector, tried) -> Vector:
    """The end of a step, moved into the reach of the unknowns and halved until no ball has swallowed the camera."""
    place, start = np.clip(np.asarray(tried), *problem.unknowns.reach), np.asarray(origin)
    # A step that leads into the impossible is given up after ten halvings: a thousandth of it is none.
    for _ in range(10):
        if is_possible(problem, problem.array(place)):
            return problem.array(place)
        place = (place + start) / 2
    return problem.array(start)


def is_possible(problem: Problem, y: Vector) -> bool:
    """Whether the camera is in no ball in which it was not at the start."""
    return bool(np.all(gaps(problem.scene_at(y))[gaps(problem.scene) > 0] > 0))


def gaps(scene: Scene) -> Float[np.ndarray, " spheres"]:
    """The distance of each ball's surface from the camera; negative if the camera is in the ball."""
    parts = scene.spheres.center, scene.spheres.radius, scene.camera.viewpoint
    center, radius, viewpoint = (np.asarray(part, np.float64) for part in parts)
    return np.linalg.norm(center - viewpoint[:, None], axis=0) - radius


def at_bounds(y: Vector, unknowns: Unknowns) -> Int[np.ndarray, " parameters"]:
    """The end of its reach that each unknown is at: -1 is the lower, 1 the upper, 0 neither."""
    lower, upper = unknowns.reach
    # The ends are rounded to the unknowns' dtype, as where they were clipped.
    place = np.asarray(y)
    return np.where(place <= lower.astype(place.dtype), -1, np.where(place >= upper.astype(place.dtype), 1, 0))


def bounds_reached(y: Vector, unknowns: Unknowns) -> tuple[tuple[str, float], ...]:
    """The name of each parameter that is at a bound, with the bound."""
    rows = zip(unknowns.names, unknowns.transforms, at_bounds(y, unknowns), strict=True)
    return tuple((name, bounded.lower if side < 0 else bounded.upper) for name, bounded, side in rows if side)


def project_gradient(state: FitState) -> Linearization:
    """A state's linearisation that holds the unknowns at a bound where the cost falls beyond it (projected gradient).

    Their columns of the Jacobian are 0, so that no step moves them.
    """
    side, linearization = at_bounds(state.y, state.problem.unknowns), state.linearization
    if not side.any():
        return linearization
    triangle = np.asarray(linearization.jacobian)
    downhill = -triangle.T @ np.asarray(linearization.residual)
    return dataclasses.replace(linearization, jacobian=on_device(np.where(side * downhill > 0, 0, triangle)))


class LocalMinimum(NamedTuple):
    """A minimum with all that is known of it."""

    summary: Minimum
    y: Vector
    residual: Image

    @classmethod
    def of(cls, state: FitState, candidate: int, level: int) -> "LocalMinimum":
        """The minimum that a solve from a candidate came to on a level, yet without evidence against it."""
        value, rms = state.problem.values(state.y), state.rms_residual * state.problem.unit
        return cls(Minimum(candidate, value, rms, level, explains(state), 0.0), state.y, state.residual)

    def judged_against(self, best: Image) -> "LocalMinimum":
        """A copy with the evidence that a better residual is better."""
        return self._replace(summary=dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual)))


@dataclasses.dataclass(frozen=True)
class Findings:
    """The findings of a fit so far; each stage adds to them, and an interrupt takes nothing away.

    Args:
        answer: the best unknowns so far, None before the first step.
        unseen: balls that the target does not show, with their free index and positions.
        check: whether the model is right, if that was looked at.
        start_image: the picture at the start, compared as the solution's is.
    """

    answer: Vector | None = None
    minima: tuple[LocalMinimum, ...] = ()
    solution: FitState | None = None
    uncertainty: Uncertainty | None = None
    unseen: dict[str, tuple[str, ...]] = dataclasses.field(default_factory=dict)
    profiles: tuple[Profile, ...] = ()
    check: ModelCheck | None = None
    start_image: Image | None = None


class Recorder:
    """Keeps history and findings, tells the caller of each step, and watches the clock."""

    def __init__(
        self,
        problem: Problem,
        on_step: Callable[[FitStep], None] | None = None,
        on_phase: Callable[[str], None] | None = None,
        max_seconds: float | None = None,
    ):
        self.problem, self.max_seconds = problem, max_seconds
        self.on_step, self.on_phase = on_step, on_phase
        self.started = time.monotonic()
        self.is_stopped = False
        self.history: list[FitStep] = []
        self.findings = Findings()
        self.begin(0, 0)

    def phase(self, words: str) -> None:
        if self.on_phase is not None and not self.is_stopped:
            self.on_phase(words)
        self.check_clock()

    def check_clock(self) -> None:
        """Raise TimeoutError when the time is up, or the work was asked to stop."""
        is_over = self.max_seconds is not None and time.monotonic() - self.started > self.max_seconds
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

    def begin(self, candidate: int, level: int, blur: float = 0.0, leads: bool = True) -> None:
        """Have the steps from now on be those of one level of a candidate; `leads`: they are the best answer so far."""
        self.candidate, self.level, self.blur, self.leads = candidate, level, blur, leads

    def step(self, cost: float, accepted: bool, y: Vector) -> None:
        """Add a step to the history, counted on from those that it has of the same level and candidate."""
        place = self.candidate, self.level
        number = sum((step.candidate, step.level) == place for step in self.history)
        if self.leads:
            self.found(answer=y)
        cost, seconds = cost * self.problem.unit**2, time.monotonic() - self.started
        self.history.append(FitStep(*place, self.blur, number, cost, accepted, self.problem.values(y), seconds))
        if self.on_step is not None and not self.is_stopped:
            self.on_step(self.history[-1])
        self.check_clock()
