"""What an edge-aware picture lacks of the mean over each pixel, from many samples where they are needed."""

import dataclasses

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.problem.comparison import Comparison
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.tracer.rendering import render_compiled, render_pixels
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.tiles import sample_offsets

COARSE_SAMPLES = 2
"""Samples a pixel and side with which the edge-aware picture is compared everywhere: the fewest that see an edge. 3 and
4 leave about the same error (experiments/tuning)."""

DISAGREEMENT = 1e-4
"""Where the two differ by more than this in any channel, one may be wrong: the pixel is sampled finely. A
fortieth of a step of 8 bits: half and double leave the same error, tenfold half as much again or more
(experiments/tuning)."""

FINE_SAMPLES = (32, 24, 16, 12, 8)
"""Samples a pixel and side there: the first of these that costs at most `MOST_RAYS`. Of a small picture 8 leave
a half to two error bars of noise of 1/255, 16 a tenth to a third, 32 a tenth (experiments/tuning)."""

MOST_RAYS = 2e7
"""Camera rays of the finely sampled pixels: those of 640 x 480 pixels at 8 x 8 samples, some seconds of two cores. It
bounds the time, and only chooses among `FINE_SAMPLES`."""


def supersampled(problem: Problem, y: Float[Array, " parameters"], samples: int) -> Float[np.ndarray, "3 height width"]:
    """The picture at `y` with so many point samples a pixel and side."""
    return exposed(problem, y, point_sampled(problem, y, samples))


def point_sampled(
    problem: Problem, y: Float[Array, " parameters"], samples: int
) -> Float[np.ndarray, "3 height width"]:
    """The same, not exposed: the mean of pictures of one sample, which are one program for any number of samples."""
    scene, settings, total = problem.scene_at(y), sampling(problem, 1), 0.0
    offsets = sample_offsets(samples)
    for offset in offsets:
        where = problem.array(offset)
        film = problem.run_planned(
            lambda plan, where=where: render_compiled(scene, settings, plan, offset=where), settings, y
        )
        total = total + np.asarray(film.image)
    return np.asarray(total / len(offsets))


def prepare_point_sampled(problem: Problem, y: Float[Array, " parameters"]) -> None:
    """Plan and compile what `point_sampled` will run, and run nothing."""
    settings = sampling(problem, 1)
    offset = problem.array((0.0, 0.0))
    render_compiled.prepare(problem.scene_at(y), settings, problem.plan(settings, y), offset=offset)


def sampling(problem: Problem, samples: int) -> RenderSettings:
    """Settings of the problem's picture with so many point samples a pixel and side."""
    return dataclasses.replace(problem.settings("point"), samples=samples)


def exposed(
    problem: Problem, y: Float[Array, " parameters"], image: Float[np.ndarray, "3 height width"]
) -> Float[np.ndarray, "3 height width"]:
    """A picture with the exposure and the offset at `y`, where these are free."""
    return np.asarray(problem.unknowns.expose(jnp.asarray(image), problem.array(problem.values(y))))


def correct(problem: Problem, y: Float[Array, " parameters"], comparison: Comparison) -> Problem:
    """The problem with the bias of its edge-aware picture at `y`, so that both add up to the mean over each pixel.

    An edge-aware picture errs where its model of an edge is too simple, one of a few samples where anything happens
    between them. Where the two agree both are right; the other pixels, about one in four of a small picture and one in
    twelve of a large one, are sampled so finely that what is left of the error is a fifth of the error bars of a
    target with noise of 1/255.

    Args:
        problem: what is fitted.
        y: the unknowns.
        comparison: how edge-aware picture and target are compared.
    """
    scene, aware = problem.scene_at(y), np.asarray(problem.linearize(y, comparison).image)
    coarse = max(COARSE_SAMPLES, problem.base.samples)
    first = point_sampled(problem, y, coarse)
    row, column = np.nonzero(np.abs(exposed(problem, y, first) - aware).max(axis=0) > DISAGREEMENT)

    samples = next((n for n in FINE_SAMPLES if len(row) * n**2 <= MOST_RAYS), FINE_SAMPLES[-1])
    fine = sampling(problem, max(samples, coarse))
    left, top, _, _ = fine.window(scene.camera.pixeldim)
    mean = first.copy()
    mean[:, row, column] = render_pixels(scene, np.stack([left + column, top + row]), fine, runs=1)
    return problem.with_bias(exposed(problem, y, mean) - aware)
