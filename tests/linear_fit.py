"""Fits of pictures that are linear in their parameters: textbooks have their answers, and no tracer is compiled."""

import dataclasses
import functools
import string

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scenes import numbers

from raytrace_jax import Scene, parse_scene
from raytrace_jax.inverse.problem.observation import observe
from raytrace_jax.inverse.problem.prediction import ForwardModel, forward_model
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.unknowns import Transform, Unknowns, make_prior
from raytrace_jax.tracer.pixels import PixelDerivatives
from raytrace_jax.tracer.settings import ResolvedSettings


class LinearScene(Scene):
    """Spheres a, b, c ... whose centers' x are the parameters: the picture is the sum of them times `columns`.

    A type of its own: programs compiled for it are kept apart from those of scenes that are traced.
    """

    columns: Float[Array, "parameters 3 height width"] = dataclasses.field(kw_only=True)


@functools.partial(jax.jit, static_argnames="unknowns")
def image_and_columns(y, scene, unknowns):
    def image(y):
        centers = unknowns.moved(scene, y).spheres.center
        return jnp.tensordot(centers[0], scene.columns, 1).reshape(3, -1)

    return image(y), jnp.moveaxis(jax.jacfwd(image)(y), -1, 0)


def differentiate(y, scene, pixels, unknowns, settings):
    binning, (height, width) = settings.binning, scene.columns.shape[-2:]

    def binned(values):
        squares = np.asarray(values).reshape(*values.shape[:-1], height // binning, binning, width // binning, binning)
        return squares.mean(axis=(-3, -1)).reshape(*values.shape[:-1], -1)

    image, columns = map(binned, image_and_columns(y, scene, unknowns))
    return PixelDerivatives(image, columns, np.zeros(image.shape[1], bool))


def points_of(scenes, points, settings, step=None):
    images = np.tensordot(scenes.spheres.center[:, 0], scenes.columns[0], 1)
    height, width = images.shape[-2:]
    column, row = np.round(points[0] * (width - 1)), np.round((1 - points[1]) * (height - 1))
    return images[:, :, row.astype(int), column.astype(int)]


PROGRAMS = {"differentiate": differentiate, "points": points_of}
"""What the pictures are computed by; a test may put something around each."""


@forward_model.register
def _(scene: LinearScene):
    return ForwardModel(PROGRAMS["differentiate"], PROGRAMS["points"])


def linear_names(count):
    return tuple(f"{letter}.center.x" for letter in string.ascii_lowercase[:count])


def linear_problem(columns, target, *, start=None, scale=None, weights=None, priors=None, transforms=None, free=None):
    """The problem whose Jacobian is `columns`, or the first of them.

    Args:
        columns: derivatives of the picture, "parameters 3 height width".
        target: the target.
        start: the parameters' values in the scene; 0 if not given.
        scale: their natural scales, which are the spheres' radii; 1 if not given.
        weights, priors: as for `fit`.
        transforms: of the parameters; if not given, the unknowns are the values.
        free: how many of the parameters are; all if not given, else the others stay at their start.
    """
    count, _, height, width = np.shape(columns)
    scale = np.ones(count) if scale is None else scale
    start = np.zeros(count) if start is None else start
    text = f"camera eye {{ pixeldim {width} {height} worlddim 8 6 viewpoint 4 3 6 }} material glass {{ alpha 1 }}\n"
    for name, x, radius in zip(string.ascii_lowercase, start, scale, strict=False):
        text += f"sphere {name} {{ material glass center {numbers([x, 0, 0])} radius {numbers([radius])} }}\n"
    plain = parse_scene(text, dtype=jnp.float64)
    blocks = {field.name: getattr(plain, field.name) for field in dataclasses.fields(plain)}
    scene, settings = LinearScene(**blocks, columns=jnp.asarray(columns)), ResolvedSettings(max_bounces=0)
    free = count if free is None else free
    unknowns = Unknowns(linear_names(free), tuple(transforms or [Transform()] * free))
    prior = make_prior(priors or {}, unknowns, jnp.dtype(jnp.float64))
    observation = observe(target, weights, scene, settings)
    return Problem(scene, observation, unknowns, prior, settings, scene, unknowns, samples=1)
