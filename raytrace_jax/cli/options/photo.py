"""The options of the commands for photographs: `board`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from raytrace_jax.cli.options.shared import whole_numbers, with_running_help
from raytrace_jax.util.lengths import PaperName


@with_running_help
@dataclass(frozen=True)
class Board:
    """Make a calibration board to print or to show on a screen: OpenCV's ChArUco pattern.

    Beside BOARD.pdf or BOARD.png come BOARD.txt, the board as blocks of a scene in millimetres, and BOARD_texture.png,
    the picture that they lay on it. The paths of the three files are printed, and the board's sizes. A line of 100 mm
    on the paper shows whether the printer kept to them. It needs OpenCV: pip install 'raytrace-ior[photo]'.

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
