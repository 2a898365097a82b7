"""Options that several commands have."""

import contextlib
import dataclasses
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Annotated, Any, TypeVar

import docstring_parser
from tyro.conf import Positional, UseAppendAction, arg
from tyro.constructors import PrimitiveConstructorSpec

from raytrace_jax.cli.console import UsageError
from raytrace_jax.errors import SettingsError
from raytrace_jax.scene.setting_words import EtaConvention, ModelName, PixelConvention, Reflectance
from raytrace_jax.tracer.settings import Precision, RenderSettings

SceneFile = Annotated[Positional[Path], arg(metavar="SCENE")]
Assignments = Annotated[UseAppendAction[tuple[str, ...]], arg(name="define", aliases=["-D"], metavar="NAME=VALUE")]
Names = Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")]
"""Names, each time that the option comes; `joined` makes one tuple of them."""

OutputFolder = Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
OutputExr = Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]


T = TypeVar("T")


def whole_numbers(metavar: str) -> PrimitiveConstructorSpec:
    """How an option reads so many whole numbers; tyro's own way says `INT INT` with its markup where one is missing."""
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


def with_running_help(options: type[T]) -> type[T]:
    """A class of options whose texts run on from line to line: tyro breaks its help where an indented line begins.

    A default of None is not told: the texts say what holds without the option.
    """
    defaults = {field.name: field.default for field in dataclasses.fields(options)}  # pyright: ignore[reportArgumentType]
    for row in docstring_parser.parse_from_object(options).params:
        text = " ".join((row.description or "").split())
        how = arg(help=text, help_behavior_hint="" if defaults[row.arg_name] is None else None)
        options.__annotations__[row.arg_name] = Annotated[options.__annotations__[row.arg_name], how]
    return options


def joined(groups: Iterable[tuple[str, ...]]) -> tuple[str, ...]:
    """The names of an option that may come several times."""
    return tuple(name for names in groups for name in names)


@with_running_help
@dataclasses.dataclass(frozen=True)
class RenderOptions:
    """How a picture is made; `render`, `grad`, `gallery`, `rays`, `sweep` and `fit` share these."""

    model: ModelName | None = None
    """The shading model. It also gives the defaults of what the scene's file leaves out. classic: the assignment's
    model; additive: that of the report on checkpoints 4 to 6, with shadows; physical: that of real glass. Default: the
    settings in the scene's file, else classic. For the next options, too, the file's settings come first."""
    reflectance: Reflectance | None = None
    """How reflected and transmitted light share a transparent surface. none: alpha blends the transmitted ray only;
    schlick: alpha blends both, weighted with Schlick's approximation of Fresnel's equations. Without it schlick."""
    eta: EtaConvention | None = None
    """The ratio of indices on leaving a shape. course: 1.000293 * ior, as the course's code has it; physical:
    ior / 1.000293. Entering is the same in both. Without it course."""
    max_bounces: Annotated[int | None, arg(metavar="N")] = None
    """How often a path may bounce, 0 to 64; a ray that has bounced more often is black. Without it 5, in the additive
    model 2, in the physical one 12."""
    path_limit: Annotated[float | None, arg(metavar="LENGTH")] = None
    """A longer path ends in black, in world units. Without it 100 in the classic model, and none in the others."""
    least_weight: Annotated[float | None, arg(metavar="SHARE")] = None
    """A ray that contributes less than this share to its pixel is black; 0 keeps all rays. Physical model only. Without
    it 1e-6."""
    samples: Annotated[int | None, arg(metavar="N")] = None
    """Samples per pixel and side: N renders an N x N grid within each pixel and averages it, 1 to 64. Without it 1."""
    mapping: PixelConvention | None = None
    """Where the pixels look. corner: pixel x at x / (width - 1) of the image plane, end points included, as the
    course has it; center: at (x + 1/2) / width, the centres of pixels that tile the image plane. Without it corner, in
    the physical model center."""
    size: Annotated[tuple[int, int] | None, whole_numbers("W H")] = RenderSettings.size
    """Width and height of the picture in pixels; without it the camera's pixeldim."""
    crop: Annotated[tuple[int, int, int, int] | None, whole_numbers("X Y W H")] = RenderSettings.crop
    """Render only this window of the picture: its left and top pixel, its width and its height."""
    precision: Precision = 64
    """Bits of the floating-point numbers in use. 32 is faster; a fit wants 64."""
    total_internal_reflection: bool = RenderSettings.total_internal_reflection
    """Reflect a ray that cannot leave a shape; with --no-... it is lost (black)."""
    second_root: bool = RenderSettings.second_root
    """Let rays inside of a sphere hit its far side; with --no-... they miss it."""
    reflection: bool = RenderSettings.reflection
    """Follow the mirror ray of the specular colour; with --no-... there is none."""

    def given(self, **others: Any) -> RenderSettings:
        """The settings that were given, and others; without JAX.

        Raises:
            UsageError: a value outside of its limits, or one that the model that was given cannot be told.
        """
        options = dataclasses.asdict(self) | others
        del options["precision"]
        with as_usage_error():
            return RenderSettings(**options)


@contextlib.contextmanager
def as_usage_error() -> Iterator[None]:
    """A setting that is refused within becomes the error of an option."""
    try:
        yield
    except SettingsError as reason:
        name, space, rest = str(reason).partition(" ")
        raise UsageError(f"--{name.replace('_', '-')}{space}{rest}") from None
