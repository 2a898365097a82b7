"""The teaching notebooks: stored with the outputs of their code, and run from top to bottom.

They are stored and run by `experiments/teaching/store.py` with nbclient, within ordinary slow tests. It comes with the
extra `dev`, for a notebook's kernel and its libraries are six thousand files that no fast test needs.
"""

import hashlib
import json
import os
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
FOLDER = ROOT / "experiments" / "teaching"
NOTEBOOKS = sorted(path.name for path in FOLDER.glob("*.ipynb"))
STALE = "run experiments/teaching/store.py"
PRINTS = re.compile(r"\bprint\(|\bplt\.|\.imshow\(")
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?|\bnan\b")


def read(name):
    return json.loads((FOLDER / name).read_text(encoding="utf-8"))


def code_cells(notebook):
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def source_of(cell):
    return "".join(cell["source"])


def printed(notebook):
    """The words that each cell prints, without numbers: these differ between machines."""
    outputs = ([one for one in cell["outputs"] if one.get("name") == "stdout"] for cell in code_cells(notebook))
    texts = ["".join("".join(one["text"]) for one in cell) for cell in outputs]
    return [NUMBER.sub("", text).split() for text in texts]


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_a_notebook_is_small_and_anonymous(name):
    text = (FOLDER / name).read_text(encoding="utf-8")
    assert len(text) < 250_000, "outputs stay in git for good, each version of them"
    assert str(ROOT) not in text and "/tmp/" not in text and "iopub" not in text
    first, *others = code_cells(read(name))
    assert 'find_spec("raytrace_jax") is None' in source_of(first) and "%pip install -q ../.." in source_of(first)
    assert not any("pip install" in source_of(cell) for cell in others)
    assert not any("report.lessons" in source_of(cell) for cell in others), "a notebook shows its own code"


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_its_outputs_are_those_of_its_code(name):
    notebook = read(name)
    sources = json.dumps([source_of(cell) for cell in code_cells(notebook)])
    assert notebook["metadata"]["sources"] == hashlib.sha256(sources.encode()).hexdigest(), STALE
    for cell in code_cells(notebook):
        assert cell["outputs"] or not shows(source_of(cell)), f"{STALE}: {source_of(cell)}"
        assert not any(one["output_type"] == "error" or one.get("name") == "stderr" for one in cell["outputs"])


def shows(source):
    """Whether a cell's code prints, draws at its top level, or ends with a value."""
    lines = [line for line in source.splitlines() if line.strip()]
    ends_with_value = re.fullmatch(r"[\w.]+", lines[-1]) is not None
    return ends_with_value or any(PRINTS.search(line) for line in lines)


@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_begins_with_question_and_picture(name):
    notebook = read(name)
    first = notebook["cells"][0]
    assert first["cell_type"] == "markdown" and "?" in source_of(first)
    assert "(attachment:picture.png)" in source_of(first)
    (tagged,) = (cell for cell in code_cells(notebook) if "picture" in cell["metadata"].get("tags", []))
    drawn = [one["data"]["image/png"] for one in tagged["outputs"] if "image/png" in one.get("data", {})]
    assert drawn == [first["attachments"]["picture.png"]["image/png"]]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of the kernel's own libraries
@pytest.mark.parametrize("name", NOTEBOOKS)
def test_it_runs_from_top_to_bottom(name, pytestconfig, monkeypatch):
    monkeypatch.setattr(sys, "path", [str(FOLDER), *sys.path])
    from store import execute

    cache = pytestconfig.cache.mkdir("jax")
    notebook = execute(name, JAX_COMPILATION_CACHE_DIR=os.environ.get("JAX_COMPILATION_CACHE_DIR", str(cache)))
    assert printed(notebook) == printed(read(name)), STALE
