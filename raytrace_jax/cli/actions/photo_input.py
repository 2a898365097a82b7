"""What `calibrate` and `photo` are given: what was measured of ball or tank, and photographs."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from ...errors import PictureError
from ...images import Transfer
from ...images.exif import camera_of, orientation_of
from ...images.pictures import read_whole_picture, transfer_of_camera
from ...photo.boards import CharucoBoard
from ...photo.bundle import Measured
from ...photo.markers import is_mirrored
from ...photo.photograph import Photograph, photograph_of
from ...util.text import quoted, value_and_deviation, with_tolerance
from ..console import UsageError, blamed_on, print_warning
from ..options.fits import Photo

UNMEASURED = "100+-0.1 mm"
"""A ruler that nobody measured: printers are right to about a thousandth."""

GLUED = "0+-0.2deg"
"""How far the walls of a tank that was glued are out of parallel, where nobody says."""


def measured_of(command: Photo) -> Measured:
    """What was measured of ball or tank, in the board's millimetres, with standard deviations. Raises UsageError."""
    if (command.radius is None) == (command.tank is None):
        raise UsageError("--radius of a ball or --tank, the thickness of a tank: one of the two is wanted.")
    for option, text in (("--wall", command.wall), ("--wedge", command.wedge)):
        if text is not None and command.tank is None:
            raise UsageError(f"{option}: is of a tank, and --tank is missing.")
    sizes = _sizes_of(command)
    if command.tank and command.wall is None:
        raise UsageError(
            "--wall: thickness and index of the tank's walls are wanted, as 3+-0.1mm,1.49; write --wall 0mm for a tank "
            "without walls. A wall of 3 mm that is left out moves the index by about 0.014."
        )
    ruler, off = sizes["--ruler"]

    def there(size: tuple[float, float]) -> tuple[float, float]:
        """A size on the board, where the ruler is 100 mm long."""
        return size[0] * 100 / ruler, math.hypot(size[1], size[0] * off / ruler) * 100 / ruler

    if command.radius is not None:
        radius = there(sizes["--radius"])
        if command.liquid is None:
            return {"radius": radius}
        # Where the surface is hardly matters, for the board lies in the liquid too: some radii above it.
        return {"radius": radius, "liquid": _index("--in", command.liquid), "depth": (5 * radius[0], 4 * radius[0])}
    measured = {"thickness": there(sizes["--tank"]), "wedge": (0.0, _wedge(command.wedge or GLUED))}
    if sizes["--wall"][0]:
        _, _, ior = str(command.wall).partition(",")
        measured |= {"wall": there(sizes["--wall"]), "wall_index": _index("--wall", ior)}
        if 2 * measured["wall"][0] >= measured["thickness"][0]:
            raise UsageError(f"--wall {command.wall}: two such walls leave no room within {command.tank}.")
    return measured


def _sizes_of(command: Photo) -> dict[str, tuple[float, float]]:
    """The lengths that were measured, by their options, in millimetres as the ruler has them."""
    wall = command.wall and command.wall.partition(",")[0]
    given = {"--radius": command.radius, "--tank": command.tank, "--wall": wall, "--ruler": command.ruler or UNMEASURED}
    sizes: dict[str, tuple[float, float]] = {}
    for option, text in given.items():
        if text is not None:
            with blamed_on(option):
                sizes[option] = with_tolerance(text, may_be_zero=option == "--wall")
    return sizes


def warn_of_unmeasured(command: Photo) -> None:
    """Tell which lengths count as exact, and that a ruler was not measured."""
    examples = {
        "--radius": "24.55+-0.01mm",
        "--tank": "60.2+-0.05mm",
        "--wall": "3+-0.1mm,1.49",
        "--ruler": "99.93+-0.03mm",
    }
    for option, (length, off) in _sizes_of(command).items():
        if length and not off:
            share = "0.1 mm" if option == "--wall" else "0.1 %"
            print_warning(
                f"{option} has no standard deviation above 0 and counts as exact: state it as {examples[option]}, for "
                f"{share} of it are about {'0.0005' if command.tank else '0.002'} of the index."
            )
    if command.ruler is None:
        print_warning(
            f"the board's ruler was not measured and counts as {UNMEASURED}: measure it, and state it with --ruler."
        )


def _wedge(text: str) -> float:
    """The standard deviation in radians of a text such as `0+-0.2deg`. Raises UsageError."""
    value, deviation = value_and_deviation(text)
    with contextlib.suppress(ValueError):
        if (
            deviation is not None
            and deviation.endswith("deg")
            and float(value) == 0
            and 0 <= (off := float(deviation[:-3])) < 10
        ):
            return math.radians(off)
    raise UsageError(
        f"--wedge: {quoted(text)} came, and a standard deviation below 10 degrees is wanted, as 0+-0.2deg."
    )


def _index(option: str, text: str) -> tuple[float, float]:
    """The index of a text such as `1.333+-0.001`, and its standard deviation, 0 if none is given. Raises UsageError."""
    value, deviation = value_and_deviation(text)
    try:
        index = float(value), float(deviation or 0)
    except ValueError:
        index = 0.0, 0.0
    if not (1 < index[0] < 5 and 0 <= index[1] < 1):
        wanted = "3+-0.1mm,1.49" if option == "--wall" else "1.333+-0.001"
        raise UsageError(f"{option}: an index above 1, and its standard deviation if it errs, is wanted, as {wanted}.")
    return index


def photographs_in(
    paths: Sequence[Path], transfer: Transfer | None, board: CharucoBoard
) -> Iterator[tuple[Float[np.ndarray, "3 height width"], Photograph]]:
    """Read pictures that a camera took, mirrored ones mirrored back.

    That files do not say how their numbers were made is told once.
    """
    told, said = set(), {}
    for path in paths:
        for word, value in camera_of(path).items():
            other, known = said.setdefault(word, (path, value))
            if known != value:
                raise PictureError(
                    f"{path}: its EXIF tells {word} as {value}, and that of {other} as {known}: one camera and one "
                    "zoom are wanted."
                )
        taken = transfer or transfer_of_camera(path)
        if taken is not None and taken not in (transfer, *told):
            told.add(taken)
            usual = "as cameras store 8 bits" if taken == "srgb" else "linear, as more than 8 bits mostly are"
            print_warning(
                f"{path} does not say how its colours were stored: read with --transfer {taken}, {usual}"
                f"{', and so are others like it' if len(paths) > 1 else ''}; --transfer decides."
            )
        image = read_whole_picture(path, transfer=taken)
        photograph = photograph_of(image, str(path), orientation_of(path))
        if is_mirrored(photograph.grey, board):
            print_warning(f"{path} is mirrored, as a front camera may save it: it was mirrored back.")
            image = image[..., ::-1]
            photograph = photograph_of(image, photograph.name, photograph.orientation)
        yield image, photograph
