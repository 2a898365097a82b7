"""Arguments become an exit code: 0 fine, 1 run time or file error, 2 usage, 3 fit not converged, 130 stopped."""

import functools
import importlib
import inspect
import io
import operator
import os
import sys
import tomllib
import traceback
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import tyro
from tyro.conf import subcommand

from raytrace_jax.cli.console import UsageError, print_error, show_warning
from raytrace_jax.cli.options import fits, option_names, scenes
from raytrace_jax.errors import ParameterError, RaytraceError, one_sentence
from raytrace_jax.scene.bundled import no_such_scene, scene_path
from raytrace_jax.util.files import read_bytes, write_text
from raytrace_jax.util.text import did_you_mean, listed, quoted


class Entry(NamedTuple):
    """A command's options, and the module of `cli.actions` whose function `run_COMMAND` takes them.

    Options do not import JAX, so that `--help` answers at once; only the module of the command in hand is imported.
    """

    options: type
    module: str


COMMANDS = {
    "render": Entry(scenes.Render, "render"),
    "grad": Entry(scenes.Grad, "pictures"),
    "fit": Entry(fits.Fit, "fit"),
    "gallery": Entry(scenes.Gallery, "pictures"),
    "rays": Entry(scenes.Rays, "explain"),
    "sweep": Entry(scenes.Sweep, "pictures"),
    "batch": Entry(fits.Batch, "batch"),
    "view": Entry(scenes.View, "explain"),
    "board": Entry(fits.Board, "board"),
    "calibrate": Entry(fits.Calibrate, "photo"),
    "photo": Entry(fits.Photo, "photo"),
    "teach": Entry(scenes.Teach, "explain"),
    "export": Entry(scenes.Export, "scenes"),
    "import": Entry(scenes.Import, "scenes"),
    "new": Entry(scenes.New, "scenes"),
    "format": Entry(scenes.Format, "scenes"),
    "info": Entry(scenes.Info, "scenes"),
    "scenes": Entry(scenes.Scenes, "scenes"),
}
"""Commands by the names that users type, in the order of the help text."""

CONFIG = "--config"

ALIASES = {"define": ("-D",), "output": ("-o",)}
"""Short names of options."""


def with_config(arguments: Sequence[str]) -> list[str]:
    """The arguments with those of the file that `--config` names, if it is there; what is given twice is the caller's.

    A key of the file is an option without its dashes: `max-steps = 80`, `free = ["glass.ior"]`, `search = false` for
    `--no-search`, `size = [320, 240]`. A table gives `NAME=VALUE` to an option: `[define]` with `"glass.ior" = 1.5`.
    """
    given = [place for place, argument in enumerate(arguments) if argument == CONFIG]
    if not given:
        return list(arguments)
    place = given[0]
    if len(given) > 1 or place + 1 == len(arguments):
        raise UsageError(f"{CONFIG} takes one file, once.")
    path = Path(arguments[place + 1])
    others = [*arguments[:place], *arguments[place + 2 :]]
    known = [*option_names(COMMANDS[others[0]].options)] if others and others[0] in COMMANDS else None
    try:
        table = tomllib.loads(read_bytes(path).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as reason:
        raise RaytraceError(f"{path}: this is no TOML: {reason}.") from None
    for key in table:
        if known and key.replace("-", "_") not in known:
            there = f"{did_you_mean(key, known)} There are {listed(known)}."
            raise UsageError(f"{path}: {key}: {others[0]} has no such option.{there}")
    return others + [text for key, value in table.items() for text in _spelled(path, key, value, others)]


def _spelled(path: Path, key: str, value: object, others: Sequence[str]) -> list[str]:
    """An entry of the file as arguments; none if the option is among the others."""
    name = key.replace("_", "-")
    option = f"--{name}"
    spellings = (option, f"--no-{name}", *ALIASES.get(name, ()))
    if any(argument.partition("=")[0] in spellings for argument in others):
        return []
    if name == "define" and any(argument.startswith("-D") and "=" in argument for argument in others):
        return []
    if isinstance(value, bool):
        return [option if value else f"--no-{name}"]
    if isinstance(value, Mapping):
        return [text for k, v in value.items() for text in (option, f"{k}={','.join(_texts(path, key, v))}")]
    return [option, *_texts(path, key, value)]


def _texts(path: Path, key: str, value: object) -> list[str]:
    """A text or number, or a row of them, as arguments."""
    texts = []
    for entry in value if isinstance(value, list) else [value]:
        if isinstance(entry, bool) or not isinstance(entry, (str, int, float)):
            raise UsageError(f"{path}: {key} is {entry!r}; an option takes texts and numbers, or a row of them.")
        texts.append(entry if isinstance(entry, str) else repr(entry))
    return texts


DESCRIPTION = """A differentiable Whitted ray tracer that reads the index of refraction off a picture.

Results go to stdout, progress and warnings to stderr. Exit codes: 0 fine, 1 run time or file error, 2 wrong usage,
3 the fit is not `converged`. `raytrace-jax COMMAND --help` explains a command, `raytrace-jax --version` says which
version this is. `--config FILE.toml` takes options of a command from a file: its keys are their names."""

FAILED, USAGE, INTERRUPTED = 1, 2, 130
COMPLETION, SHELLS = "--tyro-write-completion", ("bash", "zsh", "fish")


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
        message = one_sentence(error)
        if message.startswith(f"{type(error).__name__}: "):
            message += " (set RAYTRACE_JAX_TRACEBACK=1 to see where this comes from)"
        print_error(str(error) if isinstance(error, UsageError) else message)
        return USAGE if isinstance(error, (UsageError, ParameterError)) else FAILED


def _run(arguments: Sequence[str]) -> int:
    first = arguments[0] if arguments else ""
    if first and not first.startswith("-") and first not in COMMANDS:
        suggestion = did_you_mean(first, COMMANDS)
        raise UsageError(f"there is no command {quoted(first)}.{suggestion} Commands: {listed(COMMANDS)}.")
    script = arguments[arguments.index(COMPLETION) + 1 :] if COMPLETION in arguments else ()
    if COMPLETION in arguments and (len(script) < 2 or script[0] not in SHELLS):
        raise UsageError(f"{COMPLETION} takes a shell and a file: {', '.join(SHELLS)}, as {COMPLETION} bash FILE.")
    gathered = _gathered(with_config(arguments))
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
        # An option that is not among the arguments themselves comes from the file, which is told then.
        typed = [argument.partition("=")[0] for argument in arguments]
        is_filed = CONFIG in typed and str(error).split()[0] not in typed
        raise UsageError(f"{arguments[typed.index(CONFIG) + 1]}: {error}" if is_filed else str(error)) from None
    name, module = next((name, entry.module) for name, entry in COMMANDS.items() if type(command) is entry.options)
    _check_files(command)
    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = show_warning
        # Imported here, since most of a command's imports start with JAX: seconds that --help need not wait.
        actions = importlib.import_module(f"raytrace_jax.cli.actions.{module}")
        return getattr(actions, f"run_{name}")(command)


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
    texts = {name: inspect.getdoc(entry.options) or "" for name, entry in COMMANDS.items()}
    shown = {name: text if named else text.splitlines()[0] for name, text in texts.items()}
    members = [Annotated[COMMANDS[name].options, subcommand(name, description=text)] for name, text in shown.items()]
    return functools.reduce(operator.or_, members)


ASSIGNED = ("--tie", "--prior", "--uncertain")
"""Options of `NAME=VALUE` texts that a mapping is made of."""

NAMED = ("--free", "--wrt", "--profile", "--aov", "--over", "--only", "--also")
"""Options of several words."""


def _gathered(arguments: Sequence[str]) -> list[str]:
    """The arguments with `-Dname=value` as `-D name=value`, and what comes several times gathered at the end.

    What follows a `NAME=VALUE` and looks like another is one, unless it is a file's name.
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


def _check_files(command: Any) -> None:
    """Refuse files to read that are not there."""
    for name, value in vars(command).items():
        for path in value if isinstance(value, tuple) else (value,):
            if isinstance(path, Path) and name == "scene" and not scene_path(path).exists():
                raise RaytraceError(no_such_scene(path))
            if isinstance(path, Path) and name not in ("scene", "output") and not path.exists():
                read_bytes(path)  # It says which names are near.
