"""Options of a command from a TOML file: `--config FILE.toml`."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path

from raytrace_jax.cli.commands import COMMANDS
from raytrace_jax.cli.console import UsageError
from raytrace_jax.cli.options.shared import option_names
from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.files import read_bytes
from raytrace_jax.util.words import did_you_mean, listed

OPTION = "--config"

ALIASES = {"define": ("-D",), "output": ("-o",)}
"""Options that have a short name."""


def with_config(arguments: Sequence[str]) -> list[str]:
    """The arguments with those of the file that `--config` names, if it is there; what is given twice is the caller's.

    A key of the file is an option without its dashes: `max-steps = 80`, `free = ["glass.ior"]`, `search = false` for
    `--no-search`, `size = [320, 240]`. A table gives `NAME=VALUE` to an option: `[define]` with `"glass.ior" = 1.5`.

    Raises:
        UsageError: the option has no file, comes twice, or the file has a key that is no option of the command, or a
            value that no option can be.
        RaytraceError: the file cannot be read, or is no TOML.
    """
    given = [place for place, argument in enumerate(arguments) if argument == OPTION]
    if not given:
        return list(arguments)
    place = given[0]
    if len(given) > 1 or place + 1 == len(arguments):
        raise UsageError(f"{OPTION} takes one file, once.")
    path = Path(arguments[place + 1])
    others = [*arguments[:place], *arguments[place + 2 :]]
    known = [*option_names(COMMANDS[others[0]].options)] if others and others[0] in COMMANDS else None
    table = _read(path)
    for key in table:
        if known and key.replace("-", "_") not in known:
            there = f"{did_you_mean(key, known)} There are {listed(known)}."
            raise UsageError(f"{path}: {key}: {others[0]} has no such option.{there}")
    return others + [text for key, value in table.items() for text in _spelled(path, key, value, others)]


def with_file(message: str, arguments: Sequence[str]) -> str:
    """The refusal of an option with the file that it comes from, if it is not among the arguments themselves."""
    typed = [argument.partition("=")[0] for argument in arguments]
    if OPTION not in typed or message.split()[0] in typed:
        return message
    return f"{arguments[typed.index(OPTION) + 1]}: {message}"


def _read(path: Path) -> Mapping[str, object]:
    try:
        return tomllib.loads(read_bytes(path).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as reason:
        raise RaytraceError(f"{path}: this is no TOML: {reason}.") from None


def _spelled(path: Path, key: str, value: object, others: Sequence[str]) -> list[str]:
    """An entry of the file as arguments; none if the option is among the others."""
    name = key.replace("_", "-")
    option = f"--{name}"
    spellings = (option, f"--no-{name}", *ALIASES.get(name, ()))
    if any(argument.partition("=")[0] in spellings for argument in others) or (name == "define" and _has_glued(others)):
        return []
    if isinstance(value, bool):
        return [option if value else f"--no-{name}"]
    if isinstance(value, Mapping):
        return [text for k, v in value.items() for text in (option, f"{k}={_text(path, key, v)}")]
    return [option, *(_one(path, key, entry) for entry in (value if isinstance(value, list) else [value]))]


def _has_glued(arguments: Sequence[str]) -> bool:
    """Whether there is a `-Dname=value` without a space."""
    return any(argument.startswith("-D") and "=" in argument for argument in arguments)


def _text(path: Path, key: str, value: object) -> str:
    """A value of a table: numbers of a vector go with commas between them."""
    return ",".join(_one(path, key, entry) for entry in (value if isinstance(value, list) else [value]))


def _one(path: Path, key: str, value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int, float)):
        raise UsageError(f"{path}: {key} is {value!r}; an option takes texts and numbers, or a row of them.")
    return value if isinstance(value, str) else repr(value)
