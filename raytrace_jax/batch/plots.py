"""The plots of a batch's page: estimates against truths, and what each axis of the plan does."""

import collections
import io
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from ..report.panels import data_address, drawable
from .jobs import OF_TRUTH, TOTAL, Job, TableCell, job_cells
from .plan import JobKind
from .run import JobRecord

Ended = tuple[Job, JobRecord]

AT_REST, NOT_AT_REST = "#1f6fb4", "#c1121f"
COLOURS = {"r": "#c1121f", "g": "#2f8f4e", "b": "#1f6fb4"}


class Plot(NamedTuple):
    """A plot as a page has it: a `data:` URL of its PNG, and its words for those who do not see it."""

    address: str
    words: str


def plots_of(kind: JobKind, jobs: Sequence[Ended]) -> list[Plot]:
    """The plots of the jobs of one kind, those that are done; none where nothing varies."""
    done = [(job, record) for job, record in jobs if record.status == "done"]
    axes = _axes([job for job, _ in done])
    results = list(dict.fromkeys(name for _, record in done for name in record.results))
    if kind == "fit":
        return [plot for name in results if name + TOTAL in results for plot in _of_estimate(name, done, axes)]
    groups = collections.defaultdict[str, list[str]](list)
    for name in results:
        groups[name.rpartition(".")[0] if kind == "render" else name].append(name)
    return [_of_means(of, names, done, axis, cells) for of, names in groups.items() for axis, cells in axes.items()]


def _axes(jobs: Sequence[Job]) -> dict[str, list[TableCell]]:
    """What varies on purpose, with each job's value: a seed only repeats."""
    rows = [job_cells(job) for job in jobs]
    names = dict.fromkeys(name for row in rows for name in row if name != "seed")
    columns = {name: [row.get(name) for row in rows] for name in names}
    return {name: cells for name, cells in columns.items() if len(set(cells)) > 1}


def _of_estimate(name: str, done: Sequence[Ended], axes: dict[str, list[TableCell]]) -> Iterator[Plot]:
    """Of one parameter the estimates against their truths, if these vary, and against each axis what they miss."""
    values, errors, truths = (_column(done, name + end) for end in ("", TOTAL, OF_TRUTH))
    came_to_rest = np.array([record.results.get("fit.status") == "converged" for _, record in done])
    short, known = name.removeprefix("fit."), bool(np.isfinite(truths).any())
    if known and len(set(truths[np.isfinite(truths)])) > 1:
        figure, ax = _panel(f"{short}: truth", f"{short}: estimate")
        ends = np.nanmin(truths), np.nanmax(truths)
        ax.plot(ends, ends, color="0.6", lw=1, zorder=0)
        _points(ax, truths, values, errors, came_to_rest)
        yield _plot(figure, f"Estimates of {short} against their truths")
    for axis, cells in axes.items():
        figure, ax = _panel(axis, f"{short}: estimate{' - truth' if known else ''}")
        if known:
            ax.axhline(0, color="0.6", lw=1, zorder=0)
        _points(ax, _places(ax, cells), values - truths if known else values, errors, came_to_rest)
        yield _plot(figure, f"{'Misses' if known else 'Estimates'} of {short} against {axis}")


def _of_means(of: str, names: Sequence[str], done: Sequence[Ended], axis: str, cells: Sequence[TableCell]) -> Plot:
    """Mean colours, or a mean derivative, against an axis; what else varies spreads them."""
    of = of if len(names) == 1 else f"{of} of r, g, b"
    figure, ax = _panel(axis, of)
    places = _places(ax, cells)
    for name in names:
        ax.plot(places, _column(done, name), "o", ms=4, color=COLOURS.get(name[-1] if len(names) > 1 else "", AT_REST))
    return _plot(figure, f"{of} against {axis}")


def _column(done: Sequence[Ended], name: str) -> np.ndarray:
    """A result of each job; NaN where there is none."""
    cells = (record.results.get(name) for _, record in done)
    return np.array([cell if isinstance(cell, int | float) else np.nan for cell in cells], float)


def _places(ax: Axes, cells: Sequence[TableCell]) -> np.ndarray:
    """Where an axis has the cells: numbers as they are, texts side by side with their names below."""
    if all(isinstance(cell, int | float) for cell in cells):
        return np.array(cells, float)
    names = list(dict.fromkeys(map(str, cells)))
    ax.set_xticks(range(len(names)), [drawable(name, 16) for name in names], rotation=20)
    return np.array([names.index(str(cell)) for cell in cells], float)


def _points(ax: Axes, x: np.ndarray, y: np.ndarray, errors: np.ndarray, came_to_rest: np.ndarray) -> None:
    """Points with error bars; hollow and red, with what error they claim, those of fits that did not converge."""
    for rows, colour, fill in ((came_to_rest, AT_REST, AT_REST), (~came_to_rest, NOT_AT_REST, "white")):
        if rows.any():
            bars = np.nan_to_num(errors[rows])  # An error that is not known has no bar.
            ax.errorbar(x[rows], y[rows], bars, fmt="o", ms=4, lw=1, capsize=2, color=colour, mfc=fill)


def _panel(x: str, y: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(3.6, 2.7), dpi=150, layout="constrained")
    ax = figure.subplots()
    ax.set_xlabel(drawable(x, 42), fontsize=8)
    ax.set_ylabel(drawable(y, 42), fontsize=8)
    ax.tick_params(labelsize=8)
    ax.ticklabel_format(useOffset=False)
    ax.margins(0.08)
    return figure, ax


def _plot(figure: Figure, words: str) -> Plot:
    file = io.BytesIO()
    figure.savefig(file, format="png", metadata={"Software": None})  # The same jobs make the same page.
    return Plot(data_address(file.getvalue()), words)
