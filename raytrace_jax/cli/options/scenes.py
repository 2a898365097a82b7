"""The options of the commands that render, explain, write and translate scenes."""

from math import inf
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, arg

from raytrace_jax.cli import options as shared
from raytrace_jax.exchange import Format as Language
from raytrace_jax.images import Transfer
from raytrace_jax.report import GallerySet, LessonName
from raytrace_jax.scene.setting_words import MAX_SAMPLES, EdgeMode, ModelName
from raytrace_jax.util.checked import Wanted

FigureFormat = Literal["svg", "pdf"]

FileModel = Annotated[
    ModelName | None,
    arg(
        help="The model whose defaults fill in what the file leaves out. Default: that of the file's settings, else "
        "classic.",
        help_behavior_hint="",
    ),
]

ScreenTransfer = Annotated[
    Transfer | None,
    arg(
        help="Colours for the screen. course: floor(255 * C), no gamma; srgb: what screens expect. Without it srgb in "
        "the physical model, course in the others.",
        help_behavior_hint="",
    ),
]


@shared.option_class()
class Render(shared.CommandOptions):
    """Render a scene to an OpenEXR picture, with a PNG beside it, and print their paths.

    Example: raytrace-jax render vitreous.txt -o vitreous.exr -D vitreous.ior=1.5 --aov depth normal
    """

    scene: shared.SceneFile
    output: shared.OutputExr
    """The picture to write: OUT.exr (and OUT.png beside it), or OUT.png alone. Missing folders are made."""
    assignments: shared.Assignments = ()
    half: bool = False
    """Store 16-bit floats in the OpenEXR file, half its size."""
    png: bool = True
    """Write a PNG beside the OpenEXR file."""
    png_transfer: ScreenTransfer = None
    quiet: shared.Quiet = False
    render: shared.PictureOptions = shared.PictureOptions()


@shared.option_class()
class Grad(shared.CommandOptions):
    """Differentiate the picture of a scene with respect to parameters.

    OUT.exr gets the picture (R G B) and for each number a signed layer, as d.vitreous.ior.R/G/B or
    d.vitreous.center.x.R/G/B. OUT.png beside it shows them on one sheet, the mean over R, G and B. The paths of both
    are printed.

    Example: raytrace-jax grad vitreous.txt --wrt vitreous.ior vitreous.center -o derivatives.exr --check
    """

    scene: shared.SceneFile
    wrt: shared.Names
    """The parameters (required), as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: shared.OutputExr
    """The OpenEXR file to write, with OUT.png beside it. Missing folders are made."""
    assignments: shared.Assignments = ()
    edges: EdgeMode = "aware"
    """aware: derivatives see silhouettes and refracted edges move; point: they do not.
    Derivatives that miss edges are faster and of little use."""
    check: bool = False
    """Compare with finite differences of supersampled pictures. The file gets more layers, as
    difference.vitreous.ior.R/G/B, the sheet a second row, and stdout a table and a verdict in words. The differences
    are taken with two step sizes, which shows their own error."""
    check_samples: Annotated[int | None, Wanted(metavar="N", least=1, most=MAX_SAMPLES)] = None
    """The pictures for --check have N x N rays a pixel, 1 to 64. Without it 16 to 48, more in small pictures."""
    check_step: Annotated[float | None, Wanted("a finite number greater than 0", "X", above=0, below=inf)] = None
    """The step by which --check moves a parameter to either side, in the parameter's unit: first X, then X / 2, and
    less where a limit of the parameter is near. Default: the step starts at 0.006 and is halved, at most four times, as
    long as that brings the differences closer to each other."""
    json: shared.AsJson = False
    quiet: shared.Quiet = False
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
class Gallery(shared.CommandOptions):
    """Render a set of pictures and a labelled sheet: what a model needs each of its parts for, or what glass can be.

    assignment: the six pictures of the assignment page, from no total internal reflection to the final one with
    Schlick's approximation. checkpoints: reflection, Fresnel and transmission of the additive model, without and with
    each. glass: balls of the physical model, clear, tinted, dispersive, with a bubble, two of them, under a sky alone.
    DIR gets an OpenEXR file and a PNG of each, and gallery.png, one labelled sheet. With --wrt each has its edge-aware
    derivatives, as layers of its file and below it on the sheet.

    Example: raytrace-jax gallery data/vitreous.txt --wrt vitreous.ior --size 320 240 -o gallery
    """

    output: shared.OutputFolder
    scene: Annotated[Positional[Path | None], arg(metavar="SCENE")] = None
    """The scene; without it vitreous or, for the checkpoints, checkpoints: both come with the package. The pictures of
    the set glass have scenes of their own."""
    set: GallerySet = "assignment"
    """Which pictures."""
    wrt: shared.Names = ()
    """Parameters to differentiate by, as vitreous.ior; `raytrace-jax info SCENE` lists all."""
    assignments: shared.Assignments = ()
    png_transfer: ScreenTransfer = None
    quiet: shared.Quiet = False
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
class Sweep(shared.CommandOptions):
    """Animate a scene: one parameter runs through a range of values, one frame for each.

    Example: raytrace-jax sweep vitreous.txt --over vitreous.ior=1.0:2.4:60 -o sweep.gif --bounce --label
    """

    scene: shared.SceneFile
    over: Annotated[str, arg(metavar="NAME=START:STOP:COUNT")]
    """The parameter and its values, evenly spaced with both ends included, as vitreous.ior=1.0:2.4:60; it is a single
    number, as vitreous.center.x; `raytrace-jax info SCENE` lists the names."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.gif")]
    """The animation to write: OUT.gif, or OUT.mp4 if ffmpeg is on the PATH. Missing folders are made."""
    assignments: shared.Assignments = ()
    fps: Annotated[int, arg(metavar="N")] = 20
    """Frames a second, 1 to 60; a GIF has at most 50, and rounds to hundredths of a second a frame."""
    bounce: bool = False
    """Go through the values and back again, so that the animation has no jump where it repeats."""
    label: bool = False
    """Write the name and the value on each frame; frames too small for that get them on a strip below."""
    edges: EdgeMode | None = None
    """What a sample sees. point: one ray, as the course has it; aware: the area around it, edges blended smoothly.
    Without it what the scene's file says, or point."""
    transfer: ScreenTransfer = None
    quiet: shared.Quiet = False
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
class Rays(shared.CommandOptions):
    """Draw the rays of one pixel from the side, and list them in a table.

    The table on stdout has one line for each ray: the parent ray at whose hit it starts, what it hits, the distance,
    the angles at the hit, and the colour that it returns. The colour in the first line is that of the pixel.

    Example: raytrace-jax rays vitreous.txt --pixel 320 240 -o rays.svg
    """

    scene: shared.SceneFile
    pixel: Annotated[tuple[int, int], shared.whole_numbers("X Y")]
    """The pixel (required): its column and row, counted from the top left of the whole picture."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.svg")]
    """The drawing to write, .svg or .png. Missing folders are made."""
    assignments: shared.Assignments = ()
    least_drawn: Annotated[float | None, Wanted("a share from 0 to below 1", "SHARE", least=0, below=1)] = None
    """Draw the rays that count at least this share of the pixel; the table has all of them. Without it 0.005 in the
    physical model, where a path splits at every surface, and 0 in the others."""
    json: shared.AsJson = False
    quiet: shared.Quiet = False
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
class View(shared.CommandOptions):
    """Show a scene on a page of this machine while its numbers move: picture, derivative and rays.

    The address is printed; Ctrl-C ends it. Picture, derivative and rays are compiled when they are first shown, which
    takes up to a minute; the page counts the seconds.

    Example: raytrace-jax view glass_on_board --size 320 200 --over glass.ior=1:2.4 glass.center.x=-1:1
    """

    scene: shared.SceneFile
    over: Annotated[tuple[str, ...], shared.repeatable(str, "NAME=START:STOP ...")] = ()
    """The numbers that get a slider, each with its range, which must contain the scene's value. Without this option:
    index and centre of the first glass ball."""
    port: Annotated[int, Wanted(metavar="N", least=0, most=2**16 - 1)] = 0
    """The port of the page; 0 takes any that is free."""
    edges: EdgeMode = "aware"
    """aware: derivatives see silhouettes and refracted edges move, as those of `grad`; point: they do not, and come ten
    times as fast."""
    assignments: shared.Assignments = ()
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
class Teach(shared.CommandOptions):
    """Draw the figures of a lecture on refraction and its derivatives, with a page that explains them.

    DIR gets a PNG of each figure, for slides and print also SVG or PDF, and index.md with a paragraph on each. The
    paths are printed.

    Example: raytrace-jax teach -o lecture
    """

    output: shared.OutputFolder
    only: Annotated[tuple[LessonName, ...], shared.repeatable(LessonName, "NAME ...")] = ()
    """Draw only these. snell, fresnel, critical, ball: the formulas; total_reflection: automatic differentiation of a
    square root; edges: derivative pictures with and without edges; cost: the error against the index."""
    also: Annotated[tuple[FigureFormat, ...], shared.repeatable(FigureFormat, "svg pdf")] = ()
    """Write each figure in these formats, too."""
    quiet: shared.Quiet = False


@shared.option_class()
class New:
    """Write a scene to begin with, whose comments say what has to be measured for a picture of your own.

    docs/own_picture.md goes on from there to the index.

    Example: raytrace-jax new ball -o scene.txt
    """

    scene: Annotated[Positional[Literal["ball"]], arg(metavar="ball")]
    """What it shows. ball: a ball of glass before a checkered board."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="SCENE")]
    """The file to write; one that is there stays."""


@shared.option_class()
class Format(shared.CommandOptions):
    """Write a scene file in canonical form, with the same numbers.

    Example: raytrace-jax format vitreous.txt -D vitreous.radius=2 > smaller.txt
    """

    scene: shared.SceneFile
    assignments: shared.Assignments = ()
    model: FileModel = None


@shared.option_class()
class Info(shared.CommandOptions):
    """List the blocks of a scene and its parameters, by the names that -D and --free take.

    Example: raytrace-jax info vitreous.txt
    """

    scene: shared.SceneFile
    assignments: shared.Assignments = ()
    model: FileModel = None
    json: shared.AsJson = False


@shared.option_class()
class Scenes:
    """List the scenes that come with the package: every command takes their names for a SCENE.

    Example: raytrace-jax render glass_on_board -o ball.exr
    """


@shared.option_class()
class Export(shared.CommandOptions):
    """Write a physical scene for POV-Ray 3.7 or for Mitsuba 3.

    The file's head has the command that renders it. Pictures of textures are written beside it, as OpenEXR. Features
    that the other program lacks or handles differently are listed and counted on stderr and in the file's head.

    Example: raytrace-jax export glass_on_board --to mitsuba -o board.xml
    """

    scene: shared.SceneFile
    to: Language
    """pov: POV-Ray's language; mitsuba: XML; mitsuba-dict: a Python program with the dictionary for mitsuba.load_dict.
    """
    output: Annotated[Path, arg(aliases=["-o"], metavar="FILE")]
    """The file to write. Missing folders are made."""
    assignments: shared.Assignments = ()
    quiet: shared.Quiet = False
    render: shared.RenderOptions = shared.RenderOptions()


@shared.option_class()
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
    quiet: shared.Quiet = False
