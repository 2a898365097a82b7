"""The commands `rays`, `view` and `teach` take these options."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from raytrace_jax.cli.options import (
    REPEATABLE,
    AsJson,
    Assignments,
    Names,
    OutputFolder,
    Quiet,
    RenderOptions,
    SceneFile,
    Told,
    whole_numbers,
    with_running_help,
)
from raytrace_jax.report import LessonName
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.util.checked import Checked, Wanted


@with_running_help
@dataclass(frozen=True)
class Rays(Told, Checked):
    """Draw the rays of one pixel from the side, and list them in a table.

    The table on stdout has one line for each ray: the parent ray at whose hit it starts, what it hits, the distance,
    the angles at the hit, and the colour that it returns. The colour in the first line is that of the pixel.

    Example: raytrace-jax rays vitreous.txt --pixel 320 240 -o rays.svg
    """

    scene: SceneFile
    pixel: Annotated[tuple[int, int], whole_numbers("X Y")]
    """The pixel (required): its column and row, counted from the top left of the whole picture."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.svg")]
    """The drawing to write, .svg or .png. Missing folders are made."""
    assignments: Assignments = ()
    least_drawn: Annotated[float | None, Wanted("a share from 0 to below 1", "SHARE", least=0, below=1)] = None
    """Draw the rays that count at least this share of the pixel; the table has all of them. Without it 0.005 in the
    physical model, where a path splits at every surface, and 0 in the others."""
    json: AsJson = False
    quiet: Quiet = False
    render: RenderOptions = RenderOptions()


@with_running_help
@dataclass(frozen=True)
class View(Told, Checked):
    """Show a scene on a page of this machine while its numbers move: picture, derivative and rays.

    The address is printed; Ctrl-C ends it. Picture, derivative and rays are compiled when they are first shown, which
    takes up to a minute; the page counts the seconds.

    Example: raytrace-jax view glass_on_board --size 320 200 --over glass.ior=1:2.4 glass.center.x=-1:1
    """

    scene: SceneFile
    over: Annotated[Names, arg(metavar="NAME=START:STOP ...")] = ()
    """The numbers that get a slider, each with its range, which must contain the scene's value. Without this option:
    index and centre of the first glass ball."""
    port: Annotated[int, Wanted(metavar="N", least=0, most=2**16 - 1)] = 0
    """The port of the page; 0 takes any that is free."""
    edges: EdgeMode = "aware"
    """aware: derivatives see silhouettes and refracted edges move, as those of `grad`; point: they do not, and come ten
    times as fast."""
    assignments: Assignments = ()
    render: RenderOptions = RenderOptions()


@with_running_help
@dataclass(frozen=True)
class Teach:
    """Draw the figures of a lecture on refraction and its derivatives, with a page that explains them.

    DIR gets a PNG of each figure, for slides and print also SVG or PDF, and index.md with a paragraph on each. The
    paths are printed.

    Example: raytrace-jax teach -o lecture
    """

    output: OutputFolder
    only: Annotated[tuple[LessonName, ...], REPEATABLE, arg(metavar="NAME ...")] = ()
    """Draw only these. snell, fresnel, critical, ball: the formulas; total_reflection: automatic differentiation of a
    square root; edges: derivative pictures with and without edges; cost: the error against the index."""
    also: Annotated[tuple[Literal["svg", "pdf"], ...], REPEATABLE, arg(metavar="svg pdf")] = ()
    """Write each figure in these formats, too."""
    quiet: Quiet = False
