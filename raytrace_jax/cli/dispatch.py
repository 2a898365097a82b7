"""The commands, and the way from arguments to an exit code.

Exit codes: 0 fine, 1 run time or file error, 2 usage, 3 fit not converged, 130 stopped.
"""

import argparse
import contextlib
import importlib
import inspect
import io
import os
import re
import shutil
import sys
import textwrap
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple, Union

import tyro

from ..errors import ParameterError, RaytraceError, one_sentence
from ..scene.bundled import no_such_scene, scene_path
from ..util.files import read_bytes, read_toml
from ..util.text import did_you_mean, listed, quoted
from .console import UsageError, print_error, show_warning
from .options import fits, scenes


class Entry(NamedTuple):
    """A command's options, and the module of `cli.actions` whose function `run_COMMAND` takes them.

    Options do not import JAX, so that `--help` answers at once; only the module of the command in hand is imported.
    """

    options: type
    module: str
    devices: int | None = None  # Of JAX; None is one for each core.


COMMANDS = {
    "render": Entry(scenes.Render, "scenes"),
    "grad": Entry(scenes.Grad, "pictures"),
    "fit": Entry(fits.Fit, "fit"),
    "gallery": Entry(scenes.Gallery, "pictures"),
    "rays": Entry(scenes.Rays, "explain"),
    "sweep": Entry(scenes.Sweep, "pictures"),
    # One core a job: its numbers, to the last bit, do not depend on how many cores there are.
    "batch": Entry(fits.Batch, "batch", devices=1),
    "view": Entry(scenes.View, "explain"),
    "board": Entry(fits.Board, "board"),
    "calibrate": Entry(fits.Calibrate, "photo"),
    "photo": Entry(fits.Photo, "photo"),
    "teach": Entry(scenes.Teach, "explain"),
    "glass": Entry(scenes.Glass, "glass"),
    "export": Entry(scenes.Export, "scenes"),
    "import": Entry(scenes.Import, "scenes"),
    "new": Entry(scenes.New, "scenes"),
    "format": Entry(scenes.Format, "scenes"),
    "info": Entry(scenes.Info, "scenes"),
    "scenes": Entry(scenes.Scenes, "scenes"),
}
"""Commands by the names that users type, in the order of the help text."""


def with_config(arguments: Sequence[str]) -> list[str]:
    """The arguments with those of the file that `--config` names, if it is there; what is given twice is the caller's.

    A key of the file is an option without its dashes: `max-steps = 80`, `free = ["glass.ior"]`, `search = false` for
    `--no-search`, `size = [320, 240]`. A table gives `NAME=VALUE` to an option: `[define]` with `"glass.ior" = 1.5`.
    """
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--config", nargs="?", action="append", type=Path, default=[])
    given, others = parser.parse_known_args(arguments)
    if not given.config:
        return others
    if len(given.config) > 1 or None in given.config:
        raise UsageError("--config takes one file, once.")
    options = []
    for key, value in read_toml(given.config[0]).items():
        name = key.replace("_", "-")
        spellings, short = (f"--{name}", f"--no-{name}"), {"define": ("-D",), "output": ("-o",)}.get(name, ())
        if any(word.partition("=")[0] in spellings or word.startswith(short) for word in others):
            continue
        if isinstance(value, dict):
            texts = [f"{k}={','.join(_texts(v))}" for k, v in value.items()]
        else:
            texts = [] if isinstance(value, bool) else _texts(value)
        options += [f"--no-{name}" if value is False else f"--{name}", *texts]
    return others + options


def _texts(value: object) -> list[str]:
    return [str(entry) for entry in value] if isinstance(value, list) else [str(value)]


DESCRIPTION = """A differentiable Whitted ray tracer that reads the index of refraction off a picture.

Results go to stdout, progress and warnings to stderr. Exit codes: 0 fine, 1 an error on the way or in a file, 2 wrong
usage, 3 the fit is not `converged`. `raytrace-jax COMMAND --help` explains a command, `raytrace-jax --version` says
which version this is. `--config FILE.toml` takes options of a command from a file: its keys are their names."""

EXAMPLE = "Example:"
"""What the line of an example begins with; it is one command, to be copied, and stays in one line."""

FAILED, USAGE, INTERRUPTED = 1, 2, 130


def run(arguments: Sequence[str]) -> int:
    """Run the command that the arguments spell and return its exit code.

    No exception leaves this function; `RAYTRACE_JAX_TRACEBACK=1` in the environment shows tracebacks.
    """
    if sys.stdout is None:  # Python's, where the process was started without one.
        print_error("stdout is closed, and results are printed there: send it elsewhere, as by >/dev/null.")
        return FAILED
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # A file name may have characters that its encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    try:
        code = _run(arguments)
        sys.stdout.flush()  # Here, so that a closed pipe is noticed here.
        return code
    except KeyboardInterrupt:
        print_error("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        # Its reader, such as `head`, has had enough; what is still buffered must not fail at exit again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return FAILED
    except Exception as error:
        if os.environ.get("RAYTRACE_JAX_TRACEBACK"):
            traceback.print_exc()
        message = str(error) if isinstance(error, UsageError) else one_sentence(error)
        if message.startswith(f"{type(error).__name__}: "):
            message += " (set RAYTRACE_JAX_TRACEBACK=1 to see where this comes from)"
        print_error(message)
        return USAGE if isinstance(error, (UsageError, ParameterError)) else FAILED


class Paragraphs:
    """Stdout on which paragraphs are broken into the terminal's lines: tyro breaks those in its boxes only."""

    def __init__(self):
        self.stream = sys.stdout

    def write(self, text: str) -> int:
        width = shutil.get_terminal_size().columns

        def broken(line: str) -> str:
            if not line[:1].isalpha() or line.startswith(("usage:", EXAMPLE)):
                return line
            return textwrap.fill(line, width, break_on_hyphens=False, break_long_words=False)

        return self.stream.write("\n".join(map(broken, text.split("\n"))))

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def _run(arguments: Sequence[str]) -> int:
    first = arguments[0] if arguments else ""
    if first and not first.startswith("-") and first not in COMMANDS:
        suggestion = did_you_mean(first, COMMANDS)
        raise UsageError(f"there is no command {quoted(first)}.{suggestion} Commands: {listed(COMMANDS)}.")
    given = with_config(arguments)
    refusal = io.StringIO()
    shown: Any = Paragraphs() if {"-h", "--help"} & set(given) else sys.stdout
    try:
        with contextlib.redirect_stdout(shown), contextlib.redirect_stderr(refusal):
            command = tyro.cli(
                _commands(named=bool(given) and given[0] in COMMANDS),
                prog="raytrace-jax",
                description=_in_lines(DESCRIPTION),
                args=given,
                # What is not given is None, which no one has to say.
                config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
            )
    except SystemExit as stop:
        # tyro leaves its own markup in some sentences.
        text = re.sub(r"\[bold\](.*?)\[/bold\](.*)│", rf"\1\2{' ' * 13}│", refusal.getvalue())
        sys.stderr.write(text)
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else USAGE
    name, entry = next((name, entry) for name, entry in COMMANDS.items() if type(command) is entry.options)
    _check_files(command)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show_warning
        # Imported here, since most of a command's imports start with JAX: seconds that --help need not wait.
        from ..util.session import jax_session

        actions = importlib.import_module(f".actions.{entry.module}", __package__)
        with jax_session(command.render.precision if hasattr(command, "render") else 64, entry.devices):
            return getattr(actions, f"run_{name}")(command) or 0


def _commands(named: bool) -> Any:
    """The type of all commands for tyro; with their help texts cut to one line, if none of them is `named`."""
    members = []
    for name, entry in COMMANDS.items():
        text = inspect.getdoc(entry.options) or ""
        shown = tyro.conf.subcommand(name, description=_in_lines(text) if named else text.splitlines()[0])
        # Comments are not for users.
        members.append(tyro.conf.HelptextFromCommentsOff[Annotated[entry.options, shown]])
    return Union[tuple(members)]  # noqa: UP007


def _in_lines(text: str) -> str:
    """A help text with each paragraph, and each example, in one line: tyro leaves breaks before what is no letter."""
    return "\n\n".join(" ".join(part.split()) for part in re.split(rf"\n\n|\n(?={EXAMPLE})", text))


def _check_files(command: Any) -> None:
    for name, value in vars(command).items():
        for path in value if isinstance(value, tuple) else (value,):
            if isinstance(path, Path) and name == "scene" and not scene_path(path).exists():
                raise RaytraceError(no_such_scene(path))
            if isinstance(path, Path) and name not in ("scene", "output", "save") and not path.exists():
                read_bytes(path)  # It says which names are near.
