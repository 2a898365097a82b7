"""The estimates as tables for other programs: CSV, and LaTeX to paste into a paper."""

import csv
import io
import re

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.util.text import value_and_error, with_error

HEADS = ("parameter", "estimate", "value", "standard_error", "systematic_error", "total_error", "unit")

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
    writer.writerow(HEADS)
    columns = (result.value, result.standard_error, result.systematic_error, result.total_error)
    for k, name in enumerate(result.names):
        numbers = [float(column[k]) for column in columns]
        writer.writerow([name, with_error(numbers[0], numbers[-1], long), *map(repr, numbers), result.units[k]])
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
    for k, name in enumerate(result.labels):
        errors = [float(result.standard_error[k]), float(result.total_error[k])]
        shown = [with_error(float(result.value[k]), errors[1], long), *(value_and_error(0.0, e)[1] for e in errors)]
        lines.append(rf"{' & '.join([_name(name), *map(_number, shown), _escaped(result.units[k])])} \\")
    return "\n".join([*lines, r"\bottomrule", r"\end{tabular}", ""])


def _name(name: str) -> str:
    """A name in LaTeX's typewriter, its special signs escaped."""
    return rf"\texttt{{{_escaped(name)}}}"


def _escaped(text: str) -> str:
    return re.sub(".", lambda sign: _SPECIAL.get(sign[0], sign[0]), text, flags=re.DOTALL)


def _number(text: str) -> str:
    """A written number as LaTeX's mathematics; the words behind it, if there are any, stay words."""
    number, comma, words = text.partition(",")
    if number in ("inf", "nan"):
        return r"$\infty$" if number == "inf" else "unknown"
    number = re.sub(r"e\+?(-?)0*([0-9]+)", r"\\times10^{\1\2}", number).replace("+-", r"\pm")
    return f"${number}${comma}{words}"
