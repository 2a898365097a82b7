"""A fit's numbers as a reader meets them: in print, as plain values, as CSV and as LaTeX.

Nothing here needs matplotlib: numbers are written first, before the pictures.
"""

import collections
import contextlib
import csv
import dataclasses
import importlib.metadata
import io
import math
import os
import platform
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ..._version import __version__
from ...inverse.judge.views import ViewAlone
from ...inverse.result import FitResult, FitStep
from ...inverse.result_file import FILE, SCENE_FILE
from ...scene.writer import save_scene
from ...tracer.settings import MODEL_RULES, ResolvedSettings
from ...util.digits import value_and_error, with_error
from ...util.files import as_path, json_text, strict, write_text
from ..films import view_paths

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(number: str) -> str:
    """Write a formatted number with true signs − and ±, and its power of ten, if it has one, as `10⁻⁵`."""
    raised = re.sub(r"e([+-]?[0-9]+)", lambda found: f" × {power_of_ten(int(found[1]))}", number)
    return raised.replace("+-", "±").replace("-", "−")


def power_of_ten(exponent: int) -> str:
    """A power of ten with raised digits."""
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
    sure, steps, samples = result.uncertainty, result.steps, result.target_samples
    height, width = result.counts.shape
    few, counted, left_out = result.residual_pixels, int(np.count_nonzero(result.counts)), result.left_out
    holding = f"nine tenths of its square in {few:,} of {counted:,} pixels, " if few else ""
    origin = "given" if sure.sigma_given else "estimated from the residual"
    apart = f"by the median; {left_out:,} pixel{'s' * (left_out > 1)} at edges and the like left out"
    chi_square = {"reduced chi-square": (number_text(sure.reduced_chi_square), "1 is right")}
    starts = len({step.candidate for step in steps})
    spent = f"{steps[-1].seconds:.3g} s" if steps else "no time"
    grid = ("many", "each pixel is taken for the mean over its area")
    return {
        "rms residual": (in_steps_of_8_bits(result.rms_residual), f"{holding}without blur"),
        "typical residual": (
            in_steps_of_8_bits(result.typical_residual),
            apart if left_out else "where the picture depends on a parameter",
        ),
        "noise": (in_steps_of_8_bits(sure.sigma), f"standard deviation, {origin}"),
        **(chi_square if sure.sigma_given else {}),
        "condition number": (number_text(sure.condition_number), "1 is best; of the scaled Jacobian"),
        "steps": (str(len(steps)), f"{starts} {'start' if starts == 1 else 'starts'}, {spent}"),
        "pixels": (f"{width} × {height}", "all count" if counted == width * height else f"{counted:,} count"),
        "target's samples": grid if samples is None else (f"{samples} × {samples}", "a pixel, on a regular grid"),
    }


IN_A_VIEW = ("rms residual", "typical residual", "pixels", "target's samples")
"""Those of `facts` that judge the picture of one view; the others are of all views together."""


def alone_table(result: FitResult, long: bool = False) -> list[tuple[str, list[str]]]:
    """What each of several views tells alone, a row a view: its name and the numbers with their error of noise.

    The last row is of all views together. It is empty where nothing is known of the views.
    """
    together = ViewAlone("all together", result.value, result.standard_error)
    rows = [(camera, np.stack(numbers, axis=1)) for camera, *numbers in (*result.alone, together) if result.alone]
    return [
        # A view may give any value to what it does not determine.
        (
            camera,
            [
                error_text(error) if math.isinf(error) else estimate_line(value, error, long)
                for value, error in numbers.tolist()
            ],
        )
        for camera, numbers in rows
    ]


def place_words(result: FitResult) -> str:
    """Where in the whole picture the target begins, behind its size; empty for all of it."""
    crop = result.settings.crop
    return f" from column {crop[0]}, row {crop[1]} on" if crop else ""


AFTER = "seconds_after_the_last_step"
"""The command line adds to a result's provenance by this name the time in which the estimate was judged."""

NUMBERS = ("value", "initial", "standard_error", "resolution", "systematic_error", "cramer_rao", "unit")
"""What `result.json` has of each parameter."""


def summarize(result: FitResult, scene_text: str) -> dict[str, Any]:
    """Everything in a fit but its pictures, as plain values: what is infinite or not a number is None."""
    # Ending and numbers first, then what they rest on, at last what would make them again.
    sure, check, estimates = result.uncertainty, result.check, result.parameters
    summary: dict[str, Any] = {
        "status": result.status,
        "message": result.message,
        "advice": result.advice,
        "parameters": {
            name: {key: getattr(estimate, key) for key in NUMBERS} | {"total_error": estimate.error}
            for name, estimate in estimates.items()
        },
        "at_bound": dict(result.at_bound),
        "rests_on": result.rests_on,
        "depends_on": {name: found._asdict() for name, found in result.depends_on.items()},
        "sensitivity": {a.name: dict(zip(result.names, a.sensitivity, strict=True)) for a in check.assumptions},
        "uncertain": {a.name: a.uncertainty for a in check.assumptions if a.uncertainty},
        "causes": [cause._asdict() | {"words": cause.words} for cause in check.causes],
        "dispersions": {name: found._asdict() for name, found in result.dispersions.items()},
        "correlation": {"names": result.names, "matrix": sure.correlation},
        **{n: getattr(sure, n) for n in ("sigma", "sigma_given", "reduced_chi_square", "condition_number", "weakest")},
        **{n: getattr(result, n) for n in ("rms_residual", "typical_residual", "left_out")},
        "loss": result.loss,
        "target_samples": result.target_samples,
        "candidate": result.candidate,
        "runner_ups": [dataclasses.asdict(minimum) for minimum in result.runner_ups],
        "profiles": [dataclasses.asdict(profile) for profile in result.profiles],
        "priors": [{"name": name, "mean": mean, "standard_deviation": spread} for name, mean, spread in result.priors],
        "ties": [{"follower": follower, "leader": leader} for follower, leader in result.ties],
        "history": [dataclasses.asdict(step) for step in result.steps],
        "settings": used_settings(result.settings),
        "provenance": provenance_of(result),
        "versions": versions(),
        "scene": scene_text,
    }
    if result.further_views:
        summary["views"] = _views(result)
    return {key: strict(value) for key, value in summary.items()}


def _views(result: FitResult) -> list[dict[str, Any]]:
    """What `result.json` has of each of several views."""
    alone = {
        view.camera: {
            name: {"value": value, "standard_error": error}
            for name, value, error in zip(result.names, view.value, view.standard_error, strict=True)
        }
        for view in result.alone
    }
    judged = ("rms_residual", "typical_residual", "left_out", "target_samples")
    return [
        {"camera": camera, **{name: getattr(view, name) for name in judged}, "alone": alone.get(camera)}
        for camera, view in result.views.items()
    ]


def provenance_of(result: FitResult) -> dict[str, Any]:
    """What is known of a fit's origin, with the target's width and height and the seconds of each stage.

    The stages are up to the first step, each level, and judging, after the last step, if it was timed.
    """
    labels, (height, width) = level_labels(result.steps), result.counts.shape
    stages, before = collections.defaultdict[str, float](float), 0.0
    for step in sorted(result.steps, key=lambda step: step.seconds):
        stages[labels[step.level] if stages else "up to the first step"] += step.seconds - before
        before = step.seconds
    stages = {stage: round(seconds, 3) for stage, seconds in stages.items()}
    known: dict[str, Any] = dict(result.provenance)
    if after := known.pop(AFTER, None):
        stages["judging"] = float(after)
    return known | {"target_size": [width, height], "stages": stages}


def used_settings(settings: ResolvedSettings) -> dict[str, object]:
    """The settings that the model has a choice of, as they were used."""
    only = MODEL_RULES[settings.model].only
    return {name: value for name, value in dataclasses.asdict(settings).items() if name not in only}


def versions() -> dict[str, str]:
    """The versions of everything that can change a number of the result."""
    names = ("jax", "jaxlib", "equinox", "optimistix", "lineax", "numpy")
    libraries = {name: importlib.metadata.version(name) for name in names}
    return {"raytrace_jax": __version__, **libraries, "python": platform.python_version()}


REST = (FILE, "fit.exr", "residual.exr", "estimates.csv", "estimates.tex", "methods.txt")
REST += ("report.png", "report.pdf", "report.html")
"""All files of a report but the numbers, which are small and come first."""


def views_of(result: FitResult) -> dict[str, FitResult]:
    """The result as each view sees it, by what the names of its files have behind `fit`: nothing if it is the only one.

    They are named as `render` names the pictures of several cameras.
    """
    paths = view_paths(Path("fit"), result.scene)
    return {path.name.removeprefix("fit"): result.seen_by(camera) for camera, path in paths.items()}


def write_numbers(result: FitResult, folder: str | os.PathLike[str], comments: str = "") -> str:
    """Write `result.json`, whose text is returned, and `fit.txt`, and take away pictures of an earlier fit.

    `comments` is the text of a scene's file whose comments are kept.
    """
    folder = as_path(folder)
    # Of an earlier fit to several views there are pairs of pictures.
    residuals = [path.name for path in folder.glob("residual_*.exr")]
    for name in (*REST, *residuals, *(name.replace("residual", "fit", 1) for name in residuals)):
        with contextlib.suppress(OSError):  # One that cannot be removed cannot be replaced, which is told then.
            (folder / name).unlink()
    scene_text = save_scene(result.scene, folder / SCENE_FILE, model=result.settings.model, comments=comments)
    text = json_text(summarize(result, scene_text))
    write_text(folder / "result.json", text)
    return text


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
    writer.writerow(["parameter", "estimate", "value", "standard_error", "systematic_error", "total_error", "unit"])
    for row in result.parameters.values():
        numbers = row.value, row.standard_error, row.systematic_error, row.error
        writer.writerow([row.name, row.text(long), *map(repr, numbers), row.unit])
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
    for row in result.parameters.values():
        label, unit = (text.translate(_TEX) for text in (row.label, row.unit))
        errors = (value_and_error(0.0, error)[1] for error in (row.standard_error, row.error))
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
