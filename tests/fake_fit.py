"""Results of fits that never ran, for the tests of what is done with results."""

import dataclasses
from pathlib import Path

import numpy as np

from raytrace_jax import FitResult, load_scene
from raytrace_jax.inverse.judge.model_check import Assumption, Cause, ModelCheck
from raytrace_jax.inverse.judge.uncertainty import Uncertainty
from raytrace_jax.inverse.judge.views import ViewAlone
from raytrace_jax.inverse.result import FitStep, Minimum, Profile, ViewPictures
from raytrace_jax.scene.scene import View
from raytrace_jax.tracer.settings import ResolvedSettings

VITREOUS = Path(__file__).parent.parent / "data" / "vitreous.txt"
NAMES = ("vitreous.ior", "vitreous.center.x", "vitreous.center.y", "vitreous.radius")


def fake_result(status="converged", shape=(3, 30, 40), names=("vitreous.ior", "vitreous.radius")):
    """A result whose last parameter is not determined, with a history of two levels and a rejected step."""
    random = np.random.default_rng(7)
    target = np.floor(256 * random.uniform(size=shape)).clip(0, 255) / 255
    value, initial = np.resize([1.337, 2.3], len(names)), np.resize([1.5, 2.0], len(names))
    error = np.array([2.3e-4] * (len(names) - 1) + [np.inf])
    steps = ((0, 2.0, 0, 5.0, True), (0, 2.0, 1, 1.0, True), (1, 0.0, 0, 0.5, True), (1, 0.0, 1, 0.6, False))
    return FitResult(
        status=status,
        message="The solver came to rest.",
        advice="Nothing needs to be done.",
        at_bound=(),
        names=names,
        value=value,
        uncertainty=Uncertainty(
            standard_error=error,
            covariance=np.where(np.eye(len(names)) > 0, np.append(error[:-1], 1.0) ** 2, np.nan),
            cramer_rao=np.array([1.9e-4] * (len(names) - 1) + [np.inf]),
            sigma=0.01,
            resolution=np.zeros(len(names)),
            sigma_given=False,
            reduced_chi_square=float("nan"),
            condition_number=float("inf"),
            weakest=names[-1],
            undetermined=names[-1:],
        ),
        check=ModelCheck.nothing(len(names)),
        profiles=(),
        initial=initial,
        units=("unit of index",) * len(names),
        priors=(),
        ties=(),
        loss="l2",
        target_samples=None,
        scene=load_scene(VITREOUS),
        settings=ResolvedSettings(size=shape[:0:-1]),
        target=target,
        weights=np.ones(shape),
        start_image=target[::-1],
        image=np.clip(target + random.normal(scale=0.01, size=shape), 0, 1),
        rms_residual=0.01,
        typical_residual=0.01,
        steps=tuple(FitStep(0, *step, initial + (value - initial) * i / 3, 0.5 * i) for i, step in enumerate(steps)),
    )


def full_result(shape=(3, 60, 80), names=NAMES):
    """A result that has everything: three starts, other minima, profiles, a prior, a tie, pixels that do not count."""
    random = np.random.default_rng(11)
    count = len(names)
    value = np.resize([1.33712, 4.29948, 2.30051, 2.2987], count)
    initial = np.resize([1.5, 4.0, 2.0, 2.0], count)
    mixing = np.eye(count) + 0.55 * random.normal(size=(count, count))
    covariance = mixing @ mixing.T
    spread = np.sqrt(np.diag(covariance))
    error = np.resize([2.3e-4, 1.1e-3, 9.6e-4, 4.1e-3], count)
    covariance = covariance * np.outer(error / spread, error / spread)
    y, x = np.mgrid[: shape[1], : shape[2]]
    target = np.stack([0.2 + 0.6 * x / shape[2], 0.3 + 0.4 * y / shape[1], 0.5 + 0.3 * np.sin(x / 9) * np.cos(y / 7)])
    image = np.clip(target, 0, 1)
    target = np.clip(image + random.normal(scale=2.4 / 255, size=shape), 0, 1)
    weights = np.ones(shape)
    weights[:, : shape[1] // 6, : shape[2] // 5] = 0
    return FitResult(
        status="ambiguous",
        message="The solver came to rest, but another minimum explains the target as well: its vitreous.ior is 1.71.",
        advice="Give a prior on vitreous.ior, or a second picture from another side.",
        at_bound=(),
        names=names,
        value=value,
        uncertainty=Uncertainty(
            standard_error=error,
            covariance=covariance,
            cramer_rao=0.93 * error,
            sigma=2.4 / 255,
            resolution=np.zeros(len(names)),
            sigma_given=True,
            reduced_chi_square=1.0213,
            condition_number=41.7,
            weakest=f"0.83 {names[-1]} − 0.56 {names[0]}",
            undetermined=(),
        ),
        check=ModelCheck(
            assumptions=(
                Assumption("topright.location.x", 6.0, 7.3, 0.01, np.resize([0.02, -0.01], count)),
                Assumption("cyan.alpha", 0.4, 0.4, 0.0, np.resize([0.001, 0.003], count)),
            ),
            causes=(Cause("topright.location.x", "%", 0.073, "free it, or measure it", 0.02, 8.2),),
            stated=0.29 * covariance,
            structure=0.2 * covariance,
            is_structured=True,
        ),
        profiles=(profile(names, 0, value, error), profile(names, count - 1, value, error, one_sided=True)),
        initial=initial,
        units=("unit of index",) * count,
        priors=((names[-1], 2.3, 0.05),),
        ties=(("central.radius", names[-1]),),
        loss="cauchy",
        target_samples=8,
        scene=load_scene(VITREOUS),
        settings=ResolvedSettings(size=shape[:0:-1], edges="aware"),
        target=target,
        weights=weights,
        start_image=np.roll(image, shape[2] // 12, axis=2),
        image=image,
        rms_residual=2.43 / 255,
        typical_residual=2.4 / 255,
        left_out=7,
        steps=tuple(history(initial, value, random)),
        runner_ups=(
            Minimum(2, value + np.resize([0.373, -0.11, 0.02, 0.21], count), 2.46 / 255, 3, True, 1.8),
            Minimum(1, value + np.resize([-0.29, 0.4, -0.3, -0.5], count), 7.9 / 255, 0, False, 14.2),
        ),
    )


def two_views(status="converged"):
    """A result of two cameras, `left` and `right/b`, whose pictures differ in size; the second alone tells less."""
    result, other = fake_result(status), fake_result(shape=(3, 24, 20))
    camera = dataclasses.replace(result.scene.camera, name="left")
    further = View(dataclasses.replace(camera, name="right/b"), None)
    fields = {field.name: getattr(other, field.name) for field in dataclasses.fields(ViewPictures)}
    pictures = ViewPictures(**fields | {"rms_residual": 0.02, "left_out": 3, "target_samples": 8})
    error = result.uncertainty.standard_error
    alone = (
        ViewAlone("left", result.value + 1e-4, 2 * error),
        ViewAlone("right/b", result.value, np.full(2, np.inf)),
    )
    scene = dataclasses.replace(result.scene, camera=camera, further_views=(further,))
    return dataclasses.replace(result, scene=scene, further_views=(pictures,), alone=alone)


def changed(result, **parts):
    """A result with other values in some of its parts: `changed(result, uncertainty={"sigma": 1.0}, loss="l2")`."""
    new = {
        name: dataclasses.replace(getattr(result, name), **part) if isinstance(part, dict) else part
        for name, part in parts.items()
    }
    return dataclasses.replace(result, **new)


def profile(names, column, value, error, one_sided=False):
    """A profile that is wider than the standard error's parabola on its right, or even has no end there."""
    t = np.linspace(-3, 3, 9)
    chi_square = np.where(t < 0, t**2, (2.5 if one_sided else t**2 / 1.3) * np.tanh(t**2))
    others = np.tile(value[:, None], (1, len(t)))
    others[column] = value[column] + t * error[column]
    upper = np.inf if one_sided else value[column] + 2.25 * error[column]
    lower = value[column] - 1.96 * error[column]
    return Profile(names[column], others[column], chi_square, others, (float(lower), float(upper)))


def history(initial, value, random):
    """Three starts on the coarsest level, of which the first goes on to two unblurred ones."""
    seconds = 0.0
    for candidate in (1, 2, 0):
        away = initial + (candidate > 0) * (value - initial) * (1.7 if candidate == 1 else -0.6)
        end = value if candidate == 0 else value + 0.3 * candidate
        done = 0.0
        for level, blur in enumerate((6.0, 3.0, 0.0, 0.0) if candidate == 0 else (6.0,)):
            for step in range(5):
                seconds += 0.4
                accepted = step != 2
                done += 0.45 * (1 - done) * (accepted and level + step > 0)
                cost = (3000 + 800 * candidate) * np.exp(-7 * done) / (1 + level) + 30 * (4 - level)
                now = away + (end - away) * done + done * (1 - done) * random.normal(scale=0.1, size=len(value))
                yield FitStep(candidate, level, blur, step, float(cost), accepted, now, seconds)
    yield FitStep(0, 3, 0.0, 5, 29.0, True, value, seconds + 0.4)
