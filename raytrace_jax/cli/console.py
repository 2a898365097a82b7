"""Errors and messages on stderr, tables on stdout."""

from collections.abc import Sequence
from contextlib import AbstractContextManager
from contextvars import ContextVar

from rich.console import Console
from rich.text import Text

from ..errors import ParameterError, SettingsError, reworded
from ..util.text import aligned

TYPED: ContextVar[tuple[str, ...]] = ContextVar("typed", default=())
"""The arguments of the command that runs, as they were typed, for reports."""


class UsageError(Exception):
    """Options that parse but make no sense, alone or together (exit code 2)."""


def blamed_on(options: str = "") -> AbstractContextManager[None]:
    """Make a refusal within the error of these options; without them, of the option whose name it begins with."""

    def by_its_name(words: str) -> UsageError:
        name, space, rest = words.partition(" ")
        return UsageError(f"--{name.replace('_', '-')}{space}{rest}")

    if options:
        return reworded(lambda words: UsageError(f"{options}: {words}"))
    return reworded(by_its_name, (SettingsError, ParameterError))


_CONSOLES = {
    quiet: Console(stderr=True, markup=False, highlight=False, soft_wrap=True, quiet=quiet) for quiet in (False, True)
}


def stderr_console(quiet: bool = False) -> Console:
    """The console on the stderr of this moment; it takes text as it is, without markup or colouring of its own.

    It is the same each time: what it prints lies above what it shows and overwrites.
    """
    return _CONSOLES[quiet]


def print_error(message: str) -> None:
    """Print an error to stderr, in colour on a terminal."""
    stderr_console().print(Text.assemble(("error: ", "bold red"), message))


def print_warning(message: str) -> None:
    """Print a warning to stderr, in colour on a terminal."""
    stderr_console().print(Text.assemble(("warning: ", "bold yellow"), message))


def show_warning(message: Warning | str, category: type[Warning], *where: object, **more: object) -> None:
    """A `warnings.showwarning` that prints the sentence alone, without the place in the source."""
    print_warning(str(message))


def print_table(title: str, headers: Sequence[str], rows: Sequence[Sequence[str]]) -> None:
    """Print a table on stdout in plain aligned columns, nothing cut."""
    print(f"# {title}", *aligned([headers, *rows]), sep="\n")
