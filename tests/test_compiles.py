"""What a whole fit compiles: each of its programs once, whatever the kind of target."""

import collections
import dataclasses

import numpy as np
import pytest
from compiles import counted_compiles
from scenes import assignment_scene

from raytrace_jax import fit, render, set_parameters
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

MOST = {"differentiate": 2, "linearize": 2, "probe_level": 2, "probe_camera": 3, "trace_batches": 3, "moved_scenes": 2}
"""How often a program may be compiled: for points and areas, for points of all and of glass alone, for a search and for
the check of the model; all others once."""


@pytest.mark.parametrize(("samples", "size"), [(1, (37, 28)), pytest.param(9, (37, 29), marks=pytest.mark.slow)])
def test_a_fit_compiles_each_program_once(samples, size):
    """Whole fits with their search; one to points, and one to means over each pixel, which corrections follow.

    A picture that lies on two devices, or a number that is a Python float once, is another program to JAX.
    """
    scene, settings = assignment_scene(), ResolvedSettings(size=size, max_bounces=1)
    truth = set_parameters(scene, {"vitreous.ior": 1.34, "vitreous.center.x": 4.31})
    target = np.asarray(render(truth, dataclasses.replace(settings, samples=samples)).image)
    with counted_compiles() as compiles:
        result = fit(scene, target, ["vitreous.ior", "vitreous.center.x"], settings)
    assert result.status == "converged"
    counts = collections.Counter(name.removeprefix("jit(").removesuffix(")") for name in compiles)
    ours = {"init", "advance", "values_and_slopes", "moved_scene", *MOST}
    # differentiate is fresh at this size; the rest may have been compiled by a test before.
    assert counts["differentiate"] == (2 if samples == 1 else 1), counts
    assert all(counts[name] <= MOST.get(name, 1) for name in ours), counts
