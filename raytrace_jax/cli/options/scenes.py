"""The commands on scene files, `new`, `format`, `info`, `scenes`, `export` and `import`, take these options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from raytrace_jax.cli.options import (
    AsJson,
    Assignments,
    Quiet,
    RenderOptions,
    SceneFile,
    with_running_help,
)
from raytrace_jax.exchange.formats import Format as Language
from raytrace_jax.scene.setting_words import ModelName

FileModel = Annotated[
    ModelName | None,
    arg(
        help="The model whose defaults fill in what the file leaves out. Default: that of the file's settings, else "
        "classic.",
        help_behavior_hint="",
    ),
]


@with_running_help
@dataclass(frozen=True)
class New:
    """Write a scene to begin with, whose comments say what has to be measured for a picture of your own.

    docs/own_picture.md goes on from there to the index.

    Example: raytrace-jax new ball -o scene.txt
    """

    scene: Annotated[Positional[Literal["ball"]], arg(metavar="ball")]
    """What it shows. ball: a ball of glass before a checkered board."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="SCENE")]
    """The file to write; one that is there stays."""


@with_running_help
@dataclass(frozen=True)
class Format:
    """Write a scene file in canonical form, with the same numbers.

    Example: raytrace-jax format vitreous.txt -D vitreous.radius=2 > smaller.txt
    """

    scene: SceneFile
    assignments: Assignments = ()
    model: FileModel = None


@with_running_help
@dataclass(frozen=True)
class Info:
    """List the blocks of a scene and its parameters, by the names that -D and --free take.

    Example: raytrace-jax info vitreous.txt
    """

    scene: SceneFile
    assignments: Assignments = ()
    model: FileModel = None
    json: AsJson = False


@with_running_help
@dataclass(frozen=True)
class Scenes:
    """List the scenes that come with the package: every command takes their names for a SCENE.

    Example: raytrace-jax render glass_on_board -o ball.exr
    """


@with_running_help
@dataclass(frozen=True)
class Export:
    """Write a physical scene for POV-Ray 3.7 or for Mitsuba 3.

    The file's head has the command that renders it. Pictures of textures are written beside it, as OpenEXR. Features
    that the other program lacks or handles differently are listed and counted on stderr and in the file's head.

    Example: raytrace-jax export glass_on_board --to mitsuba -o board.xml
    """

    scene: SceneFile
    to: Language
    """pov: POV-Ray's language; mitsuba: XML; mitsuba-dict: a Python program with the dictionary for mitsuba.load_dict.
    """
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """The file to write. Missing folders are made."""
    assignments: Assignments = ()
    quiet: Quiet = False
    render: RenderOptions = RenderOptions()


@with_running_help
@dataclass(frozen=True)
class Import:
    """Read a scene of Mitsuba 3 and write it as a model.txt file.

    It reads perspective cameras; spheres and rectangles; dielectric, conductor and diffuse surfaces; area, point and
    constant emitters and environments; bitmaps and checkerboards; media that absorb. Everything else in the file is
    listed and counted on stderr. Pictures of textures are written beside the scene, as OpenEXR. Mitsuba's own parser
    reads the file; it is in the extra `mitsuba`.

    Example: raytrace-jax import board.xml -o board.txt
    """

    file: Annotated[Positional[Path], arg(metavar="FILE.xml")]
    """The scene of Mitsuba 3, as XML."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="SCENE")]
    """The model.txt file to write. Missing folders are made."""
    quiet: Quiet = False
