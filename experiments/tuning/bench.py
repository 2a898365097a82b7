"""A fit whose truth is known, kept ready so that many values of a number cost little more than one.

All that a solver asks for is a function of the point and the way to compare: it is kept, and numbers that change no
step cost nothing.
"""

import contextlib
import dataclasses
import pathlib
from collections.abc import Iterator
from unittest import mock

import numpy as np

from raytrace_jax import RenderSettings, load_scene, render, set_parameters
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve import search as scanning
from raytrace_jax.tracer.settings import resolve_settings

EXPERIMENTS = pathlib.Path(__file__).resolve().parent.parent
SIGMA = 1 / 255
BOX_SAMPLES = 48
"""Not one of the numbers with which a fit supersamples."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, the ball in it, the range of the indices to start from, and how far off each coordinate may be."""

    path: pathlib.Path
    ball: str
    index: tuple[float, float]
    offset: float

    @property
    def free(self) -> tuple[str, str]:
        """What is fitted: an index and a position."""
        return f"{self.ball}.ior", f"{self.ball}.center"


CASES = {
    "assignment": Case(EXPERIMENTS.parent / "data" / "vitreous.txt", "vitreous", (1.05, 2.5), 0.8),
    "two balls": Case(EXPERIMENTS / "edge_gradients" / "scenes" / "two_balls.txt", "near", (1.2, 2.0), 0.6),
}


class Bench:
    """One scene with a target, which remembers what was computed.

    Args:
        case: the scene.
        size: of its pictures.
        sampling: `box` or `point`.
    """

    def __init__(self, case: Case, size: tuple[int, int], sampling: str = "box"):
        self.case, self.truth_scene = case, load_scene(case.path)
        self.how = resolve_settings(self.truth_scene, RenderSettings(size=size))
        self.truth = np.concatenate([np.atleast_1d(self.truth_scene[name]) for name in case.free])
        samples = BOX_SAMPLES if sampling == "box" else 1
        self.clean = np.asarray(render(self.truth_scene, dataclasses.replace(self.how, samples=samples)).image)
        self.kept: dict = {}

    def scene_at(self, values: np.ndarray):
        """The scene with other values of the free parameters."""
        return set_parameters(self.truth_scene, dict(zip(self.case.free, (values[0], values[1:]), strict=True)))

    def random_starts(self, count: int, seed: int = 0) -> Iterator:
        """Scenes to start from, far from the truth."""
        random = np.random.default_rng(seed)
        for _ in range(count):
            shift = random.uniform(-1, 1, 3) * self.case.offset
            yield self.scene_at(np.r_[random.uniform(*self.case.index), self.truth[1:] + shift])

    def noisy(self, seed: int, sigma: float = SIGMA) -> np.ndarray:
        """The target with noise."""
        return self.clean + np.random.default_rng(seed).normal(0, sigma, self.clean.shape)

    def problem(self, scene, target: np.ndarray, options: FitOptions = FitOptions()) -> tuple[Problem, Progress]:
        """The problem, and who keeps its history."""
        problem = build_problem(scene, target, self.case.free, self.how, options).problem
        return problem, Progress(problem)

    @contextlib.contextmanager
    def remembering(self) -> Iterator[None]:
        """Compute nothing twice for a while."""
        linearize, evaluate = Problem.linearize, scanning.evaluate

        def key(problem, *rest):
            observation = problem.observation
            numbers = [np.asarray(x).tobytes() for x in (observation.target, observation.bias)]
            return hash((*numbers, problem.base, problem.unknowns, *rest))

        def linearize_once(problem, y, stage):
            place = key(problem, np.asarray(y).tobytes(), stage)
            if place not in self.kept:
                self.kept[place] = linearize(problem, y, stage)
            return self.kept[place]

        def evaluate_once(problem, values, binning, tell):
            place = key(problem, values.tobytes(), binning)
            if place not in self.kept:
                self.kept[place] = evaluate(problem, values, binning, lambda pictures: None)
            tell(len(values))
            return self.kept[place]

        with (
            mock.patch.object(Problem, "linearize", linearize_once),
            mock.patch.object(scanning, "evaluate", evaluate_once),
        ):
            yield
