"""How often JAX traces a level, and how large programs are: the time that a first fit takes hangs on both."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from posing import posed_problem
from scenes import assignment_scene, resolved

from raytrace_jax import set_parameters
from raytrace_jax.tracer.levels import level
from raytrace_jax.tracer.pixels import differentiate_batches, prepare_derivatives
from raytrace_jax.tracer.pure import pure_picture
from raytrace_jax.tracer.run import Capacity


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("edges", "name"), [("point", "point_level"), ("aware", "area_level")])
def test_a_level_is_traced_once_however_many_loops_and_derivatives_are_around_it(edges, name, monkeypatch):
    calls, usual = [], getattr(level, name)

    def counted(*arguments):
        calls.append(name)
        return usual(*arguments)

    monkeypatch.setattr(level, name, counted)
    how = resolved(size=(26, 14), max_bounces=2, edges=edges, samples=2)
    scene = assignment_scene()  # Kept by the tests: it must not be made while JAX traces.

    def image(ior):
        return pure_picture(set_parameters(scene, {"vitreous.ior": ior}), how, Capacity(1024, 182)).image

    def derivative(direction):
        return jax.jvp(image, (jnp.asarray(1.4),), (direction,))

    jax.make_jaxpr(jax.vmap(derivative))(jnp.eye(2)[0])
    assert len(calls) == 1
    jax.make_jaxpr(jax.grad(lambda ior: image(ior).sum()))(jnp.asarray(1.4))
    assert len(calls) == 1


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("edges", "most"), [("point", 5_000), ("aware", 16_500)])
def test_the_largest_program_of_a_fit_is_no_larger(edges, most, monkeypatch):
    """4,600 and 15,200 lines of StableHLO today. Who needs more should see what a first fit takes then."""
    programs = []

    def lower(*arguments):
        program = jax.jit(differentiate_batches.function, static_argnums=(3, 4)).lower(*arguments)
        programs.append(program.as_text().count("\n"))

    monkeypatch.setattr(differentiate_batches, "prepare", lower)
    how, free = resolved(size=(16, 12), edges=edges), ["vitreous.ior", "vitreous.center"]
    target = np.random.default_rng(0).random((3, 12, 16))
    problem = posed_problem(assignment_scene(), target, free, how)
    prepare_derivatives(problem.start(), problem.scene, problem.unknowns, how)
    assert most / 2 < programs[0] < most
