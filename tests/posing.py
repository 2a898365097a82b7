"""The problem that a fit solves, as `fit` poses it."""

from raytrace_jax import FitOptions
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.tracer.settings import resolve_settings


def posed(scene, target, free, settings=None, weights=None, **options):
    """The arguments are those of `fit`; the options are those of `FitOptions`."""
    return build_problem(scene, target, free, resolve_settings(scene, settings), FitOptions(**options), weights)


def posed_problem(*arguments, **options):
    """The problem alone, of the arguments of `posed`."""
    return posed(*arguments, **options).problem
