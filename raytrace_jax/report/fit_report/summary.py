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

from raytrace_jax._version import __version__
from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.settings import MODEL_RULES
from raytrace_jax.util.digits import value_and_error, with_error
from raytrace_jax.util.files import strict

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(number: str) -> str:
    """Write a formatted number with true signs − and ±, and its power of ten, if it has one, as `10⁻⁵`."""
    raised = re.sub(r"e([+-]?[0-9]+)", lambda found: f" × {power_of_ten(int(found[1]))}", number)
    return raised.replace("+-", "±").replace("-", "−")


def power_of_ten(exponent: int) -> str:
    """Write a power of ten with a raised exponent."""
    return f"10{str(exponent).translate(_RAISED)}"


def number_text(value: float, digits: int = 3) -> str:
    """Write a number to some significant digits; infinity and NaN in words."""
    if math.isnan(value):
        return "unknown"
    if math.isinf(value):
        return "infinite"
    # Without a power of ten where that would only say "thousand".
    plain = 0.001 <= abs(value) < 10**5
    rounded = float(f"{value:.{digits - 1}e}")
    return typeset(f"{rounded:.{max(digits, 5)}g}" if plain else f"{value:.{digits}g}")


def in_steps_of_8_bits(colour: float) -> str:
    """Write a difference of colours as `2.43/255`, or `unknown` where it is NaN."""
    text = number_text(255 * colour)
    return text if math.isnan(colour) else f"{text}/255"


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


AFTER = "seconds_after_the_last_step"
"""The command line adds to a result's provenance by this name the time in which the estimate was judged."""

NUMBERS = ("value", "initial", "standard_error", "resolution", "systematic_error", "total_error", "cramer_rao", "unit")
"""What `result.json` has of each parameter."""


def summarize(result: FitResult, scene_text: str) -> dict[str, Any]:
    """Everything in a fit but its pictures, as plain values: what is infinite or not a number is None."""
    # Ending and numbers first, then what they rest on, at last what would make them again.
    sure, pictures, given = result.uncertainty, result.pictures, result.given
    summary = {
        "status": result.status,
        "message": result.message,
        "advice": result.advice,
        "parameters": {row.name: {key: getattr(row, key) for key in NUMBERS} for row in result.rows},
        "at_bound": dict(result.ending.at_bound),
        "rests_on": result.rests_on,
        "depends_on": {name: found._asdict() for name, found in result.depends_on.items()},
        "sensitivity": {
            assumption.name: dict(zip(result.names, assumption.sensitivity.tolist(), strict=True))
            for assumption in result.check.assumptions
        },
        "uncertain": {a.name: a.uncertainty for a in result.check.assumptions if a.uncertainty},
        "causes": [cause._asdict() | {"words": cause.words} for cause in result.check.causes],
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
    """A fit's origin as far as it is known, with the target's width and height and the seconds of each stage."""
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
    names = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
    libraries = {name: importlib.metadata.version(name) for name in names}
    return {"raytrace_jax": __version__, **libraries, "python": platform.python_version()}


_SPECIAL = {
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
}


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
        errors = (value_and_error(0.0, error)[1] for error in (row.standard_error, row.total_error))
        cells = [rf"\texttt{{{_escaped(row.label)}}}", *map(_number, (row.text(long), *errors)), _escaped(row.unit)]
        lines.append(rf"{' & '.join(cells)} \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _escaped(text: str) -> str:
    return re.sub(".", lambda sign: _SPECIAL.get(sign[0], sign[0]), text, flags=re.DOTALL)


def _number(text: str) -> str:
    """A written number as LaTeX's mathematics; the words behind it, if there are any, stay words."""
    number, comma, words = text.partition(",")
    if number in ("inf", "nan"):
        return r"$\infty$" if number == "inf" else "unknown"
    number = re.sub(r"e\+?(-?)0*([0-9]+)", r"\\times10^{\1\2}", number).replace("+-", r"\pm")
    return f"${number}${comma}{words}"
