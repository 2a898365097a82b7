"""Whether the results can be written, asked before the work and not after it."""

import os
from pathlib import Path

from raytrace_jax.cli.errors import UsageError
from raytrace_jax.errors import RaytraceError


def check_picture_path(path: Path, suffixes: tuple[str, str] = (".exr", ".png")) -> None:
    """Refuse a picture's path that has a wrong suffix or cannot be written.

    Raises:
        UsageError: the suffix is none of `suffixes`.
        RaytraceError: the path is a folder, or its folder cannot be written.
    """
    if path.suffix.lower() not in suffixes:
        wanted = " or ".join(suffixes)
        raise UsageError(f"{path}: a picture's name ends in {wanted}, not in {path.suffix or 'neither'!r}.")
    if path.is_dir():
        raise RaytraceError(f"{path}: cannot be written: it is a folder, and the name of a file is wanted.")
    check_folder(path.parent)


def check_folder(folder: Path) -> None:
    """Refuse a folder that cannot be written, or could not be made.

    Raises:
        RaytraceError: it, or its nearest folder that exists, is no folder or is not writable.
    """
    existing = folder.absolute()
    # lexists: a broken link is there, although what it points to is not.
    while not os.path.lexists(existing):
        existing = existing.parent
    if not existing.is_dir():
        raise RaytraceError(f"{folder}: cannot be written: {existing} is not a folder.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise RaytraceError(f"{folder}: cannot be written: the folder {existing} is not writable.")
