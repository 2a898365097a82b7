"""The help of every command, read as a user reads it: in the lines of a terminal of 100 columns."""

import dataclasses
import inspect
import re
from typing import get_args, get_type_hints

import pytest
from command_line import run
from tyro.conf import Positional, Suppress

import raytrace_jax
from raytrace_jax.cli import options as shared
from raytrace_jax.cli.dispatch import COMMANDS
from raytrace_jax.cli.options import fits, scenes

OF_TOOLS = (
    r"pyright|type:|noqa|ruff|TODO|options options|\braytrace_jax\b|`[A-Z]\w*`|\[/?bold\]|\(default: (None|'')?\)"
)
"""What is written for tools and developers: their marks, module paths, classes, what tyro says of no default."""
OF_TYPES = {"STR", "PATH", "INT", "FLOAT", "BOOL", "VALUE", "NAME=VALUE", "None"}
"""What tyro calls values by their types, and what says no more."""
CLASSES = {name for module in (shared, fits, scenes) for name, _ in inspect.getmembers(module, inspect.isclass)}


@pytest.fixture
def help_of(capsys, monkeypatch):
    """The lines of a command's help."""

    def read(*name):
        monkeypatch.setenv("COLUMNS", "100")
        assert run(*name, "--help") == 0
        return capsys.readouterr().out.splitlines()

    return read


def entries(lines):
    """The spellings of each option and positional argument in a help's boxes, and its words."""
    lines = [line.replace("│", " ").rstrip() for line in lines]
    first = next(number for number, line in enumerate(lines) if line.startswith("  -h, --help"))
    column = lines[first].index("show this help")
    found, last = {}, ""
    for number, line in enumerate(lines):
        if re.match(r"  -{1,2}[a-zA-Z]", line) or (number < first and re.match("  [a-zA-Z]", line)):
            # A long spelling has a line of its own.
            end = column if line[column - 2 : column].isspace() else None
            last = line[:end].strip()
            found[last] = line[column:] if end else ""
        elif line[:column].isspace() and found:
            found[last] += " " + line[column:]
        elif not line.strip():
            last = ""
    return {spelled: " ".join(words.split()) for spelled, words in found.items()}


def option_names(options):
    """The options of a command, as `max_steps`, those of its parts included; its positional arguments are none."""
    hints = get_type_hints(options, include_extras=True)
    marks = {get_args(Positional[int])[1], get_args(Suppress[int])[1]}
    for field in dataclasses.fields(options):
        if dataclasses.is_dataclass(field.default):
            yield from option_names(type(field.default))
        elif not marks.intersection(getattr(hints[field.name], "__metadata__", ())):
            yield {"assignments": "define", "liquid": "in"}.get(field.name, field.name)


@pytest.mark.parametrize("name", ["", *COMMANDS])
def test_no_word_is_for_tools(name, help_of):
    lines = help_of(*name.split())
    text = "\n".join(lines)
    assert not re.search(OF_TOOLS, text), re.findall(OF_TOOLS, text)
    assert not CLASSES & set(re.findall(r"\b[A-Z][a-z]+[A-Z]\w+", text))
    assert all(len(line) <= 100 or line.startswith(("usage:", "Example: ")) for line in lines)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_option_has_its_own_words(name, help_of):
    told = entries(help_of(name))
    spellings = [spelling for spelled in told for spelling in spelled.split(", ")]
    options = {spelling.split()[0]: spelling.split()[1:] for spelling in spellings}
    assert {f"--{option.replace('_', '-')}" for option in option_names(COMMANDS[name].options)} <= set(options)
    for option, wanted in options.items():
        is_switch = option in ("-h", "--help") or f"--no-{option[2:]}" in options or option.startswith("--no-")
        assert is_switch or not option.startswith("-") or wanted, option
        assert option in ("-D", "--define") or not OF_TYPES & set(wanted), (option, wanted)
    del told["-h, --help"]
    for spelled, words in told.items():
        # A sentence, or what each choice means; then once what holds without the option.
        assert re.fullmatch(r"([A-Z]|\w+: )[^(].*\.( \([^()]+\))?", words), (spelled, words)
        assert "required" not in re.sub(r"\([^()]+\)$", "", words), (spelled, words)
    assert len(set(told.values())) == len(told)


def test_help_says_what_is_required(help_of):
    fit, grad, calibrate = (entries(help_of(name)) for name in ("fit", "grad", "calibrate"))
    assert fit["--free NAME ..."].endswith(". (required, repeatable)")
    assert grad["--wrt NAME ..."].endswith(". (required, repeatable)")
    for option in ("--tie NAME=FREE", "--prior NAME=MEAN+-SD", "--uncertain NAME=SD", "--profile NAME ..."):
        assert fit[option].endswith(". (repeatable)")
    assert "three or more" in calibrate["PHOTO ..."] and calibrate["PHOTO ..."].endswith("(required)")


def test_the_program_lists_its_commands(help_of, capsys):
    text = " ".join(help_of())
    assert all(word in text for word in (*COMMANDS, "--version", "Exit codes"))
    assert all("Example: raytrace-jax " in "\n".join(help_of(name)) for name in COMMANDS)
    assert run("--version") == 0
    assert capsys.readouterr().out.startswith(f"raytrace-jax {raytrace_jax.__version__}\n")
