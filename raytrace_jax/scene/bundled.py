"""The scenes that come with the package, by their names."""

import os
from pathlib import Path

from ..errors import ModelFileError
from ..util.files import StrPath, as_path
from ..util.text import listed


def bundled_scenes() -> dict[str, Path]:
    """The files of the scenes that come with the package, by name, in alphabetical order."""
    return {path.stem: path for path in sorted(scene_folder().glob("*.txt"))}


def scene_folder() -> Path:
    """The folder of the bundled scenes: in the package where it was installed, in the folder `data` of a checkout."""
    package = Path(__file__).resolve().parents[1]
    folders = (package / "data", package.parent / "data")
    return next((folder for folder in folders if folder.is_dir()), folders[0])


def scene_path(path: StrPath) -> Path:
    """The file that a path means: its own file if it exists, else the bundled scene of that name."""
    given = as_path(path, ModelFileError)
    return given if os.path.lexists(given) else bundled_scenes().get(os.fspath(path), given)


def no_such_scene(path: StrPath) -> str:
    """The error of a path that is neither a file nor the name of a scene that comes with the package."""
    others = "" if Path(path).suffix else f", and no scene of that name, as there are {listed(bundled_scenes())}"
    return f"{path}: there is no such file{others}."
