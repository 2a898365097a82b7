"""The command `board`: a calibration board to print or to show, and the same board as a part of a scene."""

import math
from pathlib import Path

import numpy as np
from PIL import Image

from ...errors import RaytraceError
from ...photo.boards import LEAST_CORNERS, Pattern, opencv
from ...report import board_sheet
from ...scene.schema import is_name
from ...util.files import atomic_write, write_text
from ...util.text import millimetres, quoted
from ..console import UsageError, blamed_on, print_warning
from ..options.fits import Board
from ..preparation import check_picture_path

SQUARE = 10.0  # Millimetres, unless the user says otherwise.


def run_board(command: Board) -> None:
    check_picture_path(command.output, (".pdf", ".png"), "a board")
    blocks, texture = command.output.with_suffix(".txt"), command.output.with_name(f"{command.output.stem}_texture.png")
    _check_options(command, texture.name)
    opencv("`board`")
    square = _length("--square", command.square) if command.square else None
    pattern, where = (_show if command.screen else _print)(command, square)
    corners = (pattern.columns - 1) * (pattern.rows - 1)
    if corners < LEAST_CORNERS:
        print_warning(
            f"{pattern.columns} x {pattern.rows} squares have {corners} corners between them, and `calibrate` and "
            f"`photo` want {LEAST_CORNERS}, as 6 x 5 have."
        )
    _write_grey(texture, board_sheet.pattern_picture(pattern))
    write_text(blocks, board_sheet.board_blocks(pattern, texture.name, where))
    print(command.output, blocks, texture, f"{board_sheet.size_words(pattern)}, on {where}", sep="\n")


def _check_options(command: Board, texture: str) -> None:
    """Refuse options that do not belong together, and names that no scene's file can say. Raises UsageError."""
    is_png = command.output.suffix.lower() == ".png"
    if is_png and not (command.screen and command.pixels):
        raise UsageError(
            f"{command.output}: a PNG is for a screen, and --screen and --pixels say how large it is, as "
            "--screen 27in --pixels 2560 1440; a board to print is a .pdf."
        )
    if is_png and command.paper:
        raise UsageError(f"--paper is for a board to print, a .pdf, and {command.output} is for a screen.")
    if not is_png and (command.screen or command.pixels):
        raise UsageError(f"--screen and --pixels are for a board on a screen, a .png; {command.output} is to print.")
    if not is_name(texture):
        raise UsageError(f"{quoted(texture)}: the scene's file names this picture, and there a name is one word.")


def _print(command: Board, square: float | None) -> tuple[Pattern, str]:
    """Write the PDF; return the board and what it is on."""
    paper, square = command.paper or "a4", square or SQUARE
    where, room = board_sheet.paper_words(paper), board_sheet.paper_room(paper)
    with blamed_on("--square, --squares"):
        pattern = Pattern(*board_sheet.squares_within(room, square, command.squares, f"{where} with a margin"), square)
    figure = board_sheet.draw_sheet(pattern, paper)
    with atomic_write(command.output) as temporary:
        # Without a date in it the same board makes the same file.
        metadata = {"CreationDate": None, "Title": board_sheet.sheet_words(pattern, paper)}
        figure.savefig(temporary, format="pdf", metadata=metadata)
    return pattern, where


def _show(command: Board, square: float | None) -> tuple[Pattern, str]:
    """Write the PNG; return the board and what it is on."""
    assert command.screen and command.pixels  # `_check_options` has seen to it.
    if min(command.pixels) < 1:
        raise UsageError(f"--pixels {command.pixels[0]} {command.pixels[1]}: whole numbers greater than 0 are wanted.")
    pitch = _length("--screen", command.screen) / math.hypot(*command.pixels)
    with blamed_on("--square, --squares"):
        pattern, scale = _screen_pattern(command.pixels, pitch, square, command.squares)
    _write_grey(command.output, board_sheet.screen_picture(pattern, command.pixels, scale))
    size = f"{command.pixels[0]} x {command.pixels[1]} pixels"
    return pattern, f"a screen of {command.screen} with {size}, {scale * pattern.lattice} a square"


def _screen_pattern(
    pixels: tuple[int, int], pitch: float, wanted: float | None, squares: tuple[int, int] | None
) -> tuple[Pattern, int]:
    """The board for a screen, whose pixels are `pitch` millimetres apart, and the pixels of a cell of its lattice.

    A square is about as large as `wanted`, in millimetres; without that as small as it can be from `SQUARE` on without
    more markers than there are. Without `squares`, columns and rows, there are as many as fit.
    """
    lattice = Pattern(2, 2, SQUARE).lattice
    exact = (wanted or SQUARE) / (pitch * lattice)
    scale = max(1, round(exact) if wanted else math.ceil(exact - 1e-9))
    while True:
        side = scale * lattice
        where = f"a screen of {pixels[0]} x {pixels[1]} pixels, with {side} pixels a square and a margin,"
        # Half of a square stays white all around.
        count = board_sheet.squares_within((pixels[0] - side, pixels[1] - side), side, squares, where)
        try:
            return Pattern(*count, side * pitch), scale
        except RaytraceError:
            if wanted or squares:
                raise
        scale += 1


def _length(option: str, text: str) -> float:
    with blamed_on(option):
        return millimetres(text)


def _write_grey(path: Path, picture: np.ndarray) -> None:
    with atomic_write(path) as temporary:
        Image.fromarray(picture).save(temporary, format="PNG")
