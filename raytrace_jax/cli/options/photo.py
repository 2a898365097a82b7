"""The options of the commands for photographs: `board`, `calibrate` and `photo`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from raytrace_jax.cli.options import AsJson, OutputFolder, Quiet, whole_numbers, with_running_help
from raytrace_jax.images.options import Transfer
from raytrace_jax.util.text import PaperName


@with_running_help
@dataclass(frozen=True)
class Board:
    """Make a calibration board to print or to show on a screen: OpenCV's ChArUco pattern.

    Beside BOARD.pdf or BOARD.png come BOARD.txt, the board as blocks of a scene in millimetres, and BOARD_texture.png,
    the picture that they lay on it. The paths of the three files are printed, and the board's sizes. A line of 100 mm
    on the paper shows whether the printer kept to them. It needs OpenCV, of the extra `photo`.

    Example: raytrace-jax board -o board.pdf --paper a3 --square 12mm
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="BOARD.pdf")]
    """The board: a PDF to print, or with --screen a PNG to show. Missing folders are made."""
    paper: PaperName | None = None
    """The paper of a PDF, which lies on its longer side. Without it a4."""
    square: Annotated[str | None, arg(metavar="LENGTH")] = None
    """The side of a square, as 10mm, 1cm or 0.4in. On a screen it becomes the nearest one of whole pixels. Without it
    10mm; on a screen the smallest from there on of which the whole screen can be full."""
    squares: Annotated[tuple[int, int] | None, whole_numbers("C R")] = None
    """How many columns and rows of squares. Without it as many as fit."""
    screen: Annotated[str | None, arg(metavar="LENGTH")] = None
    """The diagonal of the screen that will show the PNG, as 27in."""
    pixels: Annotated[tuple[int, int] | None, whole_numbers("W H")] = None
    """The screen's own width and height in pixels."""


BoardFile = Annotated[Path, arg(metavar="BOARD.txt")]
LensFile = Annotated[Path | None, arg(metavar="CAMERA.txt")]


@with_running_help
@dataclass(frozen=True)
class Calibrate:
    """Find the lens of a camera from several pictures of a board, and write it for `photo`.

    Take three pictures or more with the zoom, focus and size of the photograph, each tilted by 20 to 45 degrees to
    another side, the board large in them. The camera may be turned, if EXIF says so: the lens is as the sensor has it.
    The angle of view, k1, k2 and the principal point are printed: 39.61(12) is 39.61 with a standard deviation of 0.12.

    Example: raytrace-jax calibrate tilted*.jpg --board board.txt -o camera.txt
    """

    photos: Annotated[Positional[tuple[Path, ...]], arg(metavar="PHOTO ...")]
    """Pictures of the board, without a ball."""
    board: BoardFile
    """The board that they show, as `raytrace-jax board` writes it."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="CAMERA.txt")]
    """The lens to write. Missing folders are made."""
    transfer: Transfer | None = None
    """How the pictures' numbers were made, course (linear) or srgb. Without it what each file says; where it says
    nothing, 8 bits are srgb and more are course, which is told."""
    quiet: Quiet = False


@with_running_help
@dataclass(frozen=True)
class Photo:
    """Read the index of a glass ball off photographs of a board behind it.

    Nothing of the room has to be described. The board's markers and corners tell where the camera and the ball are; the
    corners that are seen through the ball tell its index, printed as 1.5187(11): 1.5187 with a standard deviation of
    0.0011. Several photographs by one camera of one ball, at several places, are adjusted together; those without the
    ball tell of the lens. DIR gets `located.png`, a sheet that shows each step, `located.json`, and `scene.txt`, the
    scene in the board's millimetres; of several, `located_NAME.png` and `scene_NAME.txt` each. How to take such
    photographs: docs/photograph.md. It needs OpenCV, of the extra `photo`.

    Example: raytrace-jax photo ball*.jpg --board board.txt --radius 20+-0.01mm --camera camera.txt -o result
    """

    photos: Annotated[Positional[tuple[Path, ...]], arg(metavar="PHOTO ...")]
    """The photographs, one or several."""
    board: BoardFile
    """The board that they show, as `raytrace-jax board` writes it."""
    radius: Annotated[str, arg(metavar="LENGTH+-SD")]
    """The ball's radius and how well it is known, as 20mm or 20+-0.01mm. The index depends on it: 0.1 % of the radius
    is 0.002 of the index or so."""
    output: OutputFolder
    camera: LensFile = None
    """The lens, as `raytrace-jax calibrate` writes it; it is turned as EXIF says that the camera was. Without it the
    photograph itself has to tell, with its EXIF."""
    ruler: Annotated[str | None, arg(metavar="LENGTH+-SD")] = None
    """What the ruler of 100 mm on the board measures, as 99.9+-0.05mm: printers scale. Without it the ruler
    counts as 100+-0.1mm."""
    ball: Annotated[tuple[int, int, int] | None, whole_numbers("X Y R")] = None
    """Where the ball is, if it is not found: the column and row of its middle and its radius, in pixels. Of one
    photograph."""
    fit: bool = False
    """Fit the light of one photograph too, a second opinion that takes minutes, and write the report of that fit."""
    transfer: Transfer | None = None
    """How the photograph's numbers were made, course (linear) or srgb. Without it what the file says; where it says
    nothing, 8 bits are srgb and more are course, which is told."""
    long: bool = False
    """Write estimates as 1.5187 +- 0.0011 in place of 1.5187(11), whose parentheses hold the error in the last digits;
    in the table, on the sheet and in the report of --fit."""
    json: AsJson = False
    quiet: Quiet = False
