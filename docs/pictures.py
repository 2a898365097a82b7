"""Make the pictures of the gallery again: run the commands that stand under them.

    python docs/pictures.py [NAME ...]      # as model_classic.png; all without names, which takes half an hour

`docs/gallery.md` has each picture and, below it, what makes it. The scenes that it names are those of `docs/models.md`.
"""

import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).resolve().parent
ROOT = DOCS.parent
SCENE = re.compile(r"^```\n(# (\w+\.txt):.*?)^```$", re.MULTILINE | re.DOTALL)
ENTRY = re.compile(r"^!\[[^\]]*\]\(images/([\w.]+)\)\n\n```(sh|python)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
SHEETS = ("gallery.png", "report.png", "located.png")
"""What commands call the picture of a folder."""


def scenes() -> dict[str, str]:
    """The scenes of the page on models, by the names of their files."""
    return {name: text for text, name in SCENE.findall((DOCS / "models.md").read_text(encoding="utf-8"))}


def entries() -> dict[str, tuple[str, str]]:
    """The gallery: for each picture the language and the text of what makes it."""
    page = (DOCS / "gallery.md").read_text(encoding="utf-8")
    return {name: (language, text) for name, language, text in ENTRY.findall(page)}


def prepare(folder: Path) -> None:
    """Lay out in a folder what commands of the gallery find in a checkout, and the scenes of the page."""
    for name in ("data", "experiments"):
        (folder / name).symlink_to(ROOT / name)
    for name, text in scenes().items():
        (folder / name).write_text(text, encoding="utf-8")


def environment() -> dict[str, str]:
    """What commands and programs find the package and `raytrace-jax` by: those of this checkout and this Python."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return os.environ | {"PATH": path, "PYTHONPATH": str(ROOT)}


def make(name: str, language: str, text: str, folder: Path) -> Path:
    """Run what makes a picture in a prepared folder, and return the file that it wrote."""
    program = [sys.executable, "-"] if language == "python" else ["bash", "-e"]
    subprocess.run(program, input=text, cwd=folder, env=environment(), text=True, check=True)
    places = [folder / name, *(folder / Path(name).stem / sheet for sheet in SHEETS)]
    return next(place for place in places if place.is_file())


def main(names: list[str]) -> None:
    """Make these pictures, or all."""
    for name, (language, text) in entries().items():
        if names and name not in names:
            continue
        with tempfile.TemporaryDirectory() as folder:
            prepare(Path(folder))
            shutil.copyfile(make(name, language, text, Path(folder)), DOCS / "images" / name)
        print(f"docs/images/{name}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
