"""The options of `export` and `import`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from raytrace_jax.cli.options.shared import Assignments, Quiet, RenderOptions, SceneFile, with_running_help
from raytrace_jax.exchange.formats import Format


@with_running_help
@dataclass(frozen=True)
class Export:
    """Write a physical scene for POV-Ray 3.7 or for Mitsuba 3.

    The file's head has the command that renders it. Pictures of textures are written beside it, as OpenEXR. Features
    that the other program lacks or handles differently are listed and counted on stderr and in the file's head.

    Example: raytrace-jax export glass_on_board --to mitsuba -o board.xml
    """

    scene: SceneFile
    to: Format
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
