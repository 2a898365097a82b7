"""A fit's numbers as a reader meets them: in print, as plain values, as CSV and as LaTeX."""

import csv
import dataclasses
import importlib.metadata
import io
import math
import platform
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from ..._version import __version__
from ...inverse.result import FitResult, FitStep
from ...tracer.resolved_settings import ResolvedSettings
from ...tracer.settings import MODEL_RULES
from ...util.digits import value_and_error, with_error
from ...util.files import strict

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(number: str) -> str:
    """Write a formatted number with true signs − and ±, and its power of ten, if it has one, as `10⁻⁵`."""
    raised = re.sub(r"e([+-]?[0-9]+)", lambda found: f" × {power_of_ten(int(found[1]))}", number)
    return raised.replace("+-", "±").replace("-", "−")


def power_of_ten(exponent: int) -> str:
    return f"10{str(exponent).translate(_RAISED)}"


def number_text(value: float, digits: int = 3) -> str:
    """Write a number to some significant digits; infinity and NaN in words."""
    if not math.isfinite(value):
        return "unknown" if math.isnan(value) else "infinite"
    # Without a power of ten where that would only say "thousand".
    plain = 0.001 <= abs(value) < 10**5
    rounded = float(f"{value:.{digits - 1}e}")
    return typeset(f"{rounded:.{max(digits, 5)}g}" if plain else f"{value:.{digits}g}")


def in_steps_of_8_bits(colour: float) -> str:
    """Write a difference of colours as `2.43/255`, or `unknown` where it is NaN."""
    return number_text(255 * colour) + ("" if math.isnan(colour) else "/255")


def error_text(error: float) -> str:
    """Write an error alone, to two digits; `not determined` where it is infinite and `unknown` where it is NaN."""
    if not math.isfinite(error):
        return "unknown" if math.isnan(error) else "not determined"
    return typeset(value_and_error(0.0, error)[1])


def estimate_line(value: float, error: float, long: bool = False) -> str:
    """Write an estimate with its error on one line, as `with_error` does, with a printer's signs."""
    return typeset(with_error(value, error, long))


def correlation_text(correlation: float) -> str:
    """Write a correlation to two decimals, without a minus sign before zero."""
    return typeset(f"{round(correlation, 2) + 0.0:.2f}")


def level_labels(history: Sequence[FitStep]) -> dict[int, str]:
    """Words that tell the levels of a history apart: the blur, and the number where that is not enough."""
    blurs = {step.level: step.blur for step in history}
    labels = {level: f"blur {blur:g} px" if blur else "no blur" for level, blur in sorted(blurs.items())}
    shared = [label for label in labels.values() if list(labels.values()).count(label) > 1]
    return {level: f"{label}, level {level + 1}" if label in shared else label for level, label in labels.items()}


def facts(result: FitResult) -> dict[str, tuple[str, str]]:
    """Number and remark of each number that judges the whole fit, by its label."""
    pictures, sure, steps, samples = result.pictures, result.uncertainty, result.history.steps, result.target_samples
    height, width = pictures.counts.shape
    few, counted, left_out = pictures.residual_pixels, int(np.count_nonzero(pictures.counts)), pictures.left_out
    holding = f"nine tenths of its square in {few:,} of {counted:,} pixels, " if few else ""
    origin = "given" if sure.sigma_given else "estimated from the residual"
    apart = f"by the median; {left_out:,} pixel{'s' * (left_out > 1)} at edges and the like left out"
    chi_square = (number_text(sure.reduced_chi_square), "1 is right")
    starts = len({step.candidate for step in steps})
    spent = f"{steps[-1].seconds:.3g} s" if steps else "no time"
    grid = ("many", "each pixel is taken for the mean over its area")
    return {
        "rms residual": (in_steps_of_8_bits(pictures.rms_residual), f"{holding}without blur"),
        "typical residual": (
            in_steps_of_8_bits(pictures.typical_residual),
            apart if left_out else "where the picture depends on a parameter",
        ),
        "noise": (in_steps_of_8_bits(sure.sigma), f"standard deviation, {origin}"),
        **({"reduced chi-square": chi_square} if sure.sigma_given else {}),
        "condition number": (number_text(sure.condition_number), "1 is best; of the scaled Jacobian"),
        "steps": (str(len(steps)), f"{starts} {'start' if starts == 1 else 'starts'}, {spent}"),
        "pixels": (f"{width} × {height}", "all count" if counted == width * height else f"{counted:,} count"),
        "target's samples": grid if samples is None else (f"{samples} × {samples}", "a pixel, on a regular grid"),
    }


def place_words(result: FitResult) -> str:
    """Where in the whole picture the target begins, behind its size; empty for all of it."""
    crop = result.settings.crop
    return f" from column {crop[0]}, row {crop[1]} on" if crop else ""


AFTER = "seconds_after_the_last_step"
"""The command line adds to a result's provenance by this name the time in which the estimate was judged."""

NUMBERS = ("value", "initial", "standard_error", "resolution", "systematic_error", "total_error", "cramer_rao", "unit")
"""What `result.json` has of each parameter."""


def summarize(result: FitResult, scene_text: str) -> dict[str, Any]:
    """Everything in a fit but its pictures, as plain values: what is infinite or not a number is None."""
    # Ending and numbers first, then what they rest on, at last what would make them again.
    sure, pictures, given, check = result.uncertainty, result.pictures, result.given, result.check
    summary: dict[str, Any] = {
        "status": result.status,
        "message": result.message,
        "advice": result.advice,
        "parameters": {row.name: {key: getattr(row, key) for key in NUMBERS} for row in result.rows},
        "at_bound": dict(result.ending.at_bound),
        "rests_on": result.rests_on,
        "depends_on": {name: found._asdict() for name, found in result.depends_on.items()},
        "sensitivity": {a.name: dict(zip(result.names, a.sensitivity, strict=True)) for a in check.assumptions},
        "uncertain": {a.name: a.uncertainty for a in check.assumptions if a.uncertainty},
        "causes": [cause._asdict() | {"words": cause.words} for cause in check.causes],
        "correlation": {"names": result.names, "matrix": sure.correlation},
        **{n: getattr(sure, n) for n in ("sigma", "sigma_given", "reduced_chi_square", "condition_number", "weakest")},
        **{n: getattr(pictures, n) for n in ("rms_residual", "typical_residual", "left_out")},
        "loss": given.loss,
        "target_samples": given.target_samples,
        "candidate": result.history.candidate,
        "runner_ups": [dataclasses.asdict(minimum) for minimum in result.history.runner_ups],
        "profiles": [dataclasses.asdict(profile) for profile in result.profiles],
        "priors": [{"name": name, "mean": mean, "standard_deviation": spread} for name, mean, spread in given.priors],
        "ties": [{"follower": follower, "leader": leader} for follower, leader in given.ties],
        "history": [dataclasses.asdict(step) for step in result.history.steps],
        "settings": used_settings(result.settings),
        "provenance": provenance_of(result),
        "versions": versions(),
        "scene": scene_text,
    }
    return {key: strict(value) for key, value in summary.items()}


def provenance_of(result: FitResult) -> dict[str, Any]:
    """A fit's origin as far as it is known, with the target's width and height and the seconds of each stage.

    The stages are up to the first step, each level, and judging, after the last step, if it was timed.
    """
    labels, (height, width) = level_labels(result.history.steps), result.pictures.counts.shape
    stages, before = {}, 0.0
    for step in sorted(result.history.steps, key=lambda step: step.seconds):
        stage = labels[step.level] if stages else "up to the first step"
        stages[stage] = stages.get(stage, 0.0) + step.seconds - before
        before = step.seconds
    known: dict[str, Any] = dict(result.provenance)
    after, stages = known.pop(AFTER, None), {stage: round(seconds, 3) for stage, seconds in stages.items()}
    judging = {"judging": float(after)} if after else {}
    return known | {"target_size": [width, height], "stages": stages | judging}


def used_settings(settings: ResolvedSettings) -> dict[str, object]:
    """The settings that the model has a choice of, as they were used."""
    only = MODEL_RULES[settings.model].only
    return {name: value for name, value in dataclasses.asdict(settings).items() if name not in only}


def versions() -> dict[str, str]:
    """The versions of everything that can change a number of the result."""
    names = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
    libraries = {name: importlib.metadata.version(name) for name in names}
    return {"raytrace_jax": __version__, **libraries, "python": platform.python_version()}


_TEX = str.maketrans(
    {sign: f"\\{sign}" for sign in "&%$#_{}"}
    | {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
)


def csv_table(result: FitResult, long: bool = False) -> str:
    """The estimates as CSV with one head: written with their error, and every number with all its digits.

    An error is `inf` where the picture does not determine the number and `nan` where it is unknown.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    numbers = ("value", "standard_error", "systematic_error", "total_error")
    writer.writerow(["parameter", "estimate", *numbers, "unit"])
    writer.writerows([r.name, r.text(long), *(repr(getattr(r, key)) for key in numbers), r.unit] for r in result.rows)
    return text.getvalue()


def tex_table(result: FitResult, long: bool = False) -> str:
    """The estimates as a tabular of LaTeX with the rules of booktabs: parameter, estimate, both errors, unit."""
    explained = "value and total error" if long else "the parentheses hold the total error in the last digits"
    lines = [
        rf"% \usepackage{{booktabs}}; estimates: {explained}; standard errors are those of noise alone.",
        r"\begin{tabular}{lrrrl}",
        r"\toprule",
        r"Parameter & Estimate & Standard error & Total error & Unit \\",
        r"\midrule",
    ]
    for row in result.rows:
        label, unit = (text.translate(_TEX) for text in (row.label, row.unit))
        errors = (value_and_error(0.0, error)[1] for error in (row.standard_error, row.total_error))
        numbers = " & ".join(map(_number, (row.text(long), *errors)))
        lines.append(rf"\texttt{{{label}}} & {numbers} & {unit} \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _number(text: str) -> str:
    """A written number as LaTeX's mathematics; the words behind it, if there are any, stay words."""
    number, comma, words = text.partition(",")
    if number in ("inf", "nan"):
        return r"$\infty$" if number == "inf" else "unknown"
    number = re.sub(r"e\+?(-?)0*([0-9]+)", r"\\times10^{\1\2}", number).replace("+-", r"\pm")
    return f"${number}${comma}{words}"
