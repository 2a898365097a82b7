"""How often JAX traces a level of rays to make one program: the time that a first picture or fit takes hangs on it."""

import jax
import jax.numpy as jnp
import pytest
from scenes import assignment_scene

from raytrace_jax import set_parameters
from raytrace_jax.tracer.levels import level
from raytrace_jax.tracer.levels.wavefront import Stage
from raytrace_jax.tracer.programs.plan import Plan
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import ResolvedSettings


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("edges", "name"), [("point", "trace_points"), ("aware", "trace_areas")])
def test_a_level_is_traced_once_however_many_loops_and_derivatives_are_around_it(edges, name, monkeypatch):
    calls, usual = [], getattr(level, name)

    def counted(*arguments):
        calls.append(name)
        return usual(*arguments)

    monkeypatch.setattr(level, name, counted)
    how = ResolvedSettings(size=(26, 14), max_bounces=2, edges=edges, samples=2)
    plan = Plan(2, 192, (Stage(320, how.levels + 1),), 1)

    def image(ior):
        return render_planned(set_parameters(assignment_scene(), {"vitreous.ior": ior}), how, plan)[0].image

    def derivative(direction):
        return jax.jvp(image, (jnp.asarray(1.4),), (direction,))

    jax.make_jaxpr(jax.vmap(derivative))(jnp.eye(2)[0])
    assert len(calls) == 1
    jax.make_jaxpr(jax.grad(lambda ior: image(ior).sum()))(jnp.asarray(1.4))
    assert len(calls) == 1
