"""The fit: its blur, its residual's derivative, and that it finds what a picture was made with."""

import collections
import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from compiles import counted_compiles
from hypothesis import given
from hypothesis import strategies as st
from posing import posed_problem
from scenes import assignment_scene

from raytrace_jax import FitOptions, RenderSettings, fit, render, set_parameters
from raytrace_jax.errors import RaytraceWarning
from raytrace_jax.images.filters import gaussian_blur
from raytrace_jax.inverse.problem.detect import detect_sampling
from raytrace_jax.inverse.problem.unknowns import Transform
from raytrace_jax.scene.parameters import resolve

pytestmark = pytest.mark.optimized

blur = jax.jit(gaussian_blur)
SIZE = (64, 48)
POINT = RenderSettings(size=SIZE)
FREE = ["vitreous.ior", "vitreous.center"]
TRUTH = {"vitreous.ior": 1.45, "vitreous.center": (4.15, 2.45, -1.25)}
ANSWER = [1.45, 4.15, 2.45, -1.25]
NEARBY = {"search": False, "edges": "point", "target_sampling": "point", "blur": [0.0]}
"""A fit that needs neither small pictures nor edges."""


@pytest.fixture(scope="module")
def target():
    return np.asarray(render(set_parameters(assignment_scene(), TRUTH), POINT).image)


@given(st.floats(0.3, 8), st.integers(0, 1000))
def test_blur_keeps_constants_and_is_linear(sigma, seed):
    images = jnp.asarray(np.random.default_rng(seed).normal(size=(2, 3, 12, 17)))
    one, other, both = (blur(image, jnp.asarray(sigma)) for image in (images[0], images[1], images[0] - 2 * images[1]))
    np.testing.assert_allclose(both, one - 2 * other, atol=1e-12)
    np.testing.assert_allclose(blur(jnp.full((3, 12, 17), 0.7), jnp.asarray(sigma)), 0.7, rtol=1e-12)


def test_blur_of_a_point_has_its_sigma():
    image = jnp.zeros((1, 61, 61)).at[0, 30, 30].set(1.0)
    np.testing.assert_array_equal(blur(image, jnp.asarray(0.0)), image)
    spot = np.asarray(blur(image, jnp.asarray(3.0)))[0]
    x = np.arange(61) - 30
    assert np.sqrt((spot.sum(0) * x**2).sum() / spot.sum()) == pytest.approx(3, rel=1e-3)


@given(
    st.sampled_from([f"vitreous.{name}" for name in ("ior", "radius", "alpha", "diffuse.r", "center.x")]),
    st.floats(0.05, 0.9),
)
def test_transforms_invert_and_hold_bounds(name, value):
    value = value + 1 if name == "vitreous.ior" else value
    transform = Transform(*resolve(assignment_scene(), name).attribute.quantity.range_at(value))
    assert float(transform.to_value(jnp.asarray(transform.to_unknown(value)))) == pytest.approx(value, rel=1e-10)
    for y in (-40.0, 40.0):
        far = float(transform.to_value(jnp.asarray(y)))
        assert far >= {"vitreous.ior": 1}.get(name, 0) or name == "vitreous.center.x"
        assert far <= 1 or name != "vitreous.alpha"


@pytest.fixture(scope="module")
def met(target):
    """A whole fit of a point-sampled target with its search: the result, its steps, and what it compiled."""
    return followed(target, assignment_scene())


@pytest.fixture(scope="module")
def met_nearby(target):
    """The same from nearby and without edges, which compiles a third of the programs."""
    near = set_parameters(assignment_scene(), {"vitreous.ior": 1.449, "vitreous.center": (4.152, 2.449, -1.252)})
    return followed(target, near, **NEARBY)


def followed(target, scene, **options):
    steps = []
    with counted_compiles() as compiles:
        result = fit(scene, target, FREE, POINT, options=FitOptions(**options), on_step=steps.append)
    return result, tuple(steps), compiles


@pytest.mark.slow
@pytest.mark.parametrize("which", ["met_nearby", "met"])
def test_a_point_target_is_met_to_rounding(which, request):
    result, steps, _ = request.getfixturevalue(which)
    assert result.status == "converged", result.message
    np.testing.assert_allclose(result.value, ANSWER, atol=1e-7)
    assert result.settings.edges == "point"
    assert steps == result.steps
    assert which == "met_nearby" or list(result.initial) == [1.337, 4.3, 2.3, -1]
    assert np.all(np.isfinite(result.standard_error))


MOST = {"differentiate_batches": 2, "linearize": 3, "color_batches": 1, "moved_scenes": 2, "probe_level": 0}
"""How often a fit may compile a program: for edges and for points, for small pictures of two sizes and the whole one,
for a search and for the check of the model; no rays are counted; all others once."""


@pytest.mark.slow
@pytest.mark.parametrize("which", ["met_nearby", "met"])
def test_a_fit_compiles_each_program_once(which, request):
    """A picture that lies on two devices, or a number that is a Python float once, is another program to JAX."""
    compiled = request.getfixturevalue(which)[2]
    counts = collections.Counter(name.removeprefix("jit(").removesuffix(")") for name in compiled)
    ours = {"init", "advance", "values_and_slopes", "moved_scene", *MOST}
    assert all(counts[name] <= MOST.get(name, 1) for name in ours), counts
    # Small arrays are NumPy's: few programs are single operations, or those of the film, the rays and XLA's options.
    assert counts.total() <= 40, counts


@pytest.mark.slow
def test_a_box_target_needs_no_more_programs(met):
    """Its pixels come in batches as those of a search do; a bias that lay on all devices would make another program."""
    truth = set_parameters(assignment_scene(), TRUTH)
    target = render(truth, dataclasses.replace(POINT, samples=9)).image
    near = set_parameters(truth, {"vitreous.ior": 1.449, "vitreous.center.x": 4.151})
    corrections = []
    with counted_compiles() as compiles:
        options = FitOptions(search=False, target_sampling="box")
        result = fit(near, target, FREE, POINT, options=options, on_phase=corrections.append)
    assert result.target_samples == 9 and any("own samples" in words for words in corrections)
    assert not {"jit(differentiate_batches)", "jit(linearize)"} & set(compiles), compiles
    np.testing.assert_allclose(result.value, ANSWER, atol=2e-3)


def test_a_budget_keeps_what_there_is(target):
    result = fit(assignment_scene(), target, FREE, POINT, options=FitOptions(search=False, max_seconds=1e-9))
    assert result.status == "interrupted" and "more time" in result.advice
    np.testing.assert_array_equal(result.value, result.initial)


@pytest.mark.slow
def test_another_picture_is_not_converged(target):
    with pytest.warns(RaytraceWarning, match="is not in the target where the scene says"):
        result = fit(assignment_scene(), target[:, ::-1], FREE, POINT, options=FitOptions(search=False))
    assert result.status == "not_converged", result.message
    assert "look first at the camera's numbers" in result.message
    assert "structure" in result.message


@pytest.mark.slow
def test_uneven_light_is_named_and_fitted():
    """It falls twofold from the left to the right; a fifth less at the right is named where it is left out."""
    scene, noise = assignment_scene(), np.random.default_rng(0).normal(0, 0.005, (3, *SIZE[::-1]))

    def lit(x):
        return np.asarray(render(set_parameters(scene, {**TRUTH, "film.light.x": x}), POINT).image) + noise

    found = fit(scene, lit(-1 / 3), [*FREE, "film.light"], POINT, options=FitOptions(**NEARBY))
    assert found.status == "converged", found.message
    off = np.abs(found.value - [*ANSWER, -1 / 3, 0, 0, 0, 0])
    assert np.all(off < 3 * found.standard_error) and found["vitreous.ior"].error < 2e-3
    left_out = fit(scene, lit(-0.1), FREE, POINT, options=FitOptions(**NEARBY))
    assert left_out.status == "model_incomplete", left_out.message
    assert [cause.name for cause in left_out.check.causes] == ["film.light.x"]
    assert left_out.check.causes[0].amount == pytest.approx(-0.1, rel=0.1) and "free film.light.x" in left_out.advice


@pytest.mark.fast_cases(1)
@pytest.mark.parametrize(("samples", "sampling"), [(1, "point"), (6, "box")])
def test_sampling_is_told_despite_noise(samples, sampling):
    scene = assignment_scene()
    target = render(scene, dataclasses.replace(POINT, samples=samples)).image
    noise = np.random.default_rng(1).normal(0, 1 / 255, target.shape)
    near = set_parameters(scene, {"vitreous.ior": 1.3375, "vitreous.center.x": 4.3005})
    problem = posed_problem(near, target + noise, ["vitreous.ior"], POINT, edges="point")
    assert detect_sampling(problem, problem.start()) == sampling
