"""From the arguments to an exit code: 0 fine, 1 run time or file error, 2 usage, 3 fit not converged, 130 stopped."""

import functools
import importlib
import inspect
import io
import operator
import os
import sys
import traceback
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro
from tyro.conf import subcommand

from raytrace_jax.cli.commands import COMMANDS
from raytrace_jax.cli.config_file import with_config, with_file
from raytrace_jax.cli.console import UsageError, print_error, show_warning
from raytrace_jax.errors import ParameterError, RaytraceError, one_sentence
from raytrace_jax.scene.bundled import no_such_scene, scene_path
from raytrace_jax.util.files import read_bytes, write_text
from raytrace_jax.util.words import did_you_mean, listed, quoted

DESCRIPTION = """A differentiable Whitted ray tracer that reads the index of refraction off a picture.

Results go to stdout, progress and warnings to stderr. Exit codes: 0 fine, 1 run time or file error, 2 wrong usage,
3 the fit is not `converged`. `raytrace-jax COMMAND --help` explains a command, `raytrace-jax --version` says which
version this is. `--config FILE.toml` takes options of a command from a file: its keys are their names."""

FAILED, USAGE, INTERRUPTED = 1, 2, 130


def run(arguments: Sequence[str]) -> int:
    """Run the command that the arguments spell and return its exit code.

    No exception leaves this function; `RAYTRACE_JAX_TRACEBACK=1` in the environment shows tracebacks.
    """
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):  # A file name may have characters that its encoding lacks.
            stream.reconfigure(errors="backslashreplace")
    first = arguments[0] if arguments else ""
    if first and not first.startswith("-") and first not in COMMANDS:
        suggestion = did_you_mean(first, COMMANDS)
        print_error(f"there is no command {quoted(first)}.{suggestion} Commands: {listed(COMMANDS)}.")
        return USAGE
    script = arguments[arguments.index(COMPLETION) + 1 :] if COMPLETION in arguments else ()
    if COMPLETION in arguments and (len(script) < 2 or script[0] not in SHELLS):
        print_error(f"{COMPLETION} takes a shell and a file: {', '.join(SHELLS)}, as {COMPLETION} bash FILE.")
        return USAGE
    try:
        gathered = _gathered(with_config(arguments))
    except (UsageError, RaytraceError) as error:
        print_error(_message(error))
        return USAGE if isinstance(error, UsageError) else FAILED
    try:
        command = tyro.cli(
            _union(named=bool(gathered) and gathered[0] in COMMANDS),
            prog="raytrace-jax",
            description=DESCRIPTION,
            args=gathered,
            # What is not given is None, which no one has to say.
            config=(tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone),
        )
    except SystemExit as stop:
        if stop.code is None and script:
            return _complete_files(Path(script[1]))
        return stop.code if isinstance(stop.code, int) else 0 if stop.code is None else USAGE
    except UsageError as error:
        print_error(with_file(str(error), arguments))
        return USAGE
    except BrokenPipeError:
        return _pipe_closed()
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show_warning
        return _guarded(command)


COMPLETION, SHELLS = "--tyro-write-completion", ("bash", "zsh", "fish")


def _complete_files(script: Path) -> int:
    """Let a completion that tyro wrote name files wherever no option or command is begun, folders with their slash."""
    text, end = script.read_text(encoding="utf-8"), "\n    return completions"
    begun = 'current_word.startswith("-") or current_spec.get("subcommands")'
    text = text.replace(f"{end}\n", f'{end} if {begun} else ["__TYRO_COMPLETE_FILES__"]\n')
    text = text.replace('compgen -f -- "$cur"', 'compgen -f -- "${COMP_WORDS[COMP_CWORD]}"')
    write_text(script, text.replace("complete -F ", "complete -o filenames -F "))
    return 0


def _union(named: bool) -> Any:
    """The type of all commands for tyro; with their help texts cut to one line, if none of them is `named`."""

    def member(name: str, options: type) -> Any:
        text = inspect.getdoc(options) or ""
        return Annotated[options, subcommand(name, description=text if named else text.splitlines()[0])]

    return functools.reduce(operator.or_, [member(name, entry.options) for name, entry in COMMANDS.items()])


ASSIGNED = ("--tie", "--prior", "--uncertain")
"""Options of `NAME=VALUE` texts that a mapping is made of."""

NAMED = ("--free", "--wrt", "--profile", "--aov", "--over", "--only", "--also")
"""Options of several words."""


def _gathered(arguments: Sequence[str]) -> list[str]:
    """The arguments with `-Dname=value` as `-D name=value`, and what comes several times gathered at the end.

    What follows a `NAME=VALUE` and looks like another is one, unless it is a file's name.

    Raises:
        UsageError: an option is without its value.
    """
    others, gathered, option, has_value = list[str](), dict[str, list[str]](), "", False
    for argument in arguments:
        is_another = has_value and "=" in argument and not Path(argument).exists()
        if argument.startswith("-D") and len(argument) > 2:
            others += ["-D", argument[2:]]
            option, has_value = "-D", True
        elif argument.startswith("-"):
            option, equals, value = argument.partition("=")
            has_value = bool(equals)
            if option in ASSIGNED + NAMED:
                gathered.setdefault(option, []).extend([value] * has_value)
            else:
                others.append(argument)
        elif (option in NAMED and not has_value) or (option in ASSIGNED and (is_another or not has_value)):
            gathered[option].append(argument)
            has_value = option in ASSIGNED
        elif option in ("-D", "--define") and is_another:
            others += [option, argument]
        else:
            others.append(argument)
            option, has_value = (option, True) if not has_value else ("", False)
    for option, values in gathered.items():
        if option in ASSIGNED and not values:
            raise UsageError(f"{option} is without its NAME=VALUE.")
        others += [option, *values]
    return others


def _guarded(command: Any) -> int:
    """Run a command; turn every exception into one message and an exit code."""
    try:
        code = _run(command)
        sys.stdout.flush()  # Here, so that a closed pipe is noticed here.
        return code
    except KeyboardInterrupt:
        print_error("interrupted")
        return INTERRUPTED
    except BrokenPipeError:
        return _pipe_closed()
    except Exception as error:
        if os.environ.get("RAYTRACE_JAX_TRACEBACK"):
            traceback.print_exc()
        print_error(_message(error))
        return USAGE if isinstance(error, (UsageError, ParameterError)) else FAILED


def _pipe_closed() -> int:
    """The reader of a pipe, such as `head`, has had enough; what is still buffered must not fail at exit again."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return FAILED


def _run(command: Any) -> int:
    entry = next(entry for entry in COMMANDS.values() if type(command) is entry.options)
    _check_files(command)
    # Imported here, since most of a command's imports start with JAX: seconds that --help need not wait.
    module = importlib.import_module(f"raytrace_jax.cli.actions.{entry.module}")
    return getattr(module, entry.function)(command)


def _check_files(command: Any) -> None:
    """Refuse files to read that are not there."""
    for name, value in vars(command).items():
        for path in value if isinstance(value, tuple) else (value,):
            if isinstance(path, Path) and name == "scene" and not scene_path(path).exists():
                raise RaytraceError(no_such_scene(path))
            if isinstance(path, Path) and name not in ("scene", "output") and not path.exists():
                read_bytes(path)  # It says which names are near.


def _message(error: Exception) -> str:
    if isinstance(error, UsageError):
        return str(error)
    message = one_sentence(error)
    if message.startswith(f"{type(error).__name__}: "):
        return f"{message} (set RAYTRACE_JAX_TRACEBACK=1 to see where this comes from)"
    return message
