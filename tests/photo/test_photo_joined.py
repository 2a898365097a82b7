"""Corners and light as one estimate: that of one least-squares problem whose rows are both."""

from types import SimpleNamespace

import numpy as np
import pytest

from raytrace_jax.photo.opinions import combine
from raytrace_jax.photo.room_scene import GLASSES, HELD

GLASS, COUNT = ["ball.ior", *(f"ball.center.{axis}" for axis in "xyz")], GLASSES + len(HELD)


def problem(noise, off=0.0):
    """What `combine` says of linear corners and a linear fit, their joint least squares, and the corners' own error."""
    random = np.random.default_rng(5)
    corners, truth = random.normal(size=(40, COUNT)), random.normal(size=COUNT)
    covariance = 0.1**2 * np.linalg.inv(corners.T @ corners)
    seen = corners @ truth + 0.1 * random.normal(size=40)
    told = np.linalg.lstsq(corners, seen)[0]
    # The fit holds camera and radius as the corners have them; the gain is its own.
    sensitivity = random.normal(size=(GLASSES, len(HELD)))
    value = truth[:GLASSES] + sensitivity @ (told - truth)[GLASSES:] + noise * random.normal(size=GLASSES)
    value[0] += off
    every = np.concatenate([sensitivity, random.normal(size=(1, len(HELD)))])
    result = SimpleNamespace(
        names=[*GLASS, "film.gain"],
        value=np.append(value, 1.0),
        uncertainty=SimpleNamespace(covariance=noise**2 * np.eye(GLASSES + 1)),
        check=SimpleNamespace(
            structure=np.zeros((GLASSES + 1, GLASSES + 1)),
            assumptions=[SimpleNamespace(name=name, sensitivity=every[:, k]) for k, name in enumerate(HELD)],
        ),
    )

    rows = np.concatenate([corners / 0.1, np.concatenate([np.eye(GLASSES), -sensitivity], axis=1) / noise])
    right = np.concatenate([seen / 0.1, (value - sensitivity @ told[GLASSES:]) / noise])
    index, error = np.linalg.lstsq(rows, right)[0][0], np.sqrt(np.linalg.inv(rows.T @ rows)[0, 0])
    both = combine(SimpleNamespace(glass=GLASS, held=HELD, told=told[:GLASSES], covariance=covariance), result)
    return both, (index, error), np.sqrt(covariance[0, 0])


@pytest.mark.parametrize("noise", [1e-3, 0.02, 5.0])
def test_joint_estimate_is_least_squares(noise):
    both, wanted, alone = problem(noise)
    np.testing.assert_allclose(both.ior, wanted, rtol=1e-8)
    assert both.ior[1] < alone and both.apart < 3


def test_contradicting_light_counts_for_less():
    agrees, (index, _), alone = problem(0.02)
    differs, _, _ = problem(0.02, off=1.0)
    assert differs.apart > 5 > agrees.apart
    assert differs.share < 0.3 * agrees.share and abs(differs.ior[0] - index) < 3 * alone
