"""A solver's steps: within bounds, one after the other, and recorded with what a fit has found so far."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from raytrace_jax.inverse.judge.assumptions import ModelCheck
from raytrace_jax.inverse.judge.structure import explains, vuong_evidence
from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.problem.linearize import Linearization
from raytrace_jax.inverse.problem.problem import FitState, Problem
from raytrace_jax.inverse.problem.unknowns import Image, Unknowns, Values, Vector
from raytrace_jax.inverse.result import FitStep, Minimum, Profile
from raytrace_jax.scene.scene import Scene


def clip(y: Vector, unknowns: Unknowns) -> Values:
    """The unknowns, each of which is moved to the end of its reach where it lies beyond."""
    return np.clip(np.asarray(y), *unknowns.reach)


def shorten_step(problem: Problem, origin: Vector, tried) -> Values:
    """The end of a step, moved into the reach of the unknowns and halved until no ball has swallowed the camera."""
    place, start = clip(tried, problem.unknowns), np.asarray(origin)
    # A step that leads into the impossible is given up after ten halvings: a thousandth of it is none.
    for _ in range(10):
        if is_possible(problem, problem.array(place)):
            return place
        place = (place + start) / 2
    return start


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
    # The ends are rounded to the unknowns' dtype, in which `clip` put them there.
    place = np.asarray(y)
    return np.where(place <= lower.astype(place.dtype), -1, np.where(place >= upper.astype(place.dtype), 1, 0))


def bounds_reached(y: Vector, unknowns: Unknowns) -> tuple[tuple[str, float], ...]:
    """The name of each parameter that is at a bound, with the bound."""
    rows = zip(unknowns.names, unknowns.transforms, at_bounds(y, unknowns), strict=True)
    return tuple((name, bounded.lower if side < 0 else bounded.upper) for name, bounded, side in rows if side)


def project_gradient(linearization: Linearization, y: Vector, unknowns: Unknowns) -> Linearization:
    """A linearisation that holds the unknowns at a bound where the cost falls beyond it (a projected gradient).

    Their columns of the Jacobian are 0, so that no step moves them.
    """
    side = at_bounds(y, unknowns)
    if not side.any():
        return linearization
    triangle = np.asarray(linearization.jacobian)
    downhill = -triangle.T @ np.asarray(linearization.residual)
    return dataclasses.replace(linearization, jacobian=jnp.asarray(np.where(side * downhill > 0, 0, triangle)))


def hold(linearization: Linearization, places: Sequence[int]) -> Linearization:
    """A linearisation that holds some unknowns: a solver sees no derivative along them, and leaves them there."""
    if not places:
        return linearization
    triangle = np.array(linearization.jacobian)
    triangle[:, list(places)] = 0
    return dataclasses.replace(linearization, jacobian=jnp.asarray(triangle))


def project_on_range(linearization: Linearization) -> Float[np.ndarray, " directions"]:
    """The part of the rotated residual that the Jacobian spans, in orthogonal directions."""
    triangle = np.asarray(linearization.jacobian, np.float64)
    residual = np.asarray(linearization.residual, np.float64)
    moves = np.any(triangle != 0, axis=0)
    # The triangle's own rows span it unless columns were set to 0; the last row holds what no parameter explains.
    return residual[:-1] if moves.all() else np.linalg.qr(triangle[:, moves])[0].T @ residual


Memory = TypeVar("Memory")

Record = Callable[[float, bool, Vector], None]
"""A function that is called with (cost, accepted, unknowns) after each step."""


@dataclasses.dataclass(frozen=True)
class Step(Generic[Memory]):
    """A method's place, and the place where it looks next.

    Args:
        best: where the solve ends if it ends now, and whether it is at rest there.
        accepted: whether the place that was seen last is the best.
        to: the unknowns where to look next; None ends the solve.
    """

    best: FitState
    accepted: bool
    to: Vector | None
    memory: Memory


def iterate(
    step: Step[Memory],
    look: Callable[[Step[Memory], Vector], FitState],
    propose: Callable[[Step[Memory], FitState], Step[Memory]],
    most: int,
    record: Record,
) -> FitState:
    """Step until the method proposes no further place, or `most` places were seen."""
    for _ in range(most):
        if step.to is None:
            break
        step = propose(step, look(step, step.to))
        record(step.best.linearization.cost, step.accepted, step.best.y)
    return step.best


@dataclasses.dataclass(frozen=True)
class LocalMinimum:
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
        summary = dataclasses.replace(self.summary, evidence=vuong_evidence(best, self.residual))
        return dataclasses.replace(self, summary=summary)


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
        on_step: Callable[[FitStep], None] | None,
        on_phase: Callable[[str], None] | None,
        max_seconds: float | None,
    ):
        self.problem, self.max_seconds = problem, max_seconds
        self.on_step, self.on_phase = on_step, on_phase
        self.started = time.monotonic()
        self.is_stopped = False
        self.candidate, self.level, self.blur, self.leads = 0, 0, 0.0, True
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

    def begin(self, candidate: int, level: int, blur: float = 0.0, leads: bool = True) -> None:
        """Have the steps from now on be those of one level of a candidate; `leads`: they are the best answer so far."""
        self.candidate, self.level, self.blur, self.leads = candidate, level, blur, leads

    def step(self, cost: float, accepted: bool, y: Vector) -> None:
        """Add a step to the history, counted on from those that it has of the same level and candidate."""
        place = self.candidate, self.level
        number = sum((step.candidate, step.level) == place for step in self.history)
        if self.leads:
            self.found(answer=y)
        cost *= self.problem.unit**2
        self.history.append(FitStep(*place, self.blur, number, cost, accepted, self.problem.values(y), self.seconds))
        if self.on_step is not None and not self.is_stopped:
            self.on_step(self.history[-1])
        self.check_clock()
