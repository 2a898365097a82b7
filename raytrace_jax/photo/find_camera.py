"""A photograph's camera, from the corners of its board that are seen directly, and the lens that several tell."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple, TypeVar

import numpy as np

from ..errors import PictureError, RaytraceWarning
from ..util.digits import with_error
from .alignment import align, best_blur
from .boards import LEAST_CORNERS, CharucoBoard, opencv
from .bundle import AdjustedView, Measured, PhotoView, adjust, known_before
from .geometry import Camera, Liquid, Setup
from .lens import LensPrior, PictureSize, Turn, uncalibrated
from .markers import find_markers
from .photograph import Corners, Photograph
from .sight import Projection

Shown = TypeVar("Shown")

LARGEST_SCATTER = 3e-4
"""Corners may scatter by this fraction of the picture's width, seen directly or through the glass: half a pixel of
1600. In the rooms of `experiments/photograph` they scatter by 0.04 pixels, from a wrong start by more than one."""


@dataclass(frozen=True)
class FoundCamera(AdjustedView):
    """A camera, from what is seen directly of a board.

    Args:
        view: all its corners, also those that do not count.
        blur: standard deviation of the camera's blur, in pixels.
    """

    view: PhotoView
    blur: float


def find_camera(
    photograph: Photograph, board: CharucoBoard, lens: LensPrior, liquid: Measured = MappingProxyType({})
) -> FoundCamera:
    """The camera from what is seen directly: from markers, from refined corners, at last from patches.

    `liquid` and `depth` are told if the board lies in a liquid.

    Raises:
        PictureError: too few markers or corners of the board are seen, or they scatter too much.
    """
    # Markers are found without a start, but roughly: they choose among angles of view.
    size, corners = photograph.size, find_markers(photograph, board)
    guesses = [float(lens.mean[0])] if lens.has_fov else [20.0, 30.0, 40.0, 55.0, 70.0]
    known = known_before(lens, liquid)

    def adjusted(setup: Setup, corners: Corners):
        return adjust([PhotoView(setup, size, corners, Corners.none())], known)

    around = Liquid(liquid["liquid"][0], liquid["depth"][0]) if liquid else None
    starts = [Setup(_pose(corners, fov, lens, size), liquid=around) for fov in guesses]
    candidates = (adjusted(start, corners) for start in starts)
    setup = min(candidates, key=lambda candidate: candidate.cost).views[0].setup

    # Corners that OpenCV refines are good to a tenth of a pixel: near enough for a patch to find its place.
    for _ in range(2):
        corners = _refined(photograph, board, Projection(setup, size))
        setup = adjusted(setup, corners).views[0].setup

    # Patches, drawn with the camera's blur, measure corners to hundredths of a pixel.
    sight = Projection(setup, size)
    expected, places = sight.where(corners.places), corners.places
    some = slice(None, None, max(1, len(places) // 40))
    blur = best_blur(photograph.light, board, places[some], expected[some], sight.directly)
    corners = align(photograph.light, board, places, expected, sight.directly, blur)
    (done,) = adjusted(setup, corners).views
    largest = LARGEST_SCATTER * size[0]
    if len(corners.pixels) < LEAST_CORNERS or done.sigma[0] > largest:
        raise PictureError(
            f"{photograph.name}: {len(corners.pixels)} corners of the board are seen directly, and they scatter by "
            f"{done.sigma[0]:.2g} pixels; {LEAST_CORNERS} are wanted within {largest:.2g}: is {board.path} the "
            "board of this photograph, is it flat, and is the picture whole, as the camera took it?"
        )
    return FoundCamera(**vars(done), view=PhotoView(done.setup, size, corners, Corners.none()), blur=blur)


def _pose(corners: Corners, fov: float, lens: LensPrior, size: PictureSize) -> Camera:
    """A camera with this angle of view that sees the corners (OpenCV's `solvePnP`)."""
    cv2 = opencv()
    points, matrix = np.pad(corners.places, ((0, 0), (0, 1))), lens.camera_matrix(size, fov)
    _, turn, shift = cv2.solvePnP(points, corners.pixels, matrix, lens.opencv_distortion)
    return Camera(turn.ravel(), shift.ravel(), fov, lens.mean[1:3], lens.mean[3:])


def _refined(photograph: Photograph, board: CharucoBoard, sight: Projection) -> Corners:
    """The corners that OpenCV finds, each in a window by the size of its square."""
    cv2, expected = opencv(), sight.where(board.corners)
    steps = [sight.where(board.corners + step) - expected for step in board.square * np.eye(2)]
    sizes = np.minimum(*(np.linalg.norm(step, axis=1) for step in steps))  # The shorter side of a square, in pixels.
    # The window is 0.13 squares to each side, for a marker begins at 0.15 of its square.
    halves = np.clip(np.round(0.13 * sizes), 2, 12).astype(int)
    border = halves[:, None] + 2
    inside = ((expected > border) & (expected < np.array(photograph.size) - border - 1)).all(axis=1)
    # A square below 7 pixels, small or squashed, shows nothing but blur.
    good, found = inside & (sizes >= 7.0), np.array(expected, np.float32)
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-3)
    for half in np.unique(halves[good]):
        which = np.flatnonzero(good & (halves == half))
        start = np.ascontiguousarray(found[which].reshape(-1, 1, 2))
        window = int(half), int(half)
        found[which] = cv2.cornerSubPix(photograph.grey, start, window, (-1, -1), stop).reshape(-1, 2)
    # A refined corner that has moved by more than 0.2 squares is another one.
    good &= np.linalg.norm(found - expected, axis=1) < np.maximum(0.2 * sizes, 1.0)
    return Corners(found.astype(np.float64), board.corners, np.full(len(found), 0.1)).where(good)


class Calibrated(NamedTuple):
    """What pictures of a board say of a lens.

    Args:
        lens: its numbers, with their covariance, of pictures as the sensor has them.
        size: width and height of these.
        names: of the pictures that tell of it.
        each: the lens as each picture alone tells it, also as the sensor has it.
        sigma: the scatter of corners, in pixels, of each picture.
    """

    lens: LensPrior
    size: PictureSize
    names: tuple[str, ...]
    each: tuple[LensPrior, ...]
    sigma: tuple[float, ...]


def calibrate(photographs: Sequence[Photograph], board: CharucoBoard) -> Calibrated:
    """Find a lens from pictures of a board, each from another side, with the same camera and focus.

    They are three at least, of one size on the sensor, tilted by 20 to 45 degrees in several directions; EXIF may say
    of some that the camera was turned. A picture with too little of the board is left out.

    Warns:
        RaytraceWarning: a picture is left out, and why.

    Raises:
        PictureError: too few pictures, of several sizes, or too little of the board in too many.
    """
    # Fewer than three do not tell what all have in common from what each has of its own.
    if len(photographs) < 3:
        raise PictureError(f"{len(photographs)} pictures are too few for a calibration: 3 are wanted.")
    size = one_size(photographs)
    # Markers are found in an instant: all are looked at before the first is worked on.
    photographs = [one for one, _ in _those_that(photographs, lambda one: find_markers(one, board))]

    # The camera may be turned, and its lens, which stays the same on the sensor, is turned with it.
    def lens_of(one: Photograph) -> LensPrior:
        return Turn(size, after=one.orientation).of(uncalibrated())

    pairs = _those_that(photographs, lambda one: find_camera(one, board, lens_of(one)))
    photographs, found = zip(*pairs, strict=True)
    joint = one_lens(photographs, found, lens_of(photographs[0]))
    back = [Turn(size, before=one.orientation) for one in photographs]
    each = tuple(turn.of(camera.lens) for turn, camera in zip(back, found, strict=True))
    names, sigma = tuple(one.name for one in photographs), tuple(camera.sigma[0] for camera in joint)
    return Calibrated(back[0].of(joint[0].lens), size, names, each, sigma)


def _those_that(
    photographs: Sequence[Photograph], show: Callable[[Photograph], Shown]
) -> list[tuple[Photograph, Shown]]:
    """The photographs that `show` refuses not, with what it returns.

    Raises PictureError with all reasons where fewer than three are left; else each that is left out is a warning.
    """
    shown, reasons = [], list[str]()
    for one in photographs:
        try:
            shown.append((one, show(one)))
        except PictureError as reason:
            reasons.append(str(reason))
    if len(shown) < 3:
        left = f"{len(shown)} of {len(photographs)} pictures are left for a calibration: 3 are wanted."
        raise PictureError("\n".join([*dict.fromkeys(reasons), left]))
    for reason in reasons:
        warnings.warn(f"{reason} It is left out.", RaytraceWarning, stacklevel=3)
    return shown


def one_size(photographs: Sequence[Photograph]) -> PictureSize:
    """The size that all photographs have on the sensor. Raises PictureError where they differ."""
    size = photographs[0].size_on_sensor
    for one in photographs:
        if one.size_on_sensor != size:
            width, height = one.size_on_sensor
            raise PictureError(
                f"{one.name} has {width} x {height} pixels on the sensor and {photographs[0].name} {size[0]} x "
                f"{size[1]}: one camera, one zoom and one size are wanted; of a picture that was turned EXIF has to "
                "say so, as cameras write it."
            )
    return size


def one_lens(photographs: Sequence[Photograph], found: Sequence[FoundCamera], lens: LensPrior) -> list[FoundCamera]:
    """The cameras of photographs adjusted together; `lens` is what is known of it before, as the first one has it.

    Where the pictures alone differ by more than their errors, for boards bend, the errors are made as much larger
    (Birge's ratio, 1932).

    Raises:
        PictureError: the angle of view of one is not that of the others; the message names it.
    """
    first = photographs[0]
    views = [camera.view._replace(turn=first.turn_to(one)) for camera, one in zip(found, photographs, strict=True)]
    seen = adjust(views, known_before(lens)).views
    pairs = list(zip(found, seen, strict=True))
    apart = [camera.lens.mean - one.lens.mean for camera, one in pairs]
    # One of another zoom moves what all say: the median of what each says stays.
    shares = np.array([camera.lens.mean[0] / one.setup.camera.fov for camera, one in pairs])
    for photograph, camera, share in zip(photographs, found, shares / np.median(shares), strict=True):
        fov, error = camera.lens.mean[0], camera.lens.errors[0]
        if abs(share - 1) > max(0.01, 8 * error / fov):
            raise PictureError(
                f"{photograph.name}: it tells an angle of view of {with_error(fov, error)} degrees, and others one of "
                f"{fov / share:.4g}: one camera, one zoom and one focus are wanted."
            )
    squares = [float(off @ np.linalg.pinv(one.lens.covariance) @ off) for one, off in zip(found, apart, strict=True)]
    birge = max(1.0, sum(squares) / (len(lens.mean) * max(len(found) - 1, 1)))
    return [
        FoundCamera(
            **(vars(one) | {"covariance": birge * one.covariance, "blur": camera.blur}),
            view=camera.view._replace(setup=one.setup),
        )
        for camera, one in pairs
    ]
