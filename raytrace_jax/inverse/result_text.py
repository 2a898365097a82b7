"""A fit's result in words: the rows of a table, a few lines of text, a table of HTML."""

import html

import numpy as np

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.util.digits import value_and_error, with_error
from raytrace_jax.util.text import aligned

Rows = list[tuple[str, ...]]


def estimate_rows(result: FitResult, long: bool = False) -> tuple[list[str], Rows]:
    """The heads and rows of a table of the estimates: name, start, estimate with the error to publish, and its parts.

    `long` writes `1.337 +- 0.002` in place of `1.337(2)`.
    """
    # The parts are shown only if there are several, and no error at all if none is known.
    parts = {}
    if np.any(result.systematic_error > 0):
        parts = {"of noise": result.standard_error, "of the model": result.systematic_error}
    is_unknown = np.all(np.isnan(result.standard_error))
    rows = []
    for k, name in enumerate(result.labels):
        value, error = float(result.value[k]), float(result.total_error[k])
        shown = f"{value:.8g}" if is_unknown else with_error(value, error, long)
        texts = [value_and_error(0.0, float(part[k]))[1] for part in parts.values() if not is_unknown]
        rows.append((name, f"{result.initial[k]:.8g}", shown, *texts))
    return ["parameter", "initial", "estimate", *({} if is_unknown else parts)], rows


def last_word(result: FitResult) -> str:
    """How the fit ended, why, what to do, and what the answer rests on, a sentence each."""
    sentences = f"{result.status}: {result.message}", as_sentence(result.advice), as_sentence(result.rests_on)
    return " ".join(f"{words.rstrip('.')}." for words in sentences if words)


def as_sentence(words: str) -> str:
    """Words with a capital letter, unless they begin with a name."""
    return words if "." in words.partition(" ")[0] else words[:1].upper() + words[1:]


def summary(result: FitResult) -> str:
    """The estimates, a line each, and the last word."""
    heads, rows = estimate_rows(result)
    return "\n".join([*aligned([heads, *rows]), last_word(result)])


def as_html(result: FitResult) -> str:
    """The estimates as a table of HTML, and the last word, for a notebook."""
    heads, rows = estimate_rows(result)
    cells = [[f"<th>{html.escape(text)}</th>" for text in heads]]
    cells += [[f"<td>{html.escape(text)}</td>" for text in row] for row in rows]
    table = "".join(f"<tr>{''.join(row)}</tr>" for row in cells)
    return f"<table>{table}</table><p>{html.escape(last_word(result))}</p>"
