"""The options of `batch`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg


@dataclass(frozen=True)
class Batch:
    """Run the many renders, derivatives and fits of a plan, and gather them in a table.

    PLAN.toml names scenes, grids and lists of parameters, noise and seeds (docs/batch.md describes it). DIR gets a
    folder of files for each kind of job, and results.csv, with results.parquet beside it if pyarrow is installed. What
    is done already is not done again: after Ctrl-C, a kill or a failure the same command goes on. The exit code is 1
    if a job failed, which the table says.

    Example: raytrace-jax batch plan.toml -o results --workers 2
    """

    plan: Annotated[Positional[Path], arg(metavar="PLAN.toml")]
    """What to do."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """The folder for the results; it is made if it is missing."""
    workers: Annotated[int | None, arg(metavar="N")] = None
    """Share the jobs out to N processes on this machine, one core each; without it they run one after the other on one
    core. Needs the extra `batch`."""
    scheduler: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Share the jobs out to the workers of this dask scheduler, as tcp://10.0.0.1:8786. They must see DIR, and the
    plan's targets, under the same paths. Needs the extra `batch`."""
    quiet: bool = False
    """Show no progress; errors and warnings are still shown."""
