"""The options of the commands that measure: `fit`, `batch`, `board`, `calibrate` and `photo`."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated, NamedTuple, TypeVar, get_args

from tyro.conf import Positional, arg

from ...images import Clipped, Transfer
from ...inverse.options import FitOptions
from ...util.checked import Wanted, field_texts
from ...util.text import PaperName, did_you_mean, listed, parse_number, value_and_deviation
from .. import options as shared
from ..console import UsageError

T = TypeVar("T")

Length = Annotated[str | None, arg(metavar="LENGTH")]
MeasuredLength = Annotated[str | None, arg(metavar="LENGTH+-SD")]

FIT_TEXTS = field_texts(FitOptions)
"""The help of options that the command line takes as texts, by the names of what is made of these."""


def by_name(option: str, texts: tuple[str, ...], form: str, read: Callable[[str], T]) -> dict[str, T]:
    """What `read` makes of the values of an option's `NAME=VALUE` texts, by name."""
    found: dict[str, T] = {}
    for text in texts:
        name, value = shared.split_assignment(option, text, form, read)
        if name in found:
            raise UsageError(f"--{option} {name} is given twice.")
        found[name] = value
    return found


def by_camera(what: str, texts: Sequence[str], cameras: Sequence[str], common: bool = True) -> dict[str, str]:
    """What `CAMERA=VALUE` texts say of a scene's cameras; the camera need not be named where there is one.

    Args:
        what: the option, or the kind of word, for a refusal.
        common: a text that names no camera is of all.
    """
    found: dict[str, str] = {}
    for text in texts:
        name, equals, value = text.partition("=")
        # The name of a file may have an equals sign.
        if not (equals and name in cameras):
            if len(cameras) > 1 and not common:
                guess = did_you_mean(name, cameras) if equals else ""
                raise UsageError(
                    f"{what} {text}: it has to say which camera has seen it, as {cameras[0]}={value or text}.{guess} "
                    f"The scene's cameras are {listed(cameras)}; --camera NAME takes one alone."
                )
            name, value = "", text
        for camera in [name] if name else cameras:
            if camera in found:
                raise UsageError(f"{what}: {found[camera]} and {value} are both given for the camera {camera}.")
            found[camera] = value
    return found


class TargetFile(NamedTuple):
    """A target, and how it is read."""

    path: Path
    mask: Path | None
    transfer: Transfer | None
    layer: str | None


TRANSFERS: dict[str, Transfer] = {name: name for name in get_args(Transfer)}


def read_prior(text: str) -> tuple[float, float]:
    """The mean and the standard deviation in `2.3+-0.01`."""
    mean, deviation = value_and_deviation(text)
    return parse_number(mean.strip()), parse_number((deviation or "").strip())


def read_uncertain(text: str) -> str:
    """A standard deviation as it stands, as 0.1% or 0.002, if it is a number."""
    parse_number(text.removesuffix("%").strip())
    return text


class FitArguments(
    shared.CommandOptions, FitOptions, hidden=("correlations", "ties", "priors", "uncertain", "profiles")
):
    """How the fit is set up and solved."""


class Fit(shared.PictureCommand):
    """Fit parameters of a scene to a picture, and say how sure they are.

    The search for starts begins at SCENE with its -D values. A scene of several cameras is fitted to a picture of each,
    as `fit SCENE left=a.exr right=b.exr`. The folder gets result.json, report.html, report.png,
    the fitted scene fit.txt, its picture fit.exr and residual.exr, fit minus target; for a paper also
    estimates.csv, estimates.tex and methods.txt. A residual of n/255 is a difference of n in linear light, of which
    white is 255; rms is the root of its mean square, typical comes from its median. A level is one picture of a series
    from blurred to sharp. The last line says how it ended: converged, model_incomplete, ambiguous, degenerate,
    not_converged or interrupted; the exit code is 3 for all but the first. That line also names the assumption on
    which the estimate depends most.
    Ctrl-C stops the fit and still writes the values reached so far.

    Example: raytrace-jax fit guess.txt photo.exr --free glass.ior glass.center -o result
    """

    target: Annotated[Positional[tuple[str, ...]], arg(metavar="TARGET ...")]
    """The picture to explain, OpenEXR, PNG, JPEG, TIFF, PPM or Radiance HDR, of the size that is rendered; with --crop
    also the whole picture. Of several cameras one each, as left=a.exr right=b.exr."""
    free: shared.Names
    """The parameters to find, as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: shared.OutputFolder
    mask: Annotated[tuple[str, ...], shared.repeatable(str, "[CAMERA=]FILE")] = ()
    """Weights of the target's pixels, a picture of the same formats: 0 leaves a pixel out, 1 counts in full. A painted
    one counts where it is bright and opaque."""
    clipped: Clipped = "auto"
    """What becomes of pixels with a channel at 0 or the largest number that the target's file can store. drop: no
    weight; keep: they count; auto: drop those of a JPEG or TIFF, and physical light too bright for a PNG.
    """
    transfer: Annotated[tuple[str, ...], shared.repeatable(str, "[CAMERA=]{course,srgb}")] = ()
    """How the colours of a PNG target were stored. course: floor(255 * C), no gamma; srgb: as screens expect. Without
    it what the file says; if it says nothing, whichever is clearly nearer to the picture at the start."""
    layer: Annotated[tuple[str, ...], shared.repeatable(str, "[CAMERA=]NAME")] = ()
    """Which layer of an OpenEXR target, when it is not obvious."""
    long: bool = False
    """Write estimates as 1.337 +- 0.002 in place of 1.337(2), whose parentheses hold the error in the last digits; in
    the table and in the report."""
    pdf: bool = False
    """Write the report's figure as report.pdf, too, for a paper."""
    report: bool = True
    """Write the whole report; without it result.json, fit.txt and result.npz alone, which a script reads."""
    json: bool = False
    """Print one JSON object on stdout, the content of result.json, in place of the table and the last line."""
    verbose: shared.Verbose = False
    tie: Annotated[tuple[str, ...], shared.repeatable(str, "NAME=FREE", FIT_TEXTS["ties"])] = ()
    prior: Annotated[tuple[str, ...], shared.repeatable(str, "NAME=MEAN+-SD", FIT_TEXTS["priors"])] = ()
    uncertain: Annotated[tuple[str, ...], shared.repeatable(str, "NAME=SD", FIT_TEXTS["uncertain"])] = ()
    profile: Annotated[tuple[str, ...], shared.repeatable(str, "NAME ...", FIT_TEXTS["profiles"])] = ()
    fit: FitArguments = FitArguments()

    def files(self, cameras: Sequence[str]) -> dict[str, TargetFile]:
        """The targets by the scene's cameras.

        Raises:
            UsageError: two of one camera, one of which it is unclear what has seen it, or an unknown transfer.
        """
        targets = by_camera("the target", self.target, cameras, common=False)
        masks, transfers, layers = (
            by_camera(f"--{name}", getattr(self, name), cameras) for name in ("mask", "transfer", "layer")
        )
        if unknown := [text for text in transfers.values() if text not in TRANSFERS]:
            raise UsageError(f"--transfer {unknown[0]}: {' or '.join(TRANSFERS)} is wanted.")
        return {
            name: TargetFile(
                Path(path),
                Path(masks[name]) if name in masks else None,
                TRANSFERS[transfers[name]] if name in transfers else None,
                layers.get(name),
            )
            for name, path in targets.items()
        }

    def fit_options(self) -> FitOptions:
        """All options of the fit. Raises UsageError where a text is not written as its option wants it."""
        form = "NAME=SD or NAME=SHARE%, as vitreous.radius=0.002 or cam1=0.1%"
        changes = {
            "ties": by_name("tie", self.tie, "NAME=FREE, as cyan.ior=vitreous.ior", str),
            "priors": by_name("prior", self.prior, "NAME=MEAN+-SD, as vitreous.radius=2.3+-0.01", read_prior),
            "uncertain": by_name("uncertain", self.uncertain, form, read_uncertain),
            "profiles": self.profile,
        }
        return FitOptions(**vars(self.fit) | changes)


class Batch(shared.CommandOptions):
    """Run the many renders, derivatives and fits of a plan, and gather them in a table.

    PLAN.toml names scenes, grids and lists of parameters, noise and seeds (docs/batch.md describes it). DIR gets a
    folder of files for each kind of job, results.csv and index.html, a page with all jobs, their pictures, and plots of
    what each axis of the plan does. After Ctrl-C, a kill or a failure the same command goes on: finished jobs are not
    run again. The exit code is 1 if a job failed; the table says which one and why.

    Example: raytrace-jax batch plan.toml -o results --workers 2
    """

    plan: Annotated[Positional[Path], arg(metavar="PLAN.toml")]
    """The plan, a TOML file."""
    output: shared.OutputFolder
    workers: Annotated[int | None, Wanted(metavar="N", least=1)] = None
    """Share the jobs out to N processes on this machine, one core each. Needs the extra `batch`."""
    scheduler: Annotated[str | None, arg(metavar="ADDRESS")] = None
    """Share the jobs out to the workers of this dask scheduler, as tcp://10.0.0.1:8786. They must see DIR, and the
    plan's targets, under the same paths. Needs the extra `batch`."""
    json: shared.AsJson = False
    quiet: shared.Quiet = False


class Board(shared.CommandOptions):
    """Make a calibration board to print or to show on a screen: OpenCV's ChArUco pattern.

    Beside BOARD.pdf or BOARD.png come BOARD.txt, the board as blocks of a scene in millimetres, and BOARD_texture.png,
    the picture on it. The paths are printed, and the board's sizes; a line of 100 mm on the paper shows whether the
    printer kept to them. It needs OpenCV, of the extra `photo`.

    Example: raytrace-jax board -o board.pdf --paper a3 --square 12mm
    """

    output: Annotated[Path, shared.output("BOARD.pdf")]
    """The board: a PDF to print, or with --screen a PNG to show. Missing folders are made."""
    paper: PaperName | None = None
    """The paper of a PDF, which lies on its longer side. Without it a4."""
    square: Length = None
    """The side of a square, as 10mm, 1cm or 0.4in; on a screen the nearest of whole pixels. Without it 10mm, on a
    screen the smallest from there on that can fill it."""
    squares: Annotated[tuple[int, int] | None, arg(metavar="C R")] = None
    """How many columns and rows of squares. Without it as many as fit."""
    screen: Length = None
    """The diagonal of the screen that will show the PNG, as 27in."""
    pixels: Annotated[tuple[int, int] | None, arg(metavar="W H")] = None
    """The screen's own width and height in pixels."""


Photos = Annotated[Positional[tuple[Path, ...]], arg(metavar="PHOTO ...")]


class PhotoOptions(shared.CommandOptions):
    """Photographs of a board."""

    photos: Photos
    """The photographs, one or several."""
    board: Annotated[Path, arg(metavar="BOARD.txt")]
    """The board that they show, as `raytrace-jax board` writes it."""
    transfer: Transfer | None = None
    """How the photographs' numbers were made, course (linear) or srgb. Without it what each file says; where it says
    nothing, 8 bits are srgb and more are course, and a warning says so."""
    quiet: shared.Quiet = False


class Calibrate(PhotoOptions):
    """Find the lens of a camera from several pictures of a board without a ball, and write it for `photo`.

    Take three pictures or more with the zoom, focus and size of the photograph, each tilted by 20 to 45 degrees to
    another side, the board large in them; those with too little of the board are left out. The camera may be turned, if
    EXIF says so: the lens is as the sensor has it. The angle of view, k1, k2 and the principal point are printed:
    39.61(12) is 39.61 with a standard deviation of 0.12. It needs OpenCV, of the extra `photo`.

    Example: raytrace-jax calibrate tilted*.jpg --board board.txt -o camera.txt
    """

    photos: Photos
    """The pictures of the board, three or more."""
    output: Annotated[Path, shared.output("CAMERA.txt")]
    """The lens to write. Missing folders are made."""


class Photo(PhotoOptions):
    """Read the index of a glass ball, or of a liquid in a tank, off photographs of a board behind it.

    Nothing of the room has to be described. The board's markers and corners tell where the camera and the ball are; the
    corners that are seen through the ball tell its index, printed as 1.5187(11): 1.5187 with a standard deviation of
    0.0011. A tank with flat parallel walls hides a part of the board; what is seen beside it tells where the camera is.
    Several photographs by one camera of one ball or one tank are adjusted together; those without it tell of the lens.
    DIR gets `located.png`, a sheet that shows each step, `located.json`, and `scene.txt`, the scene in the board's
    millimetres; of several, `located_NAME.png` and `scene_NAME.txt` each. How to take such photographs:
    docs/photograph.md. It needs OpenCV, of the extra `photo`.

    Example: raytrace-jax photo ball*.jpg --board board.txt --radius 20+-0.01mm --camera camera.txt -o result

    Example: raytrace-jax photo tank.jpg --board board.txt --tank 60+-0.1mm --wall 3+-0.1mm,1.49 -o result
    """

    radius: MeasuredLength = None
    """The ball's radius and how well it is known, as 20mm or 20+-0.01mm. The index depends on it: 0.1 % of the radius
    is 0.002 of the index or so."""
    liquid: Annotated[str | None, arg(name="in", metavar="INDEX+-SD")] = None
    """The index of a liquid in which ball and board lie, as 1.333+-0.001. The camera is outside, and the surface of the
    liquid is flat and parallel to the board. Of one photograph."""
    tank: MeasuredLength = None
    """In place of a radius the thickness of a tank, from the outside of one wall to that of the other, as 60+-0.1mm."""
    wall: Annotated[str | None, arg(metavar="LENGTH+-SD,INDEX")] = None
    """Thickness and index of each of the tank's walls, as 3+-0.05mm,1.49; 0mm is a tank without walls. It is wanted
    with --tank, for a wall of 3 mm that is left out moves the index by 0.014."""
    wedge: Annotated[str | None, arg(metavar="0+-SDdeg")] = None
    """How far the tank's walls may be out of parallel, about each of two axes: a standard deviation in degrees. Without
    it 0+-0.2deg counts; 0+-0deg says that they are parallel."""
    output: shared.OutputFolder
    camera: Annotated[Path | None, arg(metavar="CAMERA.txt")] = None
    """The lens, as `raytrace-jax calibrate` writes it; it is turned as EXIF says that the camera was. Without it the
    photograph itself has to tell, with its EXIF."""
    ruler: MeasuredLength = None
    """What the ruler of 100 mm on the board measures, as 99.9+-0.05mm: printers scale. Without it the ruler
    counts as 100+-0.1mm."""
    wavelengths: Annotated[str | None, arg(metavar="R+-SD,G+-SD,B+-SD")] = None
    """The mean wavelengths of the sensor's red, green and blue in nanometres, with standard deviations; without it
    those of usual sensors in daylight, 600+-8,540+-8,460+-8. Of a lamp or screen of one colour its own, as 589."""
    ball: Annotated[tuple[int, int, int] | None, arg(metavar="X Y R")] = None
    """Where the ball is, if it is not found: the column and row of its middle and its radius, in pixels. Of one
    photograph."""
    fit: bool = False
    """Fit the photographs' light too, a second opinion that takes minutes, and write the report of that fit."""
    long: bool = False
    """Write estimates as 1.5187 +- 0.0011 in place of 1.5187(11), whose parentheses hold the error in the last digits;
    in the table, on the sheet and in the report of --fit."""
    json: shared.AsJson = False
    verbose: shared.Verbose = False
