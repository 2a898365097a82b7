"""What a fit can be told: one set of options for Python, the command line and batches, and names under any spelling."""

import dataclasses
import inspect
import pydoc
import re

import numpy as np
import pytest
from linear_fit import linear_names, linear_problem
from posing import posed
from scenes import assignment_scene

from raytrace_jax import FitOptions, ParameterError, RenderSettings, fit
from raytrace_jax.tracer.settings import ResolvedSettings

SMALL = RenderSettings(size=(8, 6))
COLUMNS = np.random.default_rng([0, 2]).normal(size=(2, 3, 24, 32))
TARGET = np.tensordot([0.3, -0.2], COLUMNS, 1) + 0.02 * np.random.default_rng(0).normal(size=COLUMNS.shape[1:])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"sigma": 0.0}, "sigma is 0.0; wanted a finite standard deviation"),
        ({"loss": "l1"}, "loss is 'l1'; wanted one of auto, l2, cauchy"),
        ({"target_samples": 0}, "target_samples is 0; wanted a whole number from 1 to 64"),
        ({"target_samples": 3, "target_sampling": "point"}, "target_samples is 3, which contradicts"),
        ({"target_samples": 4, "edges": "point"}, "target_samples is for edges 'aware'"),
        ({"blur": (2.0, -1.0)}, r"blur is \(2.0, -1.0\)"),
        ({"max_steps": 0}, "max_steps is 0; wanted a whole number, 1 or more"),
        ({"priors": {"ball.ior": (1.5, "0.1")}}, "priors is .*; wanted "),
        ({"ties": {"ball.ior": 1}}, "ties is .*; wanted "),
        ({"uncertain": {"ball.center": (0.1, 0.1)}}, "uncertain is .*; wanted "),
        ({"sigma": 10**400}, "sigma is 1000.*; wanted a finite standard deviation"),
        ({"sigma": "0.01"}, "sigma is .*; wanted "),
        ({"blur": 3}, "blur is .*; wanted "),
        ({"profiles": "ball.ior"}, "profiles is .*; wanted "),
        ({"target_samples": True}, "target_samples is .*; wanted "),
    ],
)
def test_senseless_options_are_refused(options, words):
    with pytest.raises(ParameterError, match=words):
        FitOptions(**options)


def linear_fit(**options):
    problem = linear_problem(COLUMNS, TARGET)
    return fit(problem.scene, TARGET, linear_names(2), problem.base, options=FitOptions(**options))


def test_options_are_told_in_one_way():
    """Fields of options have names, and a fit takes them as `options`; a wrong name is Python's own error."""
    for name in ("options", "weights", "storage", "on_step", "on_phase"):
        assert inspect.signature(fit).parameters[name].kind is inspect.Parameter.KEYWORD_ONLY
    for options in (FitOptions, RenderSettings, ResolvedSettings):
        assert {one.kind for one in inspect.signature(options).parameters.values()} == {inspect.Parameter.KEYWORD_ONLY}
    with pytest.raises(TypeError, match=r"FitOptions\.__init__\(\) got an unexpected keyword argument 'serach'"):
        FitOptions(serach=False)
    with pytest.raises(TypeError, match="unexpected keyword argument 'sigma'"):
        fit(assignment_scene(), TARGET, ["cyan.ior"], SMALL, sigma=0.02)


@pytest.mark.parametrize("spread", [10.0, 1.0, 0.3])
@pytest.mark.parametrize(("off", "is_told"), [(1.0, False), (-2.0, False), (6.0, True), (-40.0, True)])
@pytest.mark.parametrize("sigma", [None, 0.02])
def test_a_contradicted_prior_is_named(spread, off, is_told, sigma):
    """It is so many errors of the difference off, whether the picture or the prior is surer."""
    options = {"edges": "point", "target_sampling": "point", "search": False, "sigma": sigma}
    estimate = linear_fit(**options)["a.center.x"]
    value, error = estimate.value, estimate.error
    mean = value - off * error * np.hypot(spread, 1)
    result = linear_fit(**options, priors={"a.center.x": (mean, spread * error)})
    assert result.status == ("model_incomplete" if is_told else "converged"), result.message
    assert result.message.startswith("the picture contradicts what was stated of a.center.x: ") == is_told
    assert ("measure a.center.x again" in result.advice) == is_told


def test_an_answer_has_value_error_and_unit():
    result = linear_fit(edges="point", target_sampling="point", search=False, fit_exposure=True)
    assert list(result.parameters) == ["a.center.x", "b.center.x", "film.gain.r", "film.offset.r"]
    for place, estimate in enumerate(result.parameters.values()):
        assert (estimate.value, estimate.error) == (result.value[place], result.standard_error[place])
        assert estimate.unit == ("world unit" if place < 2 else f"unit of {result.names[place].split('.')[1]}")


def test_a_parameter_has_several_names():
    """`vitreous.ior` and `cyan.ior` are one: a problem has its own names, which are those of its free numbers."""
    target = np.random.default_rng(1).uniform(size=(3, 6, 8))
    known = {"vitreous.ior": (1.4, 0.1)}
    options = {"priors": known, "profiles": ["vitreous.ior"], "ties": {"red.ior": "vitreous.ior"}}
    found = posed(assignment_scene(), target, ["vitreous.alpha", "cyan.ior"], SMALL, **options)
    assert found.problem.unknowns.names == ("vitreous.alpha", "cyan.ior")
    assert (found.priors, found.profiled) == ({"cyan.ior": (1.4, 0.1)}, (1,))
    assert found.problem.unknowns.ties == (("red.ior", "cyan.ior"),)
    np.testing.assert_array_equal(found.problem.prior.precision, [0, 10])


@pytest.mark.parametrize("options", [RenderSettings, FitOptions])
def test_help_of_options_lists_each_once_in_words(options):
    text = pydoc.plain(pydoc.render_doc(options)).split("Data and other attributes")[0]  # There pydoc cuts its lines.
    assert not re.search(r"Annotated|Wanted", text)
    listed = inspect.getdoc(options).partition("Args:\n")[2].partition("\nRaises:")[0]
    entries = re.findall(r"^    (\w+): (.+?)\. ([A-Za-z].*?\.)$", re.sub(r"\n {8}", " ", listed), re.MULTILINE)
    assert [name for name, _, _ in entries] == [field.name for field in dataclasses.fields(options)]
    assert all(kind and words for _, kind, words in entries)


def test_help_says_types_and_limits_in_words():
    assert "samples: a whole number from 1 to 64, or None. Samples per pixel" in RenderSettings.__doc__
    assert "loss: one of auto, l2, cauchy. How much large residuals count." in FitOptions.__doc__
