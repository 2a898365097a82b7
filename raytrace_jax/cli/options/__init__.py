"""Each command's options are typed dataclasses, of which tyro makes the parser and the help texts.

Nothing here imports JAX, so that `--help` answers at once; and every word that an option can be stands elsewhere, in
the table of what it chooses from.
"""

import contextlib
import dataclasses
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform, get_args, get_type_hints

import docstring_parser
from tyro.conf import Positional, Suppress, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from raytrace_jax.cli.console import UsageError
from raytrace_jax.errors import ParameterError, SettingsError
from raytrace_jax.tracer.settings import Precision, RenderSettings
from raytrace_jax.util.checked import core, wanted

SceneFile = Annotated[Positional[Path], arg(metavar="SCENE", help="The scene, a model.txt file.")]
Assignments = Annotated[
    UseAppendAction[tuple[str, ...]],
    arg(
        name="define",
        aliases=["-D"],
        metavar="NAME=VALUE",
        help="Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the "
        "names.",
    ),
]
Quiet = Annotated[bool, arg(help="Say nothing on the way; errors and warnings are still shown.")]
AsJson = Annotated[bool, arg(help="Print one JSON object on stdout in place of paths and tables.")]
REPEATABLE = arg(help_behavior_hint="(repeatable)")
Names = Annotated[tuple[str, ...], arg(metavar="NAME ...", help_behavior_hint="(repeatable)")]
"""Names; `dispatch` gathers those of an option that comes several times."""

SHORTER = {"ties": "tie", "priors": "prior", "profiles": "profile"}
"""Options that the command line calls otherwise."""

NO_OPTION = [get_args(marked)[1] for marked in (Positional[int], Suppress[int])]
"""Marks of tyro on what is not an option."""

OutputFolder = Annotated[
    Path, arg(aliases=["-o"], metavar="DIR", help="The folder to write; it is made if it is missing.")
]
OutputExr = Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]


T = TypeVar("T")


def split_assignment(option: str, text: str, form: str, read: Callable[[str], T]) -> tuple[str, T]:
    """Split `NAME=VALUE` into the name and what `read` makes of the value; a refusal says the `form` to write."""
    name, _, value = (piece.strip() for piece in text.rpartition("="))
    with contextlib.suppress(ValueError):
        if name and value:
            return name, read(value)
    raise UsageError(f"--{option} {text}: write {form}.")


def whole_numbers(metavar: str) -> PrimitiveConstructorSpec:
    """An option of so many whole numbers; tyro's own way says `INT INT` with its markup where one is missing."""
    names = metavar.split()

    def read(words: list[str]) -> tuple[int, ...]:
        with contextlib.suppress(ValueError):
            if len(words) == len(names):
                return tuple(map(int, words))
        raise ValueError(f"{len(names)} whole numbers are wanted, {metavar}, and {' '.join(words) or 'nothing'} came")

    return PrimitiveConstructorSpec(
        nargs="*",
        metavar=metavar,
        instance_from_str=read,
        is_instance=lambda value: value is None or (isinstance(value, tuple) and len(value) == len(names)),
        str_from_instance=lambda value: [str(number) for number in value or ()],
    )


@dataclass_transform(frozen_default=True)
def option_class(hidden: Collection[str] = (), **flags: tuple[object, ...]) -> Callable[[type[T]], type[T]]:
    """A decorator that makes a class of options a frozen dataclass with help as tyro takes it.

    Its texts run on from line to line: tyro breaks its help where an indented line begins. A default of None is not
    told: the texts say what holds without the option.

    The command line does not offer `hidden` fields; `flags` say what tyro has to know of some fields besides.
    """

    def decorate(options: type[T]) -> type[T]:
        options = dataclasses.dataclass(frozen=True)(options)
        bases = reversed(options.__mro__[:-1])
        rows = [row for base in bases for row in docstring_parser.parse_from_object(base).params]
        texts = {row.arg_name: " ".join((row.description or "").split()) for row in rows}
        found = get_type_hints(options, include_extras=True)
        for field in dataclasses.fields(options):  # pyright: ignore[reportArgumentType]
            hint = found[field.name]
            if field.name in hidden:
                options.__annotations__[field.name] = Suppress[hint]
            elif field.name in texts:
                hint = Annotated[hint, arg(metavar=wanted(hint).metavar, help=texts[field.name])]
                if field.default is None:
                    hint = Annotated[hint, arg(help_behavior_hint="")]
                for more in flags.get(field.name, ()):
                    hint = Annotated[hint, more]
                options.__annotations__[field.name] = hint
        return options

    return decorate


def option_names(options: type) -> Iterator[str]:
    """The options of a command, as `max_steps`; its positional arguments are none."""
    found = get_type_hints(options, include_extras=True)
    for name in (field.name for field in dataclasses.fields(options)):  # pyright: ignore[reportArgumentType]
        hint = found[name]
        extras = getattr(hint, "__metadata__", ())
        if dataclasses.is_dataclass(kind := core(hint)):
            yield from option_names(kind)  # pyright: ignore[reportArgumentType]
        elif not any(extra in NO_OPTION for extra in extras):
            yield next((extra.name for extra in extras if getattr(extra, "name", None)), name)


class Told:
    """Options of which the command line refuses what is wrong by the names that they have there."""

    def __post_init__(self):
        with as_usage_error():
            super().__post_init__()  # pyright: ignore[reportAttributeAccessIssue]


ROWS: dict[str, Any] = {"size": (whole_numbers("W H"),), "crop": (whole_numbers("X Y W H"),)}


@option_class(**ROWS, aov=(REPEATABLE,))
class PictureOptions(Told, RenderSettings):
    """How a picture is made."""

    precision: Precision = 64
    """Bits of the floating-point numbers in use. 32 is faster; a fit wants 64."""


@option_class(hidden=("edges", "binning", "aov"), **ROWS)
class RenderOptions(PictureOptions):
    """How a picture is made; `grad`, `gallery`, `rays`, `sweep`, `fit` and others share these."""


@contextlib.contextmanager
def as_usage_error() -> Iterator[None]:
    """A setting that is refused within becomes the error of an option."""
    try:
        yield
    except (SettingsError, ParameterError) as reason:
        name, space, rest = str(reason).partition(" ")
        raise UsageError(f"--{SHORTER.get(name, name).replace('_', '-')}{space}{rest}") from None
