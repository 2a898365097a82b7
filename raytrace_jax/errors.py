"""The errors that the user can mend: they carry a full sentence and never need a traceback."""

import contextlib
from collections.abc import Callable, Iterator


class RaytraceError(Exception):
    """Base of all errors that the command line prints as one message (exit code 1)."""


class RaytraceWarning(UserWarning):
    """What is read, rendered or fitted, but hardly as it is meant; a file's message starts with its name."""


class ModelFileError(RaytraceError):
    """A `model.txt` that cannot be read; the message starts with `file:line:column:`."""


class SceneError(RaytraceError):
    """Blocks described in Python that make no scene; the message names the block."""


class SettingsError(RaytraceError, ValueError):
    """A setting that a picture cannot have, or an argument that a formula cannot; the message begins with its name."""


class PictureError(RaytraceError):
    """A picture file that cannot be read or written, or does not fit the scene."""


class ParameterError(RaytraceError):
    """An unknown parameter name or a value that it cannot take."""


@contextlib.contextmanager
def reworded(
    reword: Callable[[str], Exception], kinds: type[RaytraceError] | tuple[type[RaytraceError], ...] = RaytraceError
) -> Iterator[None]:
    """Raise what `reword` makes of its message in place of an error of these kinds."""
    try:
        yield
    except kinds as reason:
        raise reword(str(reason)) from None


def one_sentence(error: Exception) -> str:
    """Any error as one message: what the user can mend as it is, the unexpected with its type."""
    # XLA reports its own failed allocations as a general error of the run time.
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error):
        return "out of memory: a smaller size, a crop, fewer samples or precision 32 need less."
    if isinstance(error, (RaytraceError, OSError)):
        return str(error)
    first_line = (str(error).strip().splitlines() or [""])[0]
    return f"{type(error).__name__}: {first_line}"
