"""Whether a picture is explained, whether another one is as good, and the word for how a fit ended."""

import dataclasses
import functools
import re
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from linear_fit import linear_problem
from linear_pictures import state_at
from scipy import ndimage

from raytrace_jax.inverse.judge.model_check import Assumption, Cause, Contradiction, ModelCheck
from raytrace_jax.inverse.judge.structure import is_explained, vuong_evidence
from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.progress import Findings, LocalMinimum
from raytrace_jax.inverse.result import Minimum, Profile
from raytrace_jax.inverse.status import (
    bounds_in_words,
    chi_square_excess,
    contradicted_status,
    fit_status,
    profiles_in_words,
)

HEIGHT, WIDTH = 60, 80
ROWS, COLUMNS = np.mgrid[:HEIGHT, :WIDTH]
EVERYWHERE = np.ones((HEIGHT, WIDTH), bool)
DISK = (ROWS - 30) ** 2 + (COLUMNS - 40) ** 2 < 18**2
"""The pixels that a free parameter moves."""


def picture(shift=0.0, radius=18.0):
    """A checkered disk before a smooth backdrop, edges filtered as a camera does."""
    x = COLUMNS - shift
    backdrop = np.stack([0.2 + 0.5 * COLUMNS / WIDTH, 0.6 - 0.4 * ROWS / HEIGHT, 0.3 + 0.2 * np.sin(ROWS / 9)])
    checks = 0.5 + 0.3 * np.sin(x / 4) * np.sin(ROWS / 5)
    inside = np.clip(radius - np.hypot(ROWS - 30, x - 40) + 0.5, 0, 1)
    return backdrop * (1 - inside) + checks * inside


TARGET = picture()
CONTRAST = float(TARGET[:, DISK].std())
WAVE = np.broadcast_to(np.sin(COLUMNS / 8) * np.sin(ROWS / 9), TARGET.shape)
WAVE = WAVE / np.sqrt(np.mean(WAVE**2))
"""Structure, with a root mean square of 1."""


def explained(residual, counts=EVERYWHERE, matters=DISK):
    return is_explained(residual, TARGET, counts, matters)


def noise(seed, shape=TARGET.shape):
    return np.random.default_rng(seed).normal(size=shape)


@given(st.floats(-12, 2), st.integers(0, 10**6))
def test_white_noise_is_explained(level, seed):
    assert explained(10**level * noise(seed))


@pytest.mark.parametrize(
    "wrong",
    [
        *(picture(shift) for shift in (-1, 0.5, 1, 3)),
        *(picture(shift) + 0.01 * noise(1) for shift in (-1, 0.5, 1, 3)),
        *(np.roll(TARGET, 1, axis) for axis in (1, 2)),
        *(TARGET[:, ::-1], TARGET[:, :, ::-1], picture(radius=21), np.full_like(TARGET, 0.4)),
    ],
)
def test_another_picture_is_not_explained(wrong):
    assert not explained(wrong - TARGET)


@pytest.mark.parametrize(("share", "expected"), [(0.01, True), (0.05, False)])
def test_negligible_structure_is_explained(share, expected):
    """Where a parameter moves the picture, structure of 2 % of the contrast is a good model's, and more is not."""
    assert explained(share * CONTRAST * WAVE) is expected


@pytest.mark.parametrize(("share", "expected"), [(0.1, True), (0.6, False)])
def test_structure_elsewhere_must_be_large(share, expected):
    contrast = float(np.mean(TARGET.std((1, 2))))
    residual = np.where(DISK, 1e-6 * noise(2), share * contrast * WAVE)
    assert explained(residual) is expected


def test_structure_below_noise_is_explained():
    assert explained(noise(3) + 0.1 * WAVE)
    assert not explained(noise(3) + WAVE)


def test_masked_pixels_do_not_count():
    hidden = (COLUMNS > 40) | (ROWS < 8)
    residual = np.where(hidden, WAVE, 0.01 * noise(4))
    assert not explained(residual)
    assert explained(residual, counts=~hidden)
    everywhere = np.where(hidden, 100.0, TARGET)
    assert is_explained(residual, everywhere, ~hidden, DISK)  # Neither does what the target holds there.


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (4, 4), (5, 9)])
@pytest.mark.parametrize("seed", [None, 0, 1])
def test_tiny_pictures_do_not_fail(size, seed):
    every = np.ones(size, bool)
    some = np.zeros(size, bool) if seed is None else np.random.default_rng(seed).uniform(size=size) < 0.3
    assert isinstance(is_explained(noise(5, (3, *size)), noise(6, (3, *size)), every, some), bool)
    assert is_explained(noise(5, (3, *size)), noise(6, (3, *size)), np.zeros(size, bool), some)


def rivals(seed, smooth=0.0):
    """Residuals of two models that are equally near to the truth, to either side of it, under the same noise."""
    errors = ndimage.gaussian_filter(noise(seed), (0, smooth, smooth)) if smooth else noise(seed)
    errors = 0.05 * errors / errors.std()
    apart = (picture(0.03) - picture(-0.03)) / 2
    return errors - apart, errors + apart


@pytest.mark.parametrize("smooth", [0, 0.7])
def test_equal_models_give_normal_evidence(smooth):
    z = np.array([vuong_evidence(*((one,) for one in rivals(k, smooth))) for k in range(400)])
    assert abs(z.mean()) < 0.3
    assert np.mean(abs(z) < 3) >= 0.99
    assert 0.8 < z.std() < 1.2


@pytest.mark.parametrize("level", [1e-6, 1e-2])
def test_evidence_grows_with_the_difference(level):
    """Also where the two differ in a few squares only."""
    ball = np.clip(5 - np.hypot(ROWS - 31, COLUMNS - 44) + 0.5, 0, 1)
    other = np.clip(5 - np.hypot(ROWS - 31, COLUMNS - 41) + 0.5, 0, 1)
    residual = level * noise(2)
    found = vuong_evidence((residual,), (residual + 0.5 * (ball - other),))
    expected = np.linalg.norm(0.5 * (ball - other)) * np.sqrt(3) / (2 * level)
    assert found == pytest.approx(expected, rel=0.5) and found > 30


def test_evidence_is_zero_for_the_same_model():
    assert vuong_evidence((noise(1),), (noise(1),)) == 0
    assert vuong_evidence((np.zeros_like(noise(1)),), (noise(1),)) == np.inf


def sure(error=(0.1, 0.2), undetermined=()):
    return Uncertainty(
        standard_error=np.array(error),
        covariance=np.eye(2),
        cramer_rao=np.array([0.1, 0.1]),
        sigma=0.01,
        resolution=np.zeros(2),
        sigma_given=False,
        reduced_chi_square=float("nan"),
        condition_number=3.0,
        weakest="ball.radius +1, ball.ior -0.3",
        undetermined=undetermined,
    )


def minimum(evidence):
    return Minimum(1, np.array([1.3, 0.2]), 0.01, 2, True, evidence)


GOOD = {
    "settled": True,
    "next_move": 0.0,
    "samples": 8,
    "explained": True,
    "check": ModelCheck.nothing(2),
    "excess": 0.0,
    "uncertainty": sure(),
    "runner_ups": (minimum(3.0), minimum(40.0)),
    "unseen": (),
}


@functools.cache
def some_state():
    columns = noise(7, (2, 3, 4, 4))
    return state_at(linear_problem(columns, columns[0]))


def status_of(changed):
    """The status, its reason and advice of a fit in which all is well but for what is changed."""
    of = SimpleNamespace(**{**GOOD, **changed})
    state = some_state()
    problem = dataclasses.replace(state.problem, samples=of.samples)
    solution = dataclasses.replace(state, problem=problem, settled=of.settled, next_move=of.next_move)
    minima = tuple(LocalMinimum(one, state.y, state.residual) for one in (minimum(0.0), *of.runner_ups))
    unseen = dict.fromkeys(of.unseen, ())
    findings = Findings(minima=minima, solution=solution, uncertainty=of.uncertainty, unseen=unseen, check=of.check)
    return fit_status(findings, of.explained, of.excess, 7)


CAUSE = Cause("ball.radius", "%", 0.023, "free it, or measure it", 0.0046, 7.0)
STRUCTURED = dataclasses.replace(ModelCheck.nothing(2), distant_correlation=9.0, is_structured=True)
EXPLAINED = dataclasses.replace(ModelCheck.nothing(2), causes=(CAUSE,), is_structured=True)
OPEN = sure((0.1, np.inf), ("ball.ior",))


@pytest.mark.parametrize(
    ("changed", "status", "message", "advice"),
    [
        ({}, "converged", "determines every parameter", "every other number of the scene counts"),
        ({"runner_ups": (minimum(2.9),)}, "ambiguous", "1 other minimum explains .* 2.9 standard errors", "runner-ups"),
        (
            {"runner_ups": (minimum(1.5), minimum(-0.5), minimum(9.0))},
            "ambiguous",
            "2 other minima explain the picture as well .*evidence -0.5 standard errors, wanted 3",
            "prior",
        ),
        ({"explained": False}, "not_converged", "residual shows structure", "look at the residual"),
        ({"settled": False}, "not_converged", "still moving after 7 steps", "--max-steps"),
        (
            {"settled": False, "next_move": 3.14, "samples": None},
            "not_converged",
            "did not come to rest: the next one would be 3.1 standard errors long",
            "--target-samples, fit a larger picture",
        ),
        (
            {"unseen": ("ball",), "settled": False},
            "degenerate",
            "the target does not show ball: without it the picture explains the target as well",
            "leave it out of the scene",
        ),
        ({"check": STRUCTURED}, "model_incomplete", "the residual is more than noise", "look at the residual"),
        (
            {"check": EXPLAINED},
            "model_incomplete",
            "The residual looks like ball.radius [+]0.2 %",
            "free it, or measure it; or state how well it is known with --uncertain",
        ),
        ({"uncertainty": Uncertainty.unknown(2, None)}, "not_converged", "errors of the estimate are unk", "0 to 255"),
        ({"excess": 7.3}, "model_incomplete", "larger than the noise .* 7 standard errors above 1", "--sigma"),
        (
            {"uncertainty": OPEN},
            "degenerate",
            "does not determine ball.ior: the change ball.radius [+]1, ball.ior -0.3 leaves it almost as it is",
            "--prior",
        ),
    ],
)
def test_the_word_its_reason_and_what_to_do(changed, status, message, advice):
    found, why, what = status_of(changed)
    assert found == status
    assert re.search(message, why)
    assert advice in what


BAD = {
    "far from explained": {"explained": False},
    "degenerate": {"uncertainty": OPEN},
    "still moving": {"settled": False},
    "more than noise": {"check": STRUCTURED},
    "larger than the noise": {"excess": 9.0},
    "other minimum": {"runner_ups": (minimum(0.1),)},
}
"""What can be wrong, in the order in which it is said."""


@pytest.mark.parametrize("first", range(len(BAD)))
def test_the_first_reason_is_said(first):
    reasons = list(BAD)[first:]
    assert reasons[0] in " ".join(status_of({k: v for one in reasons for k, v in BAD[one].items()})[:2])


@pytest.mark.parametrize("share", [0.02, 0.5, 3.0])
@pytest.mark.parametrize("understated", [1.0, 2.0])
def test_a_deviation_from_a_prior_is_normal(share, understated):
    """A measurement of error 1 joined with one that is `share` as sure, whose error may be larger than was believed."""
    random, least = np.random.default_rng(0), 1 / (1 + share)
    pull = share * least
    error = np.sqrt(least**2 + pull**2 * understated**2 / share)
    far = []
    for before, after in zip(random.normal(size=4000), random.normal(size=4000) / np.sqrt(share), strict=True):
        found = (1 - pull) * before + pull * understated * after
        excess = 2 * (error**2 - least)
        # What is true is 0: what was stated is off by `before`.
        far.append(Contradiction.of("x", (found, error), (before, 1.0), excess).deviations)
    assert np.sqrt(np.mean(np.square(far))) == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize(
    ("status", "wanted"),
    [("converged", "model_incomplete"), ("ambiguous", "model_incomplete"), ("model_incomplete", "model_incomplete"),
     ("not_converged", "not_converged"), ("degenerate", "degenerate")],
)  # fmt: skip
def test_a_contradicted_prior_is_said_first(status, wanted):
    found = Contradiction.of("eye.viewpoint.z", (5.012, 1e-4), (5.0, 0.002))
    word, message, advice = contradicted_status([found], (status, "what was said", "what to do"))
    assert word == wanted and advice.startswith("measure eye.viewpoint.z again")
    assert message.startswith(
        "the picture contradicts what was stated of eye.viewpoint.z: 5.01200(10), stated 5+-0.002 (6 times as far as by"
    )
    assert ("what was said" in message) == ("what to do" in advice) == (status != "converged")


def test_unexplained_outranks_degenerate():
    """Away from the answer a picture may say little of a parameter: the place is at fault, not the question."""
    for wide in (sure((0.1, 5.0), ("ball.ior",)), OPEN):
        assert status_of({"uncertainty": wide})[0] == "degenerate"
        found = status_of({"uncertainty": wide, "explained": False})
        assert found[0] == "not_converged" and "structure" in found[1]
        assert "still moving" in status_of({"uncertainty": wide, "explained": False, "settled": False})[1]


def test_what_an_answer_rests_on_is_said():
    names, error = ("ball.ior", "ball.center.z"), np.array([1e-4, 2.5e-4])
    radius = Assumption("ball.radius", 2.3, 2.3, 0.0, np.array([0.65, -2.2]), "world unit")

    def dependences(assumptions, error=error):
        check = dataclasses.replace(ModelCheck.nothing(2), assumptions=assumptions)
        rests = [check.dependence(k, name, error[k]) for k, name in enumerate(names)]
        return tuple(dependence for dependence in rests if dependence)

    ior, z = dependences((radius,))
    assert ior.words == (
        "ball.ior depends most on ball.radius: were that 0.0023 larger, ball.ior would be 0.0015 larger "
        "(15 total errors)"
    )
    assert "ball.center.z would be 0.0051 smaller (20 total errors)" in z.words
    assert [found.estimate for found in dependences((radius,), np.array([1e-4, np.inf]))] == ["ball.ior"]
    assert dependences(()) == () == dependences((radius,), np.array([np.inf, np.nan]))
    assert "more than 100,000 total errors" in dependences((radius,), np.array([1e-14, 1e-14]))[0].words

    # What was stated to be uncertain is in the error already; of the rest the index rests on something else than z.
    view = Assumption("eye.fov", 40.0, 40.0, 0.0, np.array([1e-3, 1.0]), "degree")
    stated = radius._replace(uncertainty=0.01)
    assert [found.on for found in dependences((stated, view))] == ["eye.fov", "eye.fov"]
    assert [found.on for found in dependences((radius, view))] == ["ball.radius", "eye.fov"]
    assert "were that 0.04 degrees larger" in dependences((stated, view))[0].words


def test_chi_square_tells_understated_noise():
    assert chi_square_excess(0.01 * noise(0), 0.01) == 0
    assert chi_square_excess(0.01 * noise(0), None) == 0
    assert chi_square_excess(0.01 * noise(0), 0.02) == 0, "less noise than stated is no harm"
    assert chi_square_excess(0.01 * noise(0), 0.0099) == 0, "nobody knows it to a hundredth"
    assert chi_square_excess(0.011 * noise(0), 0.01) > 5


@given(st.sets(st.sampled_from(list(BAD))))
def test_only_a_faultless_fit_converges(wrong):
    status, message, advice = status_of({k: v for one in wrong for k, v in BAD[one].items()})
    assert (status == "converged") == (not wrong)
    assert message and advice


@pytest.mark.parametrize(
    "half, error, told",
    [
        *((1.96, 1.0, ""), (2.45, 1.0, ""), (1.57, 1.0, ""), (2.74, 1.0, "1.4"), (1.18, 1.0, "0.6")),
        *((np.inf, 0.1, ""), (0.5, np.inf, ""), (0.5, np.nan, "")),
    ],
)
def test_a_profile_unlike_its_error_is_told(half, error, told):
    """One without an end, or an error bar, contradicts nothing."""
    nothing = np.zeros(0)
    profile = Profile("ball.ior", nothing, nothing, np.zeros((2, 0)), (1.5 - half, 1.5 + half))
    words = profiles_in_words([profile], ("ball.center.x", "ball.ior"), np.array([1.0, error]))
    assert (f"profile of ball.ior is {told} times as wide" in words) if told else not words


def test_what_is_at_a_bound_is_told_with_it():
    words = "; cyan.alpha is at its bound, 1; ball.diffuse.r is at its bound, 0"
    assert bounds_in_words([("cyan.alpha", 1.0), ("ball.diffuse.r", 0.0)]) == words
