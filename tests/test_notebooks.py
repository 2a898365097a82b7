"""The teaching notebooks: committed without outputs, and run from top to bottom.

They are run by nbclient, the library below nbmake, within ordinary tests: so they run wherever the suite runs, beside
the other tests of `pytest -n 2`, without another option on its command line.
"""

import os
from pathlib import Path

import nbclient
import nbformat
import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "experiments" / "teaching"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))


def read(name):
    return nbformat.read(FOLDER / name, as_version=4)


def code_cells(name):
    return [cell for cell in read(name).cells if cell.cell_type == "code"]


def test_there_are_four():
    assert len(NOTEBOOKS) == 4


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_committed_without_outputs_and_installs_first(name):
    first, *others = code_cells(name)
    assert 'find_spec("raytrace_jax") is None' in first.source and "%pip install -q ../.." in first.source
    assert not any("pip install" in cell.source for cell in others)
    for cell in (first, *others):
        assert cell.outputs == [] and cell.execution_count is None


# The first shows that cells run; the others trace and fit, for up to a minute.
RUN = [pytest.param(name, marks=() if name.startswith("1") else pytest.mark.slow) for name in NOTEBOOKS]


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the kernel's own libraries
@pytest.mark.parametrize("name", RUN)
def test_it_runs_from_top_to_bottom(name, pytestconfig):
    notebook = read(name)
    cache = pytestconfig.cache.mkdir("jax")
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "JAX_COMPILATION_CACHE_DIR": os.environ.get("JAX_COMPILATION_CACHE_DIR", str(cache)),
        "MPLBACKEND": "module://matplotlib_inline.backend_inline",
    }
    client = nbclient.NotebookClient(
        notebook, timeout=600, kernel_name="python3", resources={"metadata": {"path": str(FOLDER)}}
    )
    client.execute(env=environment)
    pictures = [
        output
        for cell in notebook.cells
        if cell.cell_type == "code"
        for output in cell.outputs
        if "image/png" in output.get("data", {})
    ]
    assert pictures
