"""Run the teaching notebooks and store them with small outputs: `python experiments/teaching/store.py [NAME ...]`."""

import argparse
import base64
import hashlib
import io
import json
import os
import time
from pathlib import Path

import nbclient
import nbformat
from nbformat import NotebookNode
from PIL import Image

FOLDER = Path(__file__).resolve().parent
ROOT = FOLDER.parents[1]
PICTURE = "picture"
"""The tag of the cell whose picture the notebook begins with."""

COLOURS = 128
PNG = "image/png"


def main() -> None:
    """Run and store the notebooks that the command line names, or all."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help="such as 1_snell.ipynb; all if none is given")
    names = parser.parse_args().names or sorted(path.name for path in FOLDER.glob("*.ipynb"))
    for name in names:
        began = time.monotonic()
        notebook = execute(name)
        store(notebook, FOLDER / name)
        size = (FOLDER / name).stat().st_size
        print(f"{name}: {size / 1000:.0f} kB, {time.monotonic() - began:.0f} s", flush=True)


def execute(name: str, **environment: str) -> NotebookNode:
    """The notebook with the outputs of a run from top to bottom."""
    notebook = nbformat.read(FOLDER / name, as_version=4)
    client = nbclient.NotebookClient(
        notebook,
        timeout=600,
        kernel_name="python3",
        record_timing=False,
        resources={"metadata": {"path": str(FOLDER)}},
    )
    given = {"PYTHONPATH": str(ROOT), "MPLBACKEND": "module://matplotlib_inline.backend_inline", **environment}
    client.execute(env={**os.environ, **given})
    return notebook


def store(notebook: NotebookNode, path: Path) -> None:
    """Write the notebook without what belongs to this run, its pictures small."""
    for cell in code_cells(notebook):
        cell.outputs = [small(output) for output in joined(cell.outputs) if kept(output)]
    begin_with_picture(notebook)
    notebook.metadata = NotebookNode(
        kernelspec={"display_name": "Python 3", "language": "python", "name": "python3"},
        language_info={"name": "python"},
        sources=sources_hash(notebook),
    )
    nbformat.write(notebook, path)


def code_cells(notebook: dict) -> list:
    """The notebook's cells of code."""
    return [cell for cell in notebook["cells"] if cell["cell_type"] == "code"]


def sources_hash(notebook: dict) -> str:
    """The hash of the notebook's code, by which a test sees that outputs are older than it."""
    sources = ["".join(cell["source"]) for cell in code_cells(notebook)]
    return hashlib.sha256(json.dumps(sources).encode()).hexdigest()


def joined(outputs: list[NotebookNode]) -> list[NotebookNode]:
    """The outputs, with what was printed at once in one: how it arrives in pieces is a matter of time."""
    whole = []
    for output in outputs:
        if whole and output.output_type == "stream" and output.get("name") == whole[-1].get("name"):
            whole[-1].text += output.text
        else:
            whole.append(output)
    return whole


def kept(output: NotebookNode) -> bool:
    """Whether an output is the program's: what libraries complain of names paths of this machine."""
    return output.get("name") != "stderr"


def small(output: NotebookNode) -> NotebookNode:
    """The output with its picture in a palette, and without the words that stand for the picture."""
    data = output.get("data", {})
    if PNG in data:
        output.data = {PNG: in_palette(data[PNG])}
        output.metadata = {}
    return output


def in_palette(picture: str) -> str:
    """A PNG file in base 64, with few colours."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    written = io.BytesIO()
    image.quantize(COLOURS, dither=Image.Dither.NONE).save(written, "png", optimize=True)
    return base64.b64encode(written.getvalue()).decode()


def begin_with_picture(notebook: NotebookNode) -> None:
    """Attach the picture that the tagged cell draws to the first cell, which shows it beside the question."""
    (tagged,) = (cell for cell in code_cells(notebook) if PICTURE in cell.metadata.get("tags", []))
    (picture,) = (output.data[PNG] for output in tagged.outputs if PNG in output.get("data", {}))
    notebook.cells[0]["attachments"] = {f"{PICTURE}.png": {PNG: picture}}


if __name__ == "__main__":
    main()
