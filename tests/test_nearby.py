"""A look for a better place where few pixels of a point-sampled picture decide."""

import dataclasses
from pathlib import Path

import jax
import numpy as np
import pytest
from posing import posed_problem

from raytrace_jax import RenderSettings, load_scene, render
from raytrace_jax.inverse.solve.nearby import is_decided_by_few, look_nearby, loss_of
from raytrace_jax.inverse.solve.recorder import Recorder
from raytrace_jax.inverse.solve.refine import refine
from raytrace_jax.inverse.solve.refine_options import RefineOptions

PEBBLES = Path(__file__).parent.parent / "experiments" / "estimates" / "scenes" / "pebbles.txt"
FREE = ("ball.ior", "ball.center")
OPTIONS = RefineOptions("point", "cauchy", None, 60, 0, 0)
WORSE = np.array([-3.8e-4, -5.1e-4, 4.6e-4, -2.6e-3])
"""From the truth to a minimum on the wrong side of a jump, for the noise below: 22 error bars of two numbers."""


def problem_with_noise(size, noise):
    settings = RenderSettings(size=size)
    scene = load_scene(PEBBLES, dtype=jax.numpy.float64)
    image = np.asarray(render(scene, settings).image)
    target = image + np.random.default_rng(10).normal(0, noise, image.shape)
    return posed_problem(scene, target, FREE, settings)


@pytest.mark.slow
def test_a_minimum_on_the_wrong_side_of_a_jump_is_left_for_a_better_one():
    problem = problem_with_noise((40, 30), 1 / 255)
    truth = problem.values(problem.start())
    start = problem.array(problem.unknowns.unknowns(truth + WORSE))
    phases = []
    found = refine(problem, start, OPTIONS, Recorder(problem, None, None, phases.append, None))
    assert "looking for a better place nearby" in phases
    assert np.all(np.abs(problem.values(found.y) - truth) < [6e-4, 1e-4, 2e-4, 2e-4]), problem.values(found.y) - truth

    # Where it begins is a minimum, and the worse one.
    worse = dataclasses.replace(found, y=start, linearization=problem.linearize(start, found.comparison))
    assert is_decided_by_few(worse)
    assert loss_of(worse, found.comparison.loss_scale) > loss_of(found, found.comparison.loss_scale) + 1

    # At the best place it ends after as many looks in vain as there are spreads.
    attempts = []

    def solve(y, options):
        attempts.append(options.attempt)
        return found

    assert look_nearby(found, solve, OPTIONS, Recorder(problem, None, None, None, None)) is found
    assert attempts == ([1, 2, 3, 4] if is_decided_by_few(found) else [])
