"""The tables of the report's page: what stands in each cell."""

import re
from typing import NamedTuple

import numpy as np

from raytrace_jax.inverse.assumptions import WHAT_IF, Dependence
from raytrace_jax.inverse.noise import EVIDENCE
from raytrace_jax.inverse.result import FitResult, Minimum
from raytrace_jax.report.fit_report.summary import provenance_of, used_settings
from raytrace_jax.report.fit_report.text import (
    correlation_text,
    error_text,
    estimate_lines,
    level_labels,
    number_text,
    typeset,
)

PROVENANCE = ("target", "target_size", "target_bytes", "target_sha256", "command", "date", "seconds", "stages")
"""What is told of a fit's origin, in this order."""

POSITIVE, NEGATIVE = "178, 24, 43", "33, 102, 172"


class Cell(NamedTuple):
    """A number of a column.

    Args:
        pad: by how many digits it must move to the left for the column's decimal points to meet.
    """

    text: str
    pad: float = 0.0


class Row(NamedTuple):
    """A row of the table of parameters."""

    name: str
    start: Cell
    value: Cell
    error: Cell
    of_noise: Cell
    systematic: Cell
    bound: Cell
    prior: str
    depends_on: str


def parameter_rows(result: FitResult, long: bool = False) -> list[Row]:
    """Every parameter's start, estimate, error and its parts, Cramér-Rao bound, prior, and what it depends on most."""
    priors = {name: f"{number_text(mean)} ± {number_text(spread, 2)}" for name, mean, spread in result.priors}

    def errors(column: np.ndarray) -> list[Cell]:
        return _aligned([error_text(float(error)) for error in column])

    known = (result.total_error, result.standard_error, result.systematic_error, result.uncertainty.cramer_rao)
    columns = zip(
        result.labels,
        _aligned([typeset(f"{start:.8g}") for start in result.initial]),
        # That an error is not determined or unknown stands in its own column.
        _aligned([line.partition(",")[0] for line in estimate_lines(result, long)]),
        *map(errors, known),
        (priors.get(name, "–") for name in result.names),
        (_dependence(found) if (found := result.depends_on.get(name)) else "–" for name in result.names),
        strict=True,
    )
    return [Row(*cells) for cells in columns]


def _dependence(found: Dependence) -> str:
    """`ball.radius: +0.0023 moves it by +0.0015`."""
    change, shift = (number_text(value, 2).lstrip("+") for value in (found.change, abs(found.shift)))
    return f"{found.on}: +{change} moves it by {'+' if found.shift > 0 else '−'}{shift}"


def _aligned(texts: list[str]) -> list[Cell]:
    """Pad numbers, also with (error), such that their decimal points meet; a point is about half as wide as a digit."""
    plain = [re.fullmatch(r"−?\d+((?:\.\d+)?(?:\(\d+\))?)", text) for text in texts]
    widths = [len(match[1]) - 0.5 if match and match[1] else 0.0 for match in plain]
    return [Cell(t, max(widths) - w if match else 0.0) for t, w, match in zip(texts, widths, plain, strict=True)]


def correlation_rows(result: FitResult) -> list[tuple[str, list[tuple[str, str]]]]:
    """The lower triangle of the correlation matrix: for each parameter, texts and background colours."""
    rows = []
    determined = np.isfinite(result.standard_error)
    for i, name in enumerate(result.labels):
        cells = []
        for j in range(i + 1):
            r = float(result.uncertainty.correlation[i, j])
            known = np.isfinite(r) and determined[i] and determined[j]
            if i == j:
                cells.append(("1", "transparent"))
            elif known:
                tint = f"rgba({POSITIVE if r > 0 else NEGATIVE}, {0.45 * min(abs(r), 1):.2f})"
                cells.append((correlation_text(r), tint))
            else:
                cells.append(("–", "transparent"))
        rows.append((name, cells))
    return rows


def assumption_rows(result: FitResult) -> list[tuple[str, list[str]]]:
    """The numbers that the answer rests on most, and how far each estimate moves if one is a tenth of a percent off.

    The columns are the number in the scene, how well it is known if that was stated, and the estimates.
    """
    rows = []
    for assumption in result.check.assumptions[:10]:
        shifts = assumption.sensitivity * assumption.size * WHAT_IF
        stated = number_text(assumption.uncertainty, 2) if assumption.uncertainty else "–"
        value = typeset(f"{assumption.value:.8g}")
        rows.append((assumption.name, [value, stated, *(number_text(float(shift), 2) for shift in shifts)]))
    return rows


class MinimaTable(NamedTuple):
    """The table of the minima that were found, one column each, the estimate's first.

    Args:
        candidates: numbers of the starts that led there, as in `FitStep`.
        rows: a label, and one text for each minimum.
        left_out: how many minima are not shown.
    """

    candidates: list[int]
    rows: list[tuple[str, list[str]]]
    left_out: int


def minima_table(result: FitResult) -> MinimaTable:
    """Compare the estimate with the best of the other minima."""
    others = result.history.runner_ups[:5]
    labels = level_labels(result.history.steps)
    rows = [
        (name, [number_text(float(v), 6) for v in (result.value[k], *(other.value[k] for other in others))])
        for k, name in enumerate(result.labels)
    ]
    residuals = [255 * rms for rms in (result.pictures.rms_residual, *(other.rms_residual for other in others))]
    rows.append(("rms residual [1/255]", [number_text(rms) for rms in residuals]))
    rows.append(("judged with", ["no blur", *(labels.get(m.level, f"level {m.level + 1}") for m in others)]))
    rows.append(("evidence", ["–", *(number_text(other.evidence) for other in others)]))
    rows.append(("verdict", ["estimate", *map(_verdict, others)]))
    candidates = [result.history.candidate, *(other.candidate for other in others)]
    return MinimaTable(candidates, rows, len(result.history.runner_ups) - len(others))


def _verdict(other: Minimum) -> str:
    if not other.explained:
        return "does not explain it"
    return "worse" if other.evidence >= EVIDENCE else "cannot be told apart"


def setting_rows(result: FitResult) -> list[tuple[str, str]]:
    """The render settings and the loss, as a user would say them."""
    settings = used_settings(result.settings)
    return [("loss", result.loss), *((name.replace("_", " "), _setting(value)) for name, value in settings.items())]


def provenance_rows(result: FitResult) -> list[tuple[str, str]]:
    """What was fitted, when and how."""
    labels = {"target_size": "its size [pixels]", "target_bytes": "its file [bytes]", "target_sha256": "SHA-256 of it"}
    labels |= {"seconds": "time to the last step [s]", "stages": "time by stage"}
    known = provenance_of(result)
    width, height = known["target_size"]
    stages = "; ".join(f"{stage}: {seconds:.3g} s" for stage, seconds in known["stages"].items())
    part = f" from column {crop[0]}, row {crop[1]} on" if (crop := result.settings.crop) else ""
    known |= {"target_size": f"{width} × {height}{part}", "stages": stages or "none"}
    order = sorted(known, key=lambda name: list(PROVENANCE).index(name) if name in PROVENANCE else len(PROVENANCE))
    return [(labels.get(name, name.replace("_", " ")), known[name]) for name in order]


def _setting(value: object) -> str:
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "not set" if value is None else str(value)
