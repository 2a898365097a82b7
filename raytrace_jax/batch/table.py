"""The table of a batch's jobs, and the page of them with their pictures."""

import csv
import io
import math
from collections import ChainMap
from collections.abc import Mapping, Sequence
from pathlib import Path
from urllib.parse import quote

from ..report.panels import page_template
from ..util.digits import with_error
from ..util.files import write_text
from .jobs import OF_NOISE, OF_TRUTH, TOTAL, Job, Row, cell_text, job_cells, setting_cells
from .plan import JobKind
from .plots import plots_of
from .run import MISSING, JobRecord, read_record

CSV, PAGE = "results.csv", "index.html"


def make_table(jobs: Sequence[Job], folder: Path) -> list[Row]:
    """The rows, all with the same columns; a cell that means nothing for its job is None.

    The columns are in blocks: which job it is, how it ended, its results, its settings, its files.
    """
    rows: list[tuple[Row, ...]] = []
    for job in jobs:
        record = read_record(folder, job) or MISSING
        rows.append(
            (
                {"job": job.name, "kind": job.kind},
                job_cells(job),
                {"status": record.status, "message": record.message or None, "seconds": round(record.seconds, 2)},
                dict(record.results),
                setting_cells(job),
                {"file": next(iter(record.outputs), None)},
            )
        )
    columns = dict.fromkeys(name for blocks in zip(*rows, strict=True) for block in blocks for name in block)
    return [{name: cells.get(name) for name in columns} for cells in (ChainMap(*blocks) for blocks in rows)]


def write_table(rows: Sequence[Row], folder: Path) -> Path:
    """Write `results.csv`; return its path."""
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(folder / CSV, text.getvalue())
    return folder / CSV


def remove_tables(folder: Path) -> None:
    """Remove the files of an earlier run, so that none is there while jobs are missing from it."""
    for name in (CSV, PAGE):
        (folder / name).unlink(missing_ok=True)


def write_overview(jobs: Sequence[Job], folder: Path) -> Path:
    """Write the page of all jobs; return its path."""
    ended = [(job, read_record(folder, job) or MISSING) for job in jobs]
    kinds: dict[JobKind, None] = dict.fromkeys(job.kind for job in jobs)
    tables = [_table(kind, [(job, record) for job, record in ended if job.kind == kind]) for kind in kinds]
    failed = sum(record.status != "done" for _, record in ended)
    page = page_template("batch/index.html.jinja")
    write_text(folder / PAGE, page.render(tables=tables, count=len(jobs), failed=failed))
    return folder / PAGE


def _table(kind: JobKind, jobs: Sequence[tuple[Job, JobRecord]]) -> dict[str, object]:
    """The jobs of one kind: names and values that vary, those that do not, and a row each."""
    results = [_results(record.results) for _, record in jobs]
    varied = list(dict.fromkeys(name for job, _ in jobs for name, _ in job.varied))
    found = list(dict.fromkeys(name for row in results for name, text in row.items() if text))
    cells = job_cells(jobs[0][0]).items()
    fixed = [(name, cell_text(cell)) for name, cell in cells if cell is not None and name not in varied]
    rows = []
    for (job, record), result in zip(jobs, results, strict=True):
        files = [(quote(path), Path(path)) for path in record.outputs]
        rows.append(
            {
                "pictures": [address for address, path in files if path.suffix == ".png"],
                # The fits' files are named by what is in them, the others by their job and then their camera.
                "files": [(a, p.name if kind == "fit" else p.name.partition(job.name[:8])[2][1:]) for a, p in files],
                "about": ", ".join(f"{name} = {value}" for name, value in job.varied),
                "values": [dict(job.varied).get(name, "") for name in varied],
                "status": record.status,
                "message": record.message,
                "seconds": f"{record.seconds:.3g}",
                "results": [result.get(name, "") for name in found],
            }
        )
    # The settings of a kind are the same for all jobs of a scene.
    settings = {job.scene_name: setting_cells(job).items() for job, _ in jobs}
    shown = {
        scene: [(name.removeprefix("settings."), cell_text(cell)) for name, cell in cells if cell is not None]
        for scene, cells in settings.items()
    }
    return {
        "kind": kind,
        "fixed": fixed,
        "settings": shown,
        "plots": plots_of(kind, jobs),
        "varied": varied,
        "found": found,
        "rows": rows,
    }


def _results(results: Mapping[str, float | str | None]) -> dict[str, str]:
    """The cells of a job's results, estimates with their errors."""
    texts = {}
    for name, value in results.items():
        if isinstance(value, float) and name + TOTAL in results:
            error = results[name + TOTAL]
            texts[name] = with_error(value, error if isinstance(error, float) else math.nan)
        elif not name.endswith((OF_NOISE, OF_TRUTH, TOTAL)):
            texts[name] = "" if value is None else cell_text(value)
    return texts
