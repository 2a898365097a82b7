"""`calibrate` and `photo`: from pictures of a board to a lens, and from a photograph of a ball to its index."""

import contextlib
import math
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float
from rich.console import Console

from raytrace_jax.cli.actions.fit import NOT_CONVERGED, print_result, provenance
from raytrace_jax.cli.console import blamed_on, print_table, print_warning, stderr_console
from raytrace_jax.cli.options.photo import Calibrate, Photo
from raytrace_jax.cli.preparation import check_folder
from raytrace_jax.cli.progress import FitProgress, Timer
from raytrace_jax.errors import PictureError
from raytrace_jax.images.exif import angle_of_view, orientation_of
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.pictures import is_photograph, read_picture, transfer_of_camera
from raytrace_jax.inverse.estimate import fit
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.photo.boards import Board, read_board
from raytrace_jax.photo.calibrate import calibrate
from raytrace_jax.photo.cameras import COUNT, FOV
from raytrace_jax.photo.find_camera import Photograph, photograph_of
from raytrace_jax.photo.flattened import Flattened, flatten
from raytrace_jax.photo.lens import read_lens, turned, uncalibrated, write_lens
from raytrace_jax.photo.locate import Located, NotLocated, locate
from raytrace_jax.photo.opinions import AGREE, apart, told
from raytrace_jax.photo.outline import Disc
from raytrace_jax.photo.room_scene import FREE, RoomScene, room_scene
from raytrace_jax.report.fit_report.folder import write_numbers, write_pictures
from raytrace_jax.report.photo_sheet import draw_photo_sheet, draw_refused
from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.scene.writer import save_scene
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.digits import with_error
from raytrace_jax.util.files import atomic_write, json_text, write_text
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import with_tolerance

RULER = 100.0
"""Millimetres of the ruler on a board."""

UNMEASURED = 0.1
"""Standard deviation of a ruler that nobody measured: printers are right to about a thousandth."""

DARK = 0.03
"""Light of a photograph's brightest hundredth, of what its file can hold, below which few steps part paper and ink."""

EXIF_IS_OFF = 0.03
"""Relative standard deviation of an angle of view by EXIF: focal lengths are rounded, and focusing changes them."""

USUALLY = {"srgb": "as cameras store 8 bits", "course": "linear, as more than 8 bits mostly are"}

LENS_WORDS = ("angle of view", "k1", "k2", "principal point, right of the middle", "below the middle")


def run_calibrate(command: Calibrate) -> int:
    """Find the lens, write it and print its numbers."""
    console = stderr_console(quiet=command.quiet)
    with jax_session(64), Timer("calibrating", console) as timer:
        board = read_board(command.board)
        photographs = list(_photographs(command.photos, command.transfer))
        found = calibrate([photograph for _, photograph in photographs], board)
        timer.took("calibrating")
    comment = f"A lens by raytrace-jax calibrate, from {len(photographs)} pictures of {command.board.name}."
    write_lens(command.output, found.lens, found.size, comment)
    errors = np.sqrt(np.diagonal(found.lens.covariance))
    rows = [
        (name, with_error(float(value), float(error)))
        for name, value, error in zip(LENS_WORDS, found.lens.mean, errors, strict=True)
    ]
    print_table("lens", ("number", "estimate"), rows)
    each = [
        (path.name, with_error(float(lens.mean[0]), float(np.sqrt(lens.covariance[0, 0]))), f"{sigma:.3f}")
        for path, lens, sigma in zip(command.photos, found.each, found.sigma, strict=True)
    ]
    print_table("each picture alone", ("picture", "angle of view", "scatter [px]"), each)
    print(command.output)
    return 0


def run_photo(command: Photo) -> int:
    """Find camera, ball and index from corners; write sheet, numbers and scene, with --fit also the report of a fit."""
    radius = _radius(command)
    check_folder(folder := command.output)
    console = stderr_console(quiet=command.quiet)
    with jax_session(64):
        with Timer("corners", console) as timer:
            board = read_board(command.board)
            ((image, photograph),) = _photographs((command.photo,), command.transfer)
            white = float(np.percentile(photograph.light, 99))
            if white < DARK:
                print_warning(
                    f"{command.photo} is underexposed: its brightest hundredth has {100 * white:.1f} % of the light "
                    "that the file can hold. The index may be off by more than its error: let paper have half."
                )
            try:
                located = _locate(command, photograph, board, radius)
            except NotLocated as reason:
                with atomic_write(folder / "located.png") as temporary:
                    draw_refused(image, reason.taken, str(reason)).savefig(temporary)
                (folder / "located.json").unlink(missing_ok=True)  # An earlier photograph's numbers are not this one's.
                raise
            flat, reason = None, None
            try:
                flat = flatten(image, located)
            except PictureError as no_light:  # The corners need no light.
                reason = no_light
            timer.took("corners")
        numbers = told(located) | {"provenance": provenance(command.photo)}
        with atomic_write(folder / "located.png") as temporary:
            draw_photo_sheet(image, located, flat, command.long).savefig(temporary)
        write_text(folder / "located.json", json_text(numbers))
        if not command.json:
            print_located(located, command.long)
        if reason and command.fit:
            raise reason
        if flat is None:
            print_warning(f"{reason} There is no scene for a fit.")
        else:
            room = room_scene(located, flat)
            save_scene(room.scene, folder / "scene.txt", model="physical")
            if command.fit:
                return _fit_light(command, located, flat, room, console)
    print(json_text(numbers) if command.json else folder, end="" if command.json else "\n")
    return 0


def _fit_light(command: Photo, located: Located, flat: Flattened, room: RoomScene, console: Console) -> int:
    """Fit the photograph's light, print what it says beside the corners, and write the report."""
    options = FitOptions(
        loss="cauchy", target_sampling="box", search=False, uncertain=room.uncertain, correlations=room.correlations
    )
    with FitProgress(scalar_names(room.scene, FREE), console) as show:
        result = fit(
            room.scene,
            flat.image,
            FREE,
            RenderSettings(crop=flat.grid.window),
            options,
            weights=flat.counts.astype(float),
            on_step=show.step,
            on_phase=show.phase,
        )
    text = write_numbers(result, command.output)
    if command.json:
        sys.stdout.write(text)
    else:
        print_result(result, command.long)
        print(command.output, flush=True)
    off = apart(located, result)
    if off > AGREE:
        print_warning(
            f"corners and light differ by {off:.1f} of their errors: look at {command.output / 'located.png'} for "
            "corners that are none, and at the report for reflections; believe neither index until you know why."
        )
    write_pictures(result, command.output, command.long)
    return 0 if result.status in ("converged", "model_incomplete") and off <= AGREE else NOT_CONVERGED


def print_located(located: Located, long: bool = False) -> None:
    """Print what the corners say, with estimates as `with_error` writes them."""
    sure = np.sqrt(np.diagonal(located.covariance))
    ball = ("center.x", "center.y", "center.z", "radius")
    places = {"index": COUNT, "angle of view": FOV} | {name: COUNT + 1 + k for k, name in enumerate(ball)}
    rows = [(name, with_error(float(located.numbers[k]), float(sure[k]), long)) for name, k in places.items()]
    print_table("from the corners (millimetres of the board, degrees)", ("number", "estimate"), rows)


def _radius(command: Photo) -> tuple[float, float]:
    """The ball's radius in the board's millimetres, and its standard deviation. Raises UsageError."""
    with blamed_on("--radius"):
        radius, error = with_tolerance(command.radius)
    with blamed_on("--ruler"):
        ruler, off = (RULER, UNMEASURED) if command.ruler is None else with_tolerance(command.ruler)
    for option, is_exact, example in (
        ("--radius", not error, "24.55+-0.01mm"),
        ("--ruler", not off, "99.93+-0.03mm"),
    ):
        if is_exact:
            print_warning(
                f"{option} has no standard deviation and counts as exact: state it as {example}, for 0.1 % of it are "
                "about 0.002 of the index."
            )
    if command.ruler is None:
        print_warning(
            f"the board's ruler was not measured and counts as {RULER:g}+-{UNMEASURED:g} mm: measure it, and state it "
            "with --ruler."
        )
    return radius * RULER / ruler, radius * RULER / ruler * math.hypot(error / radius, off / ruler)


def _photographs(
    paths: Sequence[Path], transfer: Transfer | None
) -> Iterator[tuple[Float[np.ndarray, "3 height width"], Photograph]]:
    """Read pictures that a camera took; that files do not say how their numbers were made is told once."""
    told = set()
    for path in paths:
        taken = transfer or transfer_of_camera(path)
        if taken is not None and taken not in (transfer, *told):
            told.add(taken)
            print_warning(
                f"{path} does not say how its colours were stored: read with --transfer {taken}, {USUALLY[taken]}"
                f"{', and so are others like it' if len(paths) > 1 else ''}; --transfer decides."
            )
        image = read_picture(path, transfer=taken)
        yield image, photograph_of(image, str(path), orientation_of(path))


def _locate(command: Photo, photograph: Photograph, board: Board, radius: tuple[float, float]) -> Located:
    """Find camera and ball with what is known of the lens: from a calibration, else from EXIF, else nothing."""
    ball = Disc(np.array(command.ball[:2], float), float(command.ball[2])) if command.ball else None
    if command.camera is not None:
        lens = read_lens(command.camera, photograph.size_on_sensor)
        return locate(photograph, board, radius, turned(lens, photograph.orientation, photograph.size_on_sensor), ball)
    fov = angle_of_view(command.photo) if is_photograph(command.photo) else None
    if fov is not None:
        # Nothing fits where EXIF is wrong, if the board does not outvote it.
        with contextlib.suppress(PictureError):
            located = locate(photograph, board, radius, uncalibrated(fov, EXIF_IS_OFF * fov), ball)
            if abs(located.numbers[FOV] / fov - 1) < 3 * EXIF_IS_OFF:
                return located
    located = locate(photograph, board, radius, uncalibrated(), ball)
    if fov is not None:
        seen = with_error(float(located.numbers[FOV]), float(np.sqrt(located.covariance[FOV, FOV])))
        print_warning(
            f"{command.photo}: its EXIF tells an angle of view of {fov:.4g} degrees (focal length, digital zoom), and "
            f"the board {seen}: EXIF is not believed."
        )
    return located
