"""From photographs of a board behind a ball of glass, or a tank of liquid, to their cameras and the index."""

import contextlib
import dataclasses
import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from ..errors import PictureError
from ..util.digits import Measurement, with_error
from .alignment import align
from .boards import CharucoBoard, Quads
from .bundle import Adjusted, AdjustedView, Measured, PhotoView, Prior, adjust, known_before
from .find_ball import find_ball
from .find_camera import LARGEST_SCATTER, FoundCamera, find_camera, one_lens, one_size
from .geometry import LENS, Ball, Setup, Tank
from .lens import LensPrior, PictureSize
from .markers import Layers, layers_of, markers_in
from .outline import Disc, NothingThrough, find_discs
from .photograph import Corners, Photograph
from .sight import Projection

LIQUIDS = 1.2, 2.2
"""No liquid that stands in a tank has an index outside of these: perfluorohexane has 1.25, melted sulphur 1.9."""

LEAST_SQUARE = 4.0
"""Least pixels of a square's shorter side, seen through the glass; a patch of a smaller one is a blur."""


@dataclass(frozen=True)
class Located(AdjustedView):
    """What the corners in a photograph say, with the covariance from all photographs that were adjusted together.

    Args:
        board: what it shows.
        size: width and height of the photograph.
        blur: standard deviation of the camera's blur, in pixels.
    """

    board: CharucoBoard
    size: PictureSize
    blur: float

    @property
    def sight(self) -> Projection:
        """What the photograph's pixels see."""
        return Projection(self.setup, self.size)


@dataclass
class PhotoResult:
    """What one photograph tells, with the intermediate detections, for the sheet of a photograph that is refused.

    Args:
        photograph: which one.
        markers: the corners of each that was decoded, if the photograph tells no index.
        direct, through: corners of the board that were looked for directly, and through the glass.
        discs: where the ball may be, the likeliest one first.
        blur: standard deviation of the camera's blur in pixels, 0 where that is not known.
        camera: from what is seen of the board beside the glass.
        layers: the board in two parts, if there is a tank.
        alone: all numbers, with the lens of all photographs and the corners of this one alone.
        located: the numbers and the covariance that follow from all photographs.
        reason: why it tells no index.
        is_bare: whether that is because nothing is seen through any glass: it may still tell of the lens.
    """

    photograph: Photograph
    markers: Quads = field(default_factory=lambda: np.zeros((0, 4, 2)))
    direct: Corners = field(default_factory=Corners.none)
    through: Corners = field(default_factory=Corners.none)
    discs: list[Disc] = field(default_factory=list)
    blur: float = 0.0
    camera: FoundCamera | None = None
    layers: Layers | None = None
    alone: Adjusted | None = None
    located: Located | None = None
    reason: str = ""
    is_bare: bool = False

    @property
    def view(self) -> PhotoView:
        """The photograph in an adjustment, with what it tells alone."""
        assert self.camera is not None, "a camera is found"
        view = self.camera.view
        return view._replace(setup=self.alone.views[0].setup, through=self.through) if self.alone else view

    @property
    def index_alone(self) -> Measurement:
        """The index that this photograph tells alone, and its standard deviation."""
        assert self.alone is not None, "its corners are measured"
        return self.alone.views[0].ior

    def refuse(self, error: PictureError, board: CharucoBoard) -> None:
        """Keep why no index is told, with where the ball was taken to be."""
        self.markers, _ = markers_in(self.photograph.grey, board.dictionary)
        self.reason, self.is_bare = str(error), isinstance(error, NothingThrough)
        if self.discs:
            likely = "Several discs may be the ball, the clearest is" if self.discs[1:] else "The ball was taken to be"
            self.reason += f" {likely} at {self.discs[0]}; --ball X Y R says where it is."
        if self.blur > 1.5:
            pixels = f"{2.4 * self.blur:.0f} pixels"
            self.reason += f" The picture is blurred by about {pixels}: hold the camera still, and focus."


class Together(NamedTuple):
    """What photographs of one ball or tank say together.

    Args:
        photographs: what each tells, in their order.
        adjusted: the numbers of all in `located`, then of those that are bare, with their covariance; None without a
            ball or a tank.
    """

    photographs: list[PhotoResult]
    adjusted: Adjusted | None

    @property
    def located(self) -> list[Located]:
        """Those that show the ball or the tank."""
        return [result.located for result in self.photographs if result.located]


def locate_together(
    photographs: Sequence[Photograph],
    board: CharucoBoard,
    measured: Measured,
    lens: LensPrior,
    ball: Disc | None = None,
) -> Together:
    """Find cameras and ball or tank from the board's corners, seen directly and through it.

    Each photograph is measured on its own. Then all corners are adjusted together: lens, index and what was measured
    are common, and what is known of these before counts once. Where there are several photographs, one without a ball
    or a tank tells of the lens.

    Args:
        photographs: by one camera, of one ball or one tank.
        board: what they show.
        measured: of the ball its `radius`, and the index of the `liquid` in which it and the board lie, with about the
            latter's `depth`; of the tank `thickness`, `wall` and `wall_index`; each with its standard deviation, in the
            board's unit.
        lens: what is known of the camera, as the first photograph has it.
        ball: its outline, if that is known.

    Returns:
        What each says, and all together; photographs that tell no index are told with what to do.

    Raises:
        PictureError: the photographs are not by one camera.
    """
    one_size(photographs)
    first, results = photographs[0], [PhotoResult(photograph) for photograph in photographs]
    several = len(results) > 1

    # The cameras follow from the board beside the ball or the tank, and all tell of one lens.
    for result in results:
        try:
            _find_camera(result, board, measured, first.turn_to(result.photograph).of(lens), several)
        except PictureError as error:
            result.refuse(error, board)
    cameras = {k: result.camera for k, result in enumerate(results) if result.camera}
    shared = lens
    if several and cameras:
        pictures = [photographs[k] for k in cameras]
        joint_cameras = one_lens(pictures, list(cameras.values()), first.turn_to(pictures[0]).of(lens))
        cameras = dict(zip(cameras, joint_cameras, strict=True))
        shared = pictures[0].turn_to(first).of(joint_cameras[0].lens)

    # The corners through the glass follow photograph by photograph.
    for k, camera in cameras.items():
        result = results[k]
        result.camera = camera
        if not result.reason:
            try:
                _look_through(result, camera, board, measured, first.turn_to(result.photograph).of(shared), ball)
            except PictureError as error:
                result.refuse(error, board)
    read = [result for result in results if result.alone]
    if not read:
        if asked := _other_size(results, cameras, board, measured, ball):
            for k in cameras:
                results[k].reason += f" {asked}"
        return Together(results, None)

    # The last adjustment is of all; that of a single photograph is all there is.
    bare, leading = [results[k] for k in cameras if results[k].is_bare], read[0].photograph
    joint = next(result.alone for result in read if result.alone)
    if len(read) + len(bare) > 1:
        turned = [result.view._replace(turn=leading.turn_to(result.photograph)) for result in [*read, *bare]]
        joint = adjust(turned, known_before(first.turn_to(leading).of(lens), measured))
    for result, view in zip(read, joint.views, strict=False):
        result.located = Located(**vars(view), board=board, size=result.photograph.size, blur=result.blur)
    return Together(results, joint)


def _find_camera(result: PhotoResult, board: CharucoBoard, measured: Measured, lens: LensPrior, several: bool) -> None:
    """Find a photograph's camera, and the board's two parts if there is a tank."""
    beside = board
    if "thickness" in measured:
        try:
            result.layers = layers_of(result.photograph, board, lens)
            beside = result.layers.direct
        except NothingThrough as error:
            if not several:
                raise
            result.refuse(error, board)
    liquid = {name: measured[name] for name in ("liquid", "depth") if name in measured}
    result.camera = find_camera(result.photograph, beside, lens, liquid)


def _other_size(
    results: Sequence[PhotoResult],
    cameras: dict[int, FoundCamera],
    board: CharucoBoard,
    measured: Measured,
    ball: Disc | None,
) -> str | None:
    """Ask about a radius, or a thickness, with which a photograph would tell an index, where the stated one fails."""
    name, what, mistake, factors = "radius", "ball", "another unit or a diameter", (0.5, 2, 0.1, 10)
    if "thickness" in measured:
        name, what, mistake, factors = "thickness", "tank", "another unit", (0.1, 10, 0.5, 2)
    ways = {0.5: f"half of that {name}", 2: f"twice that {name}", 0.1: f"a tenth of that {name}", 10: "ten times that"}
    least = 2 * measured.get("wall", (0.0, 0.0))[0]
    for (k, camera), factor in itertools.product(cameras.items(), factors):
        trial, size = PhotoResult(results[k].photograph, layers=results[k].layers), factor * measured[name][0]
        if size > least and (trial.layers or name == "radius"):
            with contextlib.suppress(PictureError):
                _look_through(trial, camera, board, {**measured, name: (size, 0.0)}, camera.lens, ball)
                return (
                    f"With {ways[factor]}, {size:.3g} mm, the board is seen through the {what}: was {mistake} stated?"
                )
    return None


def _look_through(
    result: PhotoResult,
    camera: FoundCamera,
    board: CharucoBoard,
    measured: Measured,
    lens: LensPrior,
    ball: Disc | None,
) -> None:
    """Measure a photograph's corners through ball or tank, and adjust what is seen to them and to those beside it."""
    known = known_before(lens, measured)
    result.direct, result.blur = camera.view.direct, camera.blur
    if result.layers:
        view, board = _before_tank(camera, result.layers, measured, known), result.layers.through
    else:
        view = _before_ball(result, camera.view, board, measured["radius"][0], ball)
    _measure(result, board, view, known)


def _before_ball(
    result: PhotoResult, view: PhotoView, board: CharucoBoard, radius: float, ball: Disc | None
) -> PhotoView:
    """A photograph's camera, and the ball where the board is hidden."""
    photograph = result.photograph
    setup = dataclasses.replace(view.setup, glass=Ball(radius=radius))
    result.discs = [ball] if ball else find_discs(photograph, board, setup, result.blur)
    setup = find_ball(photograph, board, setup, result.blur, result.discs)
    result.discs = [disc := Disc(*Projection(setup, photograph.size).outline)]
    if np.any(disc.center - disc.radius < 0) or np.any(disc.center + disc.radius > np.array(photograph.size)):
        raise PictureError(f"{photograph.name}: the ball reaches beyond the picture's border: photograph all of it.")
    return view._replace(setup=setup)


def _before_tank(camera: FoundCamera, layers: Layers, measured: Measured, known: Prior) -> PhotoView:
    """A photograph's camera, and the tank as the markers that are seen through it tell."""
    setup = Setup(camera.view.setup.camera, Tank(1.4, **{name: value for name, (value, _) in measured.items()}))
    # The thickness is that in the middle of what is seen through the tank.
    vector, center = setup.vector, setup.places("center")
    vector[center] = [*layers.seen.places.mean(axis=0), known.mean[center[2]]]
    view = camera.view._replace(setup=setup.at(vector), through=layers.seen)
    return view._replace(setup=adjust([view], known).views[0].setup)


def _measure(result: PhotoResult, board: CharucoBoard, view: PhotoView, known: Prior) -> None:
    """Measure a photograph's corners, and adjust all to them."""
    # All is adjusted together to the corners seen directly and through ball or tank. A better estimate says better
    # where these are, so that each round finds more of them.
    photograph, adjusted = result.photograph, None
    is_tank, what = (True, "tank") if isinstance(view.setup.glass, Tank) else (False, "ball")
    numbers = Setup(view.setup.camera, view.setup.glass).numbers
    moving = [k for k, number in enumerate(numbers) if number.is_result and k > LENS[-1]]
    for _ in range(12):
        sight = Projection(view.setup, photograph.size)
        result.through = _corners_through(photograph, board, sight, result.blur)
        if len(result.through.pixels) < 8:  # They err, and tell four numbers.
            raise PictureError(
                f"{photograph.name}: {len(result.through.pixels)} corners of the board are found through the {what}, "
                "and 8 are wanted: photograph from nearer, use smaller squares"
                f"{', or put the ball nearer to the board' * (not is_tank)}."
            )
        adjusted = adjust([view._replace(through=result.through)], known)
        (seen,) = adjusted.views
        moved = np.abs(seen.setup.vector - view.setup.vector)[moving]
        view = view._replace(setup=seen.setup, through=result.through)
        if np.all(moved <= 0.2 * seen.errors.vector[moving]):
            break
    assert adjusted is not None, "there is a round"
    if not is_tank:
        result.discs = [Disc(*Projection(view.setup, photograph.size).outline)]
    sigma, index = adjusted.views[0].sigma, adjusted.views[0].ior

    if is_tank and not LIQUIDS[0] < index[0] < LIQUIDS[1]:
        raise PictureError(
            f"{photograph.name}: the liquid's index would be {with_error(*index)}, and that of a liquid is from "
            f"{LIQUIDS[0]} to {LIQUIDS[1]}: is the tank full, and are the tank's thickness and its walls right?"
        )
    # In a photograph that was cut, whose middle is not where the lens looked, those through the ball scatter 3.5 times
    # as much as those beside it.
    width = photograph.size[0]
    if sigma[1] > min(LARGEST_SCATTER * width, max(3 * sigma[0], 1e-4 * width)):
        sizes = "that its thickness is right" if is_tank else "that its radius is right"
        raise PictureError(
            f"{photograph.name}: the corners that are seen through the {what} scatter by {sigma[1]:.2g} pixels, "
            f"and those beside it by {sigma[0]:.2g}: they are not what they are taken for. Put the {what} so that "
            f"more squares are seen through it, photograph from nearer, and see {sizes} and the picture whole, as the "
            "camera took it."
        )
    result.alone = adjusted


def _corners_through(photograph: Photograph, board: CharucoBoard, sight: Projection, blur: float) -> Corners:
    """The corners that are seen through ball or tank, by patches."""
    expected, stretch, visible = sight.where_through(board.places, board.half)
    chosen = visible & (stretch * board.square > LEAST_SQUARE)
    return align(photograph.light, board, board.places[chosen], expected[chosen], sight.through, blur, rounds=1)
