"""The options that commands share; those of each command are a dataclass, of which tyro makes parser and help.

Nothing here imports JAX, so that `--help` answers at once; and every word that an option can be stands elsewhere, in
the table of what it chooses from.
"""

import contextlib
import dataclasses
import itertools
from collections.abc import Callable, Collection
from pathlib import Path
from typing import Annotated, Any, TypeVar, dataclass_transform, get_type_hints

import docstring_parser
from tyro.conf import Positional, Suppress, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from raytrace_jax.cli.console import UsageError, blamed_on
from raytrace_jax.tracer.settings import AovName, Precision, RenderSettings
from raytrace_jax.util.checked import Checked, wanted

T = TypeVar("T")


def repeatable(word: Any, metavar: str) -> object:
    """The mark of a row of words that comes after one option, or after several of the same name."""
    rows: Any = UseAppendAction[tuple[tuple[word, ...], ...]]  # pyright: ignore[reportInvalidTypeForm]
    return arg(constructor=rows, metavar=metavar, help_behavior_hint="(repeatable)")


SceneFile = Annotated[Positional[Path], arg(metavar="SCENE", help="The scene, a model.txt file.")]
Assignments = Annotated[
    tuple[str, ...],
    repeatable(str, "NAME=VALUE"),
    arg(
        name="define",
        aliases=["-D"],
        help="Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the "
        "names.",
    ),
]
Quiet = Annotated[bool, arg(help="Say nothing on the way; errors and warnings are still shown.")]
AsJson = Annotated[bool, arg(help="Print one JSON object on stdout in place of paths and tables.")]
Names = Annotated[tuple[str, ...], repeatable(str, "NAME ...")]
OutputFolder = Annotated[
    Path, arg(aliases=["-o"], metavar="DIR", help="The folder to write; it is made if it is missing.")
]
OutputExr = Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]


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


class CommandOptions(Checked):
    """Options whose refusals name them as the command line does; rows of an option that came repeatedly are joined."""

    def __post_init__(self):
        for name, value in vars(self).items():
            if isinstance(value, tuple) and all(isinstance(row, tuple) for row in value):
                object.__setattr__(self, name, tuple(itertools.chain(*value)))
        with blamed_on():
            super().__post_init__()


ROWS: dict[str, Any] = {"size": (whole_numbers("W H"),), "crop": (whole_numbers("X Y W H"),)}


@option_class(**ROWS, aov=(repeatable(AovName, "NAME ..."),))
class PictureOptions(CommandOptions, RenderSettings):
    """How a picture is made."""

    precision: Precision = 64
    """Bits of the floating-point numbers in use. 32 is faster; a fit wants 64."""


@option_class(hidden=("edges", "binning", "aov"), **ROWS)
class RenderOptions(PictureOptions):
    """How a picture is made; `grad`, `gallery`, `rays`, `sweep`, `fit` and others share these."""
