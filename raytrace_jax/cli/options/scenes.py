"""The options of the commands that render, explain, write and translate scenes."""

from math import inf
from pathlib import Path
from typing import Annotated, Literal, get_args

from tyro.conf import Positional, arg

from ...exchange import Format as Language
from ...images import Transfer
from ...report import GallerySet, LessonName
from ...scene.setting_words import MAX_SAMPLES, EdgeMode, ModelName
from ...util.checked import Wanted
from ...util.text import MaterialKind
from .. import options as shared

Template = Literal["ball", "tank", "prism", "box", "tube"]

FigureFormat = Literal["svg", "pdf"]

ScreenTransfer = Annotated[
    Transfer | None,
    arg(
        help="Colours for the screen. course: floor(255 * C), no gamma; srgb: what screens expect. Without it srgb in "
        "the physical model, course in the others.",
        help_behavior_hint="",
    ),
]


class Render(shared.PictureCommand):
    """Render a scene to an OpenEXR picture, with a PNG beside it, and print their paths.

    Example: raytrace-jax render vitreous -o vitreous.exr -D vitreous.ior=1.5 --aov depth normal
    """

    output: shared.OutputExr
    """The picture to write: OUT.exr (and OUT.png beside it), or OUT.png alone. Missing folders are made."""
    camera: shared.CameraName = None
    """The camera whose picture it is. Without it a scene of several cameras gives a picture of each, as OUT_left.exr.
    """
    half: bool = False
    """Store 16-bit floats in the OpenEXR file, half its size."""
    png: bool = True
    """Write a PNG beside the OpenEXR file."""
    png_transfer: ScreenTransfer = None
    render: shared.PictureOptions = shared.PictureOptions()  # pyright: ignore[reportIncompatibleVariableOverride]


class Grad(shared.PictureCommand):
    """Differentiate the picture of a scene with respect to parameters.

    OUT.exr gets the picture (R G B) and for each number a signed layer, as d.vitreous.center.x.R/G/B. OUT.png beside it
    shows them on one sheet, the mean over R, G and B. The paths of both are printed.

    Example: raytrace-jax grad vitreous --wrt vitreous.ior --size 160 120 -o derivatives.exr --check
    """

    wrt: shared.Names
    """The parameters, as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: shared.OutputExr
    """The OpenEXR file to write, with OUT.png beside it. Missing folders are made."""
    edges: EdgeMode = "aware"
    """aware: derivatives see silhouettes and refracted edges move; point: they do not, which is of little use."""
    check: bool = False
    """Compare with finite differences of supersampled pictures, with two step sizes, which shows their own error. The
    file gets layers difference.vitreous.ior.R/G/B, the sheet a second row, and stdout a table and a verdict in words.
    """
    check_samples: Annotated[int | None, Wanted(metavar="N", least=1, most=MAX_SAMPLES)] = None
    """The pictures for --check have N x N rays a pixel, 1 to 64. Without it 16 to 48, more in small pictures."""
    check_step: Annotated[float | None, Wanted("a finite number greater than 0", "X", above=0, below=inf)] = None
    """The step by which --check moves a parameter to either side, in its unit: first X, then X / 2, and less where a
    limit of the parameter is near. Without it 0.006, halved at most four times, as long as the differences come closer.
    """
    json: shared.AsJson = False


class Gallery(shared.PictureCommand):
    """Render a set of pictures and a labelled sheet: what a model needs each of its parts for, or what glass can be.

    assignment: the six pictures of the assignment page, from no total internal reflection to Schlick's approximation.
    checkpoints: reflection, Fresnel and transmission of the additive model, without and with each. glass: balls of the
    physical model, clear, tinted, dispersive, with a bubble, two of them, under a sky alone. DIR gets an OpenEXR file
    and a PNG of each, and gallery.png, the sheet; with --wrt also edge-aware derivatives in the files and on the sheet.

    Example: raytrace-jax gallery vitreous --wrt vitreous.ior --size 320 240 -o gallery
    """

    output: shared.OutputFolder
    scene: Annotated[Positional[Path | None], arg(metavar="SCENE")] = None  # pyright: ignore
    """The scene; without it vitreous or checkpoints, which come with the package. The set glass has scenes of its own.
    """
    set: GallerySet = "assignment"
    """Which pictures."""
    wrt: shared.Names = ()
    """Parameters to differentiate by, as vitreous.ior; `raytrace-jax info SCENE` lists all."""
    png_transfer: ScreenTransfer = None


class Sweep(shared.PictureCommand):
    """Animate a scene: one parameter runs through a range of values, one frame for each.

    Example: raytrace-jax sweep vitreous --over vitreous.ior=1.0:2.4:60 --size 320 240 -o sweep.gif --bounce --label
    """

    over: Annotated[str, arg(metavar="NAME=START:STOP:COUNT")]
    """The parameter, a single number, and its values, evenly spaced with both ends: vitreous.ior=1.0:2.4:60."""
    output: Annotated[Path, shared.output("OUT.gif")]
    """The animation to write: OUT.gif, or OUT.mp4 if ffmpeg is on the PATH. Missing folders are made."""
    fps: Annotated[int | None, arg(metavar="N")] = None
    """Frames a second, 1 to 60; a GIF has at most 50, and rounds to hundredths of a second a frame. Without it as many
    as make the animation 4 seconds long, but at most 20."""
    bounce: bool = False
    """Go through the values and back again, so that the animation has no jump where it repeats."""
    label: bool = False
    """Write the name and the value on a strip below each frame."""
    edges: EdgeMode | None = None
    """What a sample sees. point: one ray; aware: the area around it. Without it what the scene's file says, or point.
    """
    transfer: ScreenTransfer = None


class Rays(shared.PictureCommand):
    """Draw the rays of one pixel from the side, and list them in a table.

    The table on stdout has one line for each ray: the parent ray at whose hit it starts, what it hits, the distance,
    the angles at the hit, and the colour that it returns. The colour in the first line is that of the pixel.

    Example: raytrace-jax rays vitreous --pixel 320 240 -o rays.svg
    """

    pixel: Annotated[tuple[int, int], arg(metavar="X Y")]
    """The pixel: its column and row, counted from the top left of the whole picture."""
    output: Annotated[Path, shared.output("OUT.svg")]
    """The drawing to write, .svg or .png. Missing folders are made."""
    least_drawn: Annotated[float | None, Wanted("a share from 0 to below 1", "SHARE", least=0, below=1)] = None
    """Draw rays that count at least this share of the pixel; the table has all. Without it 0.005 in the physical model,
    where a path splits at every surface, and 0 in the others."""
    json: shared.AsJson = False


class View(shared.PictureCommand):
    """Show a scene on a page of this machine while its numbers move: picture, derivative and rays.

    The address is printed; Ctrl-C ends it. What is first shown is compiled for up to a minute; the page counts seconds.
    With --save it is a file for a lecture's site.

    Example: raytrace-jax view glass_on_board --size 320 200 --over glass.ior=1:2.4 glass.center.x=-1:1
    """

    over: Annotated[tuple[str, ...], shared.repeatable(str, "NAME=START:STOP ...")] = ()
    """The numbers that get a slider, each with its range around the scene's value. Without it index and centre of the
    first glass ball."""
    port: Annotated[int, Wanted(metavar="N", least=0, most=2**16 - 1)] = 0
    """The port of the page; 0 takes any that is free."""
    save: Annotated[Path | None, arg(metavar="PAGE.html")] = None
    """Write one file in place of serving a page, which needs nothing but a browser: pictures made beforehand for the
    values of one or two numbers, without --over those of the glass's index, and the rays of pixels from the glass's
    middle to its rim."""
    steps: Annotated[int | None, Wanted(metavar="N", least=2, most=100)] = None
    """How many values a slider of --save has. Without it 15, or 7 of each of two."""
    edges: EdgeMode = "aware"
    """aware: pictures of areas follow those of points, and derivatives see edges move, as those of `grad`; point:
    points alone, and derivatives come ten times as fast."""


class Teach(shared.CommandOptions):
    """Draw the figures of a lecture on refraction and its derivatives, with a page that explains them.

    DIR gets a PNG of each figure and index.md with a paragraph on each. The paths are printed.

    Example: raytrace-jax teach -o lecture --only fresnel cost
    """

    output: shared.OutputFolder
    only: Annotated[tuple[LessonName, ...], shared.repeatable(LessonName, "NAME ...")] = ()
    """Draw only these. ray, snell, fresnel, critical, ball: formulas; dispersion: the colours of glass;
    total_reflection: the derivative of a square root; edges: derivative pictures with and without edges; cost: the
    error against the index."""
    also: Annotated[tuple[FigureFormat, ...], shared.repeatable(FigureFormat, "FORMAT ...")] = ()
    """Write each figure in these formats, too: svg, pdf."""
    quiet: shared.Quiet = False


class New(shared.CommandOptions):
    """Write a scene to begin with, whose comments say what has to be measured for a picture of your own.

    docs/own_picture.md goes on from there to the index.

    Example: raytrace-jax new ball -o scene.txt
    """

    scene: Annotated[Positional[Template], arg(metavar="|".join(get_args(Template)))]
    """What it shows. ball: a ball of glass before a checkered board; prism, box: a prism or a block there; tank: the
    board behind a tank of water; tube: behind a liquid in a test tube."""
    output: Annotated[Path, shared.output("SCENE")]
    """The file to write; one that is there stays."""
    liquid: Annotated[float | None, arg(name="in", metavar="INDEX")] = None
    """Ball and board lie in a liquid of this index, as 1.333, and the camera is outside."""


class FileOptions(shared.SceneOptions):
    """A scene as its file has it."""

    model: ModelName | None = None
    """The model whose defaults fill in what the file leaves out. Without it that of the file's settings, else classic.
    """


class Format(FileOptions):
    """Write a scene file in canonical form, with the same numbers.

    Example: raytrace-jax format vitreous -D vitreous.radius=2 > smaller.txt
    """


class Info(FileOptions):
    """List the blocks of a scene and its parameters, by the names that -D and --free take.

    Example: raytrace-jax info vitreous
    """

    json: shared.AsJson = False


class Scenes(shared.CommandOptions):
    """List the scenes that come with the package: every command takes their names for a SCENE.

    Example: raytrace-jax render glass_on_board -o ball.exr
    """


class Glass(shared.CommandOptions):
    """Say which glasses have an index of refraction, or what a glass has by its name.

    An index with its error, as 1.5168+-0.0003, lists the materials within three errors, nearest first. A name, as
    N-BK7, "SCHOTT N-BK7" or water, prints indices and the lines for a scene. The catalogue is that of
    refractiveindex.info, offline in the extra `glass`.

    Example: raytrace-jax glass 1.5168+-0.0003 --abbe 64+-2
    """

    what: Annotated[Positional[str], arg(metavar="INDEX+-ERROR|NAME")] = ""
    """The index with its standard deviation, or the name of a material."""
    abbe: Annotated[str | None, arg(metavar="V+-ERROR")] = None
    """Abbe's number V_d with its standard deviation, as 64+-2."""
    at: Annotated[float | None, Wanted(metavar="NM", above=0)] = None
    """The wavelength of the index, in nanometres, as 589.3 of sodium. Without it 587.56, helium's line d."""
    kind: MaterialKind | None = None
    """List materials of this kind alone."""


class Export(shared.PictureCommand):
    """Write a physical scene for POV-Ray 3.7 or for Mitsuba 3.

    The file's head has the command that renders it. The head and stderr list the features that the other program lacks
    or handles differently. Pictures of textures are written beside it, as OpenEXR.

    Example: raytrace-jax export glass_on_board --to mitsuba -o board.xml
    """

    to: Language
    """pov: POV-Ray's language; mitsuba: XML, which Mitsuba's Python reads by mitsuba.load_file."""
    output: Annotated[Path, shared.output("FILE")]
    """The file to write. Missing folders are made."""


class Import(shared.CommandOptions):
    """Read a scene of Mitsuba 3 and write it as a model.txt file.

    It reads perspective cameras; spheres and rectangles; dielectric, conductor and diffuse surfaces; area, point and
    constant emitters and environments; bitmaps and checkerboards; media that absorb. All else is listed on stderr.
    Pictures of textures are written beside the scene. Mitsuba's own parser, of the extra `mitsuba`, reads the file.

    Example: raytrace-jax import board.xml -o imported.txt
    """

    file: Annotated[Positional[Path], arg(metavar="FILE.xml")]
    """The scene of Mitsuba 3, as XML."""
    output: Annotated[Path, shared.output("SCENE")]
    """The model.txt file to write. Missing folders are made."""
    quiet: shared.Quiet = False
