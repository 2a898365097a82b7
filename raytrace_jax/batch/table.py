"""The table of a batch: a row a job in the order of the plan, the same bytes however the jobs were run."""

import csv
import importlib.util
import io
from collections.abc import Sequence
from pathlib import Path

from raytrace_jax.batch.jobs import Job
from raytrace_jax.batch.labels import Row, target_cells, value_cells
from raytrace_jax.batch.records import Record, read_record
from raytrace_jax.util.files import atomic_write, write_text

CSV, PARQUET = "results.csv", "results.parquet"


def make_table(jobs: Sequence[Job], folder: Path) -> list[Row]:
    """The rows, all with the same columns; a cell that means nothing for its job is None.

    The columns are in blocks: which job it is, its values, its target, how it ended, its results, its files.
    """
    rows = [_blocks(job, read_record(folder, job)) for job in jobs]
    columns = [
        name for blocks in zip(*rows, strict=True) for name in dict.fromkeys(n for block in blocks for n in block)
    ]
    flat = [{name: cell for block in blocks for name, cell in block.items()} for blocks in rows]
    return [{name: row.get(name) for name in columns} for row in flat]


def write_table(rows: Sequence[Row], folder: Path) -> list[Path]:
    """Write `results.csv` and, where pyarrow is installed, `results.parquet`; return the paths.

    Raises:
        RaytraceError: a file cannot be written.
    """
    text = io.StringIO()
    writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(folder / CSV, text.getvalue())
    if not has_parquet():
        return [folder / CSV]
    import pyarrow
    import pyarrow.parquet

    columns = {name: [row[name] for row in rows] for name in rows[0]}
    with atomic_write(folder / PARQUET) as temporary:
        pyarrow.parquet.write_table(pyarrow.table(columns), temporary)
    return [folder / CSV, folder / PARQUET]


def has_parquet() -> bool:
    """Whether Parquet files can be written; what they need is in the extra `batch`."""
    return importlib.util.find_spec("pyarrow") is not None


def remove_table(folder: Path) -> None:
    """Remove the table of an earlier run, so that none is there while jobs are missing from it."""
    for name in (CSV, PARQUET):
        (folder / name).unlink(missing_ok=True)


def _blocks(job: Job, record: Record | None) -> tuple[Row, ...]:
    """The cells of a job in the blocks of the table."""
    ended: Row = {"status": "missing", "message": None}
    if record:
        ended = {"status": record.status, "message": record.message or None}
    files: Row = {"file": record.outputs[0] if record and record.outputs else None}
    about: Row = {"job": job.name, "kind": job.kind, "scene": job.scene_name}
    return about, value_cells(job), target_cells(job), ended, dict(record.results) if record else {}, files
