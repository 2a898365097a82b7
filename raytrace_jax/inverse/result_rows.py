"""The estimates of a fit, a row each, and the table that people read."""

import math
from collections.abc import Sequence
from typing import NamedTuple

from ..util.digits import value_and_error, with_error


class Estimate(NamedTuple):
    """One number of the answer.

    Args:
        error: its total standard deviation; infinity where the picture does not determine the number, NaN where the
            error is unknown.
    """

    value: float
    error: float
    unit: str

    @property
    def interval(self) -> tuple[float, float]:
        """The 95 % interval, of a normal distribution with this error; a profile's is in `FitResult.profiles`."""
        half = 1.95996 * self.error  # That many standard deviations on either side hold 95 % of a normal distribution.
        return self.value - half, self.value + half

    def __str__(self) -> str:
        return with_error(self.value, self.error)


class EstimateRow(NamedTuple):
    """All that is known of one free number: every table of the estimates is written from these rows.

    Args:
        name, label: as the user spelled it, and as people read it (`FitResult.labels`).
        resolution, cramer_rao: as in `Uncertainty`.
    """

    name: str
    label: str
    unit: str
    initial: float
    value: float
    standard_error: float
    resolution: float
    systematic_error: float
    total_error: float
    cramer_rao: float

    def text(self, long: bool = False) -> str:
        return with_error(self.value, self.total_error, long)


def estimate_table(rows: Sequence[EstimateRow], long: bool = False) -> tuple[list[str], list[tuple[str, ...]]]:
    """The heads and rows of a table of the estimates: name, start, estimate with the error to publish, and its parts.

    `long` writes `1.337 +- 0.002` in place of `1.337(2)`.
    """
    # No error is shown if none is known, and its parts only if there are several.
    if all(math.isnan(row.standard_error) for row in rows):
        texts = [(row.label, f"{row.initial:.8g}", f"{row.value:.8g}") for row in rows]
        return ["parameter", "initial", "estimate"], texts
    texts = [(row.label, f"{row.initial:.8g}", row.text(long)) for row in rows]
    if not any(row.systematic_error > 0 for row in rows):
        return ["parameter", "initial", "estimate"], texts
    parts = [[value_and_error(0.0, e)[1] for e in (row.standard_error, row.systematic_error)] for row in rows]
    heads = ["parameter", "initial", "estimate", "of noise", "of the model"]
    return heads, [(*text, *part) for text, part in zip(texts, parts, strict=True)]
