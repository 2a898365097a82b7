"""What comes before the work: reading the scene, and refusing at once what could not be rendered or written."""

import dataclasses
import os
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..errors import ParameterError, RaytraceError
from ..scene.bundled import scene_folder
from ..scene.checks import scene_warnings
from ..scene.parameters import parse_assignment, scalar_names, set_parameters, shared_with, with_response
from ..scene.reader import load_scene, parse_scene
from ..scene.scene import Scene
from ..scene.setting_words import ModelName
from ..tracer.indistinct import indistinct_glass
from ..tracer.settings import ResolvedSettings, resolve_settings
from ..util.files import write_failure
from ..util.text import listed
from .console import UsageError, blamed_on, print_warning, stderr_console
from .options import PictureCommand
from .options.scenes import View


def read_scene(path: Path | str, assignments: Sequence[str], model: ModelName | None) -> Scene:
    """Load a scene and set the parameters of `name=value` texts, saying on stderr what else they change.

    A text in place of a path is that of a file, whose pictures lie with the scenes that come with the package.
    """
    if isinstance(path, str):
        scene = parse_scene(path, model=model, folder=scene_folder())
    else:
        scene = load_scene(path, model=model)
    values = {}
    for name, numbers in map(parse_assignment, assignments):
        if name in values:
            raise ParameterError(f"-D {name} is given twice.")
        values[name] = numbers
    scene = with_response(scene, values)
    warn_of_shared_materials(scene, tuple(values))
    return set_parameters(scene, values)


def read_picture_scene(
    command: PictureCommand | View, path: Path | str = "", all_cameras: bool = False, **changes: Any
) -> tuple[Scene, ResolvedSettings]:
    """A command's scene, or another one, as `read_scene`; and the settings of its picture, with some `changes`.

    What the command leaves open the scene's file says. What is odd about the scene is said on stderr, and a window
    beside its picture is refused. The scene is that of the command's camera; which one it is without that is said on
    stderr, unless the command is for `all_cameras`.
    """
    settings = dataclasses.replace(command.render, **changes)
    scene = read_scene(path or command.scene, command.assignments, settings.model)
    if command.camera is not None:
        with blamed_on("--camera"):
            scene = scene.seen_by(command.camera)
    elif scene.further_views and not all_cameras:
        told = f"the picture is that of {scene.camera.name}; --camera NAME takes another one"
        stderr_console(command.quiet).print(f"cameras {listed(scene.cameras)}: {told}")
    with blamed_on():
        resolved = resolve_settings(scene, settings)
        for name in scene.cameras if all_cameras else scene.cameras[:1]:
            resolved.window(scene.seen_by(name).camera.pixeldim)
    indistinct = indistinct_glass(scene) if resolved.model == "physical" else []
    for sentence in scene_warnings(scene, resolved.model) + indistinct:
        print_warning(sentence)
    return scene, resolved


def warn_of_shared_materials(scene: Scene, names: Sequence[str]) -> None:
    """Say on stderr which other shapes change too when shapes' names reach a material that they share."""
    for name in names:
        if others := shared_with(scene, name):
            verb = "has" if len(others) == 1 else "have"
            print_warning(f"{name} belongs to a material that {listed(others)} {verb} too: it changes for all of them.")


def check_single(scene: Scene, name: str, option: str) -> None:
    """Raise UsageError where a name that an option takes means several numbers."""
    numbers = scalar_names(scene, [name])
    if numbers != (name,):
        raise UsageError(f"{option}: {name} is a vector; take one of its numbers: {', '.join(numbers)}.")


def check_picture_path(path: Path, suffixes: tuple[str, ...] = (".exr", ".png"), what: str = "a picture") -> None:
    """Refuse the path of a picture, or of `what` else it is, that has a wrong suffix or cannot be written."""
    check_file(path)
    if path.suffix.lower() not in suffixes:
        wanted = " or ".join(suffixes)
        raise UsageError(f"{path}: {what}'s name ends in {wanted}, not in {path.suffix or 'neither'!r}.")


def check_file(path: Path) -> None:
    """Raise RaytraceError where a file cannot be written: it is a folder, or its own folder is not there."""
    if path.is_dir():
        raise RaytraceError(f"{path}: cannot be written: it is a folder, and the name of a file is wanted.")
    check_folder(path.parent)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, or could not be made.

    It is tried, since not every folder that a user may write takes files (/proc, a full disk); nothing is left behind.
    """
    existing = folder.absolute()
    # lexists: a broken link is there, although what it points to is not.
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise RaytraceError(f"{folder}: cannot be written: {existing} is not a folder.")
    try:
        with tempfile.TemporaryDirectory(prefix=".raytrace-jax-", dir=existing):
            pass
    except OSError as cause:
        raise RaytraceError(f"{folder}: cannot be written: {write_failure(cause, existing)}.") from None
