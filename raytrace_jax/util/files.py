"""Files that are either whole or absent: written beside the target and renamed, and read with clear errors."""

import contextlib
import difflib
import errno
import json
import math
import os
import secrets
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from ..errors import RaytraceError

StrPath = str | os.PathLike[str]
"""The name of a file."""


def as_path(name: StrPath, error: type[RaytraceError] = RaytraceError) -> Path:
    """The path that a name stands for. Raises `error` of what is no name, as a number or an array."""
    try:
        return Path(name)
    except TypeError:
        raise error(f"the name of a file is wanted, and this is of the type {type(name).__name__}.") from None


@contextlib.contextmanager
def atomic_write(path: StrPath, *, error: type[RaytraceError] = RaytraceError) -> Iterator[Path]:
    """Yield a temporary path in the folder of `path`; on success it is renamed onto `path`, else removed.

    Missing folders are made, a symbolic link is followed. The temporary name `.NAME.part-XXXXXXXX.SUFFIX` keeps the
    suffix, by which some libraries choose the format. Every OSError in the body is a failure to write `path`.

    Raises:
        error: the folder cannot be made or written, `path` is not an ordinary file, the disk is full.
    """
    target = Path(os.path.realpath(as_path(path, error)))
    # The file is not made here: one from `tempfile` would be readable by its owner only.
    temporary = target.parent / f".{target.name}.part-{secrets.token_hex(4)}{target.suffix}"
    try:
        if target.is_dir():
            raise error(f"{path}: cannot be written: it is a folder, and the name of a file is wanted")
        if target.exists() and not target.is_file():
            # Renaming onto /dev/null would replace the device itself.
            raise error(f"{path}: cannot be written: it is a device or a pipe, and an ordinary file is wanted")
        target.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(target)
    except OSError as cause:
        raise error(f"{path}: cannot be written: {write_failure(cause, target.parent)}") from cause
    finally:
        # After the rename nothing is left to remove; a failure to clean up must not hide the first error.
        with contextlib.suppress(OSError):
            temporary.unlink()


def write_text(path: StrPath, text: str) -> None:
    """Write a text as `atomic_write`; the names of files in it may have what UTF-8 lacks, which is escaped."""
    with atomic_write(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def read_bytes(path: StrPath, *, count: int = -1, error: type[RaytraceError] = RaytraceError) -> bytes:
    """Return the first `count` bytes of a file (-1: all of them).

    Raises:
        error: the file is missing (close matches in its folder are named), is a folder or cannot be read.
    """
    path = as_path(path, error)
    try:
        with path.open("rb") as file:
            return file.read(count)
    except FileNotFoundError as cause:
        raise error(f"{path}: there is no such file{_close_matches(path)}") from cause
    except IsADirectoryError as cause:
        raise error(f"{path}: is a folder, and a file is wanted") from cause
    except OSError as cause:
        raise error(f"{path}: cannot be read: {cause.strerror}") from cause


def read_toml(path: Path, error: type[RaytraceError] = RaytraceError) -> dict[str, Any]:
    """The contents of a TOML file. Raises RaytraceError as `read_bytes`, and `error` if it is not TOML."""
    try:
        return tomllib.loads(read_bytes(path).decode("utf-8-sig"))
    except UnicodeDecodeError as reason:
        raise error(f"{path}: is not TOML: byte {reason.start} is not UTF-8.") from None
    except tomllib.TOMLDecodeError as reason:
        raise error(f"{path}: is not TOML: {reason}.") from None


def write_failure(cause: OSError, folder: Path) -> str:
    """Why nothing could be written into a folder, as the end of a sentence."""
    words = {
        **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), f"the folder {folder} is not writable"),
        **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "the disk is full"),
        errno.ENOENT: f"no folder can be made in {folder}",
        **dict.fromkeys((errno.EEXIST, errno.ENOTDIR), f"{folder} is not a folder"),
    }
    return words.get(cause.errno or 0) or cause.strerror or str(cause)


def _close_matches(path: Path) -> str:
    if not path.parent.is_dir():
        return f" (nor the folder {path.parent})"
    names = (other.name for other in path.parent.iterdir())
    matches = difflib.get_close_matches(path.name, names, cutoff=0.8)
    return f"; did you mean {' or '.join(matches)}?" if matches else ""


def json_text(value: object) -> str:
    """The JSON text of a value, as `strict` has it, with a line end."""
    return json.dumps(strict(value), indent=2, allow_nan=False) + "\n"


def strict(value: object, nulls: bool = True) -> object:
    """Plain Python values: arrays are lists, paths are texts. JSON has no NaN and Infinity: `nulls` makes them None.

    Raises:
        RaytraceError: there is something that JSON cannot hold.
    """
    if isinstance(value, Mapping):
        return {key: strict(entry, nulls) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [strict(entry, nulls) for entry in value]
    if isinstance(value, Path):
        return str(value)
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) and (nulls or math.isfinite(value)):
        return value if math.isfinite(value) else None
    # An array of NumPy or JAX, neither of which the help of commands waits for.
    as_array = getattr(value, "__array__", None)
    if as_array is None:
        raise RaytraceError(f"JSON cannot hold {value!r}.")
    return strict(as_array().tolist(), nulls)
