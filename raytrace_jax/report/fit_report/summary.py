"""The numbers of a fit as plain, strict JSON values."""

import dataclasses
import importlib.metadata
import platform
from typing import Any

from raytrace_jax._version import __version__
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.fit_report.text import level_labels
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.settings import MODEL_RULES
from raytrace_jax.util.json_text import strict

AFTER = "seconds_after_the_last_step"
"""What the command line adds to a result's provenance: the time in which the estimate was judged."""

LIBRARIES = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")


def summarize(result: FitResult, scene_text: str) -> dict[str, object]:
    """Everything in a fit but its pictures, as plain values: what is infinite or not a number is None."""
    # What is known of each parameter is kept by column, and read by parameter.
    columns = {
        "value": result.value,
        "initial": result.initial,
        "standard_error": result.standard_error,
        "resolution": result.uncertainty.resolution,
        "systematic_error": result.systematic_error,
        "total_error": result.total_error,
        "cramer_rao": result.uncertainty.cramer_rao,
        "unit": result.units,
    }

    # Verdict and numbers first, then what they rest on, at last what would make them again.
    summary = {
        "status": result.status,
        "message": result.message,
        "advice": result.advice,
        "parameters": {
            name: {column: numbers[k] for column, numbers in columns.items()} for k, name in enumerate(result.names)
        },
        "at_bound": dict(result.at_bound),
        "rests_on": result.rests_on,
        "depends_on": {name: found._asdict() for name, found in result.depends_on.items()},
        "sensitivity": {
            assumption.name: dict(zip(result.names, assumption.sensitivity.tolist(), strict=True))
            for assumption in result.check.assumptions
        },
        "uncertain": {a.name: a.uncertainty for a in result.check.assumptions if a.uncertainty},
        "causes": [cause._asdict() | {"words": cause.words} for cause in result.check.causes],
        "correlation": {"names": result.names, "matrix": result.uncertainty.correlation},
        "sigma": result.uncertainty.sigma,
        "sigma_given": result.uncertainty.sigma_given,
        "reduced_chi_square": result.uncertainty.reduced_chi_square,
        "condition_number": result.uncertainty.condition_number,
        "weakest": result.uncertainty.weakest,
        "rms_residual": result.pictures.rms_residual,
        "typical_residual": result.pictures.typical_residual,
        "left_out": result.pictures.left_out,
        "loss": result.loss,
        "target_samples": result.target_samples,
        "candidate": result.history.candidate,
        "runner_ups": [dataclasses.asdict(minimum) for minimum in result.history.runner_ups],
        "profiles": [dataclasses.asdict(profile) for profile in result.profiles],
        "priors": [{"name": name, "mean": mean, "standard_deviation": spread} for name, mean, spread in result.priors],
        "ties": [{"follower": follower, "leader": leader} for follower, leader in result.ties],
        "history": [dataclasses.asdict(step) for step in result.history.steps],
        "settings": used_settings(result.settings),
        "provenance": provenance_of(result),
        "versions": versions(),
        "scene": scene_text,
    }
    return {key: strict(value) for key, value in summary.items()}


def provenance_of(result: FitResult) -> dict[str, Any]:
    """What is known of a fit's origin, with the target's width and height and the seconds of each stage."""
    height, width = result.pictures.weights.shape
    known = {name: text for name, text in result.provenance.items() if name != AFTER}
    return known | {"target_size": [width, height], "stages": stage_seconds(result)}


def stage_seconds(result: FitResult) -> dict[str, float]:
    """The seconds of each stage by its name: up to the first step, each level's, and after the last if it was timed."""
    labels = level_labels(result.history.steps)
    spent, before = {}, 0.0
    for step in sorted(result.history.steps, key=lambda step: step.seconds):
        stage = labels[step.level] if spent else "up to the first step"
        spent[stage] = spent.get(stage, 0.0) + step.seconds - before
        before = step.seconds
    after = result.provenance.get(AFTER)
    return {stage: round(seconds, 3) for stage, seconds in spent.items()} | ({"judging": float(after)} if after else {})


def used_settings(settings: ResolvedSettings) -> dict[str, object]:
    """The settings that the model has a choice of, as they were used."""
    only = MODEL_RULES[settings.model].only
    return {name: value for name, value in dataclasses.asdict(settings).items() if name not in only}


def versions() -> dict[str, str]:
    """The versions of everything that can change a number of the result."""
    libraries = {name: importlib.metadata.version(name) for name in LIBRARIES}
    return {"raytrace_jax": __version__, **libraries, "python": platform.python_version()}
