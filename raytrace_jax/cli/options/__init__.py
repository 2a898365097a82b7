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

from tyro.conf import Positional, Suppress, UseAppendAction, arg

from ...tracer.settings import AovName, Precision, RenderSettings
from ...util.checked import Checked, field_texts, wanted
from ..console import UsageError, blamed_on

T = TypeVar("T")

REPEATABLE = "(repeatable)"
"""What help says of an option that may come several times."""


def repeatable(word: Any, metavar: str, text: str | None = None) -> object:
    """The mark of a row of words that comes after one option, or after several of the same name; `text` is its help."""
    rows: Any = UseAppendAction[tuple[tuple[word, ...], ...]]  # pyright: ignore[reportInvalidTypeForm]
    return arg(constructor=rows, metavar=metavar, help=text, help_behavior_hint=REPEATABLE)


Quiet = Annotated[bool, arg(help="Say nothing on the way; errors and warnings are still shown.")]
Verbose = Annotated[bool, arg(help="On a terminal too, say each step of the fit on a line of its own.")]
AsJson = Annotated[bool, arg(help="Print one JSON object on stdout in place of paths and tables.")]
Names = Annotated[tuple[str, ...], repeatable(str, "NAME ...")]


def output(metavar: str, text: str | None = None) -> object:
    """The mark of the file or folder that a command writes; `text` is its help."""
    return arg(aliases=["-o"], metavar=metavar, help=text)


CameraName = Annotated[str | None, arg(metavar="NAME")]
OutputFolder = Annotated[Path, output("DIR", "The folder to write; it is made if it is missing.")]
OutputExr = Annotated[Path, output("OUT.exr")]


def split_assignment(option: str, text: str, form: str, read: Callable[[str], T]) -> tuple[str, T]:
    """Split `NAME=VALUE` into the name and what `read` makes of the value; a refusal says the `form` to write."""
    name, _, value = (piece.strip() for piece in text.rpartition("="))
    with contextlib.suppress(ValueError):
        if name and value:
            return name, read(value)
    raise UsageError(f"--{option} {text}: write {form}.")


@dataclass_transform(frozen_default=True, kw_only_default=True)
class CommandOptions(Checked):
    """The base of all options: each class of them becomes a frozen dataclass with help as tyro takes it.

    Texts run on from line to line: tyro breaks its help where an indented line begins. A default of None or of an empty
    text is not told: the texts say what holds without the option. What has no default is told to be required, rows too,
    which tyro would take as empty. The command line does not offer `hidden` fields. Rows of an option that came
    repeatedly are joined, and refusals name an option as the command line does.
    """

    def __init_subclass__(cls, hidden: Collection[str] = ()) -> None:
        dataclasses.dataclass(frozen=True, kw_only=True)(cls)
        texts = {name: text for base in reversed(cls.__mro__[:-1]) for name, text in field_texts(base).items()}
        hints_of = get_type_hints(cls, include_extras=True)
        for field in dataclasses.fields(cls):  # pyright: ignore[reportArgumentType]
            hint = hints_of[field.name]
            if field.name in hidden:
                cls.__annotations__[field.name] = Suppress[hint]
            elif field.name in texts:
                behaviours = [getattr(mark, "help_behavior_hint", None) for mark in getattr(hint, "__metadata__", ())]
                required = "(required, repeatable)" if REPEATABLE in behaviours else "(required)"
                default = {None: "", "": "", dataclasses.MISSING: required}.get(field.default)
                shown = arg(metavar=wanted(hint).metavar, help=texts[field.name], help_behavior_hint=default)
                cls.__annotations__[field.name] = Annotated[hint, shown]

    def __post_init__(self):
        for name, value in vars(self).items():
            if isinstance(value, tuple) and all(isinstance(row, tuple) for row in value):
                object.__setattr__(self, name, tuple(itertools.chain(*value)))
        with blamed_on():
            super().__post_init__()


class PictureOptions(CommandOptions, RenderSettings, hidden=("rays_per_pixel", "throw")):
    """How a picture is made."""

    aov: Annotated[tuple[AovName, ...], repeatable(AovName, "NAME ...")] = ()
    precision: Precision = 64
    """Bits of the floating-point numbers in use. 32 is faster; a fit wants 64."""


class RenderOptions(PictureOptions, hidden=("edges", "binning", "aov", "rays_per_pixel", "throw")):
    """How a picture is made, the same for all commands that make one."""


class SceneOptions(CommandOptions):
    """A scene with other values of some parameters."""

    scene: Annotated[Positional[Path], arg(metavar="SCENE")]
    """The scene: a model.txt file, or a name that `raytrace-jax scenes` lists."""
    assignments: Annotated[tuple[str, ...], repeatable(str, "NAME=VALUE"), arg(name="define", aliases=["-D"])] = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""


class PictureCommand(SceneOptions):
    """A scene whose pictures have these settings."""

    camera: CameraName = None
    """The camera whose picture it is, where the scene has several. Without it the file's first one."""
    quiet: Quiet = False
    render: RenderOptions = RenderOptions()
