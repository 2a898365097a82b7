"""The teaching notebooks: committed without outputs, and run from top to bottom.

They are run by nbclient, the library below nbmake, within ordinary slow tests. It comes with the extra `dev`, for a
notebook's kernel and its libraries are six thousand files that no fast test needs.
"""

import json
import os
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
FOLDER = ROOT / "experiments" / "teaching"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))


def code_cells(name):
    notebook = json.loads((FOLDER / name).read_text(encoding="utf-8"))
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def test_there_are_four():
    assert len(NOTEBOOKS) == 4


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_is_committed_without_outputs_and_installs_first(name):
    first, *others = code_cells(name)
    source = "".join(first["source"])
    assert 'find_spec("raytrace_jax") is None' in source and "%pip install -q ../.." in source
    assert not any("pip install" in "".join(cell["source"]) for cell in others)
    for cell in (first, *others):
        assert cell["outputs"] == [] and cell["execution_count"] is None


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_its_scene_stands_in_it(name):
    assert not any("report.lessons" in "".join(cell["source"]) for cell in code_cells(name))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the kernel's own libraries
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs_from_top_to_bottom(name, pytestconfig):
    import nbclient
    import nbformat

    notebook = nbformat.read(FOLDER / name, as_version=4)
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
