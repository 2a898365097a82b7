"""From photographs of a board behind a ball of glass to their camera, the ball's places and its index."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.alignment import align
from raytrace_jax.photo.boards import CharucoBoard
from raytrace_jax.photo.bundle import BALL, Adjusted, Corners, PhotoView, adjust
from raytrace_jax.photo.calibrate import one_lens, one_size
from raytrace_jax.photo.cameras import COUNT
from raytrace_jax.photo.find_ball import find_ball
from raytrace_jax.photo.find_camera import (
    LARGEST_SCATTER,
    LARGEST_SPREAD,
    FoundCamera,
    Photograph,
    find_camera,
    known_before,
    step_scales,
)
from raytrace_jax.photo.lens import LensPrior, Turn
from raytrace_jax.photo.markers import find_markers, markers_in
from raytrace_jax.photo.outline import Disc, NoBall, find_discs
from raytrace_jax.photo.sight import Sight
from raytrace_jax.photo.through_glass import RADIUS

REACH = 0.94
"""Corners are measured within this share of the outline's radius: the rim is squashed and shows the room."""

LEAST_SQUARE = 4.0
"""The least pixels of a square's shorter side as it is seen through the glass; a patch of a smaller one is a blur."""

MOST_ROUNDS, SETTLED = 12, 0.2
"""Corners through the glass are looked for so often at most, or until no number of the ball moves by more than this
share of its error."""

MORE_SCATTER, LEAST_SCATTER = 3.0, 1e-4
"""Corners through the glass may scatter so many times as much as those beside it, and in any case by this share of the
picture's width. In a photograph that was cut, whose middle is not where the lens looked, it is 3.5 times and .0003."""

LEAST_THROUGH = 8
"""The fewest corners through the glass; they err, and tell four numbers."""

BLURRED = 1.5
"""Standard deviation of a blur in pixels from which on it is named where a photograph is refused."""


class Located(NamedTuple):
    """What the corners in a photograph say.

    Args:
        board: what it shows.
        size: width and height of the photograph.
        numbers: of the camera and the ball, in the board's frame, as `photo.bundle` has them.
        covariance: of all these numbers, from all photographs that were adjusted together.
        sigma: standard deviations of corners that are seen directly, and through the glass, in pixels.
        direct, through: the corners that count.
        blur: standard deviation of the camera's blur, in pixels.
    """

    board: CharucoBoard
    size: tuple[int, int]
    numbers: Float[np.ndarray, " numbers"]
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    direct: Corners
    through: Corners
    blur: float

    @property
    def sight(self) -> Sight:
        """What the photograph's pixels see."""
        return Sight(self.numbers, self.size)

    @property
    def index(self) -> tuple[float, float]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """The ball's index over the air's, and its standard deviation."""
        return float(self.numbers[COUNT]), float(np.sqrt(self.covariance[COUNT, COUNT]))


@dataclass
class Taken:
    """What was taken for what in a photograph that is refused, as far as that went.

    Args:
        markers: the corners of each that was decoded.
        direct, through: corners of the board that were looked for directly, and through the ball.
        discs: where the ball may be, the likeliest one first.
        blur: standard deviation of the camera's blur in pixels, 0 where that is not known.
    """

    markers: Float[np.ndarray, "markers 4 2"] = field(default_factory=lambda: np.zeros((0, 4, 2)))
    direct: Corners = field(default_factory=Corners.none)
    through: Corners = field(default_factory=Corners.none)
    discs: list[Disc] = field(default_factory=list)
    blur: float = 0.0


class NotLocated(PictureError):
    """A photograph that tells no index; `taken` is what was taken for what."""

    def __init__(self, words: str, taken: Taken):
        super().__init__(words)
        self.taken = taken


class Together(NamedTuple):
    """What photographs of one ball say together. They are told by their places in the list.

    Args:
        located: of each that shows the ball, with the numbers and the covariance that follow from all.
        alone: the index of each, and its standard deviation, with the lens of all and the corners of this one alone.
        bare: those in which no ball is found, which tell of the lens, with the reason.
        refused: those that are left out, with the reason.
        adjusted: the numbers of all in `located`, then of those in `bare`, with their covariance; None without a ball.
    """

    located: dict[int, Located]
    alone: dict[int, tuple[float, float]]
    bare: dict[int, NotLocated]
    refused: dict[int, NotLocated]
    adjusted: Adjusted | None


def locate(
    photograph: Photograph, board: CharucoBoard, radius: tuple[float, float], lens: LensPrior, ball: Disc | None = None
) -> Located:
    """As `locate_together`, of one photograph. Raises NotLocated."""
    found = locate_together([photograph], board, radius, lens, ball)
    if found.refused:
        raise found.refused[0]
    return found.located[0]


def locate_together(
    photographs: Sequence[Photograph],
    board: CharucoBoard,
    radius: tuple[float, float],
    lens: LensPrior,
    ball: Disc | None = None,
) -> Together:
    """Find cameras and ball from the board's corners, seen directly and through the glass.

    Each photograph is measured on its own. Then all corners are adjusted together: lens, index and radius are common,
    and what is known of lens and radius before counts once. Where there are several photographs, one without a ball
    tells of the lens.

    Args:
        photographs: by one camera, of one ball.
        board: what they show.
        radius: of the ball, and its standard deviation, in the board's unit.
        lens: what is known of the camera, as the first photograph has it.
        ball: its outline, if that is known.

    Returns:
        What each says, and all together; photographs that tell no index are told with what to do.

    Raises:
        PictureError: the photographs are not by one camera.
    """
    size, several = one_size(photographs), len(photographs) > 1
    turns = [Turn(size, photographs[0].orientation, one.orientation) for one in photographs]
    taken = [Taken() for _ in photographs]
    refused: dict[int, NotLocated] = {}

    # The cameras follow from the board beside the ball, and all tell of one lens.
    cameras: dict[int, FoundCamera] = {}
    for k, photograph in enumerate(photographs):
        try:
            markers = find_markers(photograph.grey, board, photograph.name)
            cameras[k] = find_camera(photograph, board, markers, turns[k].of(lens))
        except PictureError as reason:
            refused[k] = _not_located(reason, photograph, board, taken[k])
    shared = lens
    if several and cameras:
        places = list(cameras)
        found = one_lens([photographs[k] for k in places], list(cameras.values()), turns[places[0]].of(lens))
        cameras = dict(zip(places, found, strict=True))
        shared = Turn(size, photographs[places[0]].orientation, photographs[0].orientation).of(found[0].lens)

    views: dict[int, PhotoView] = {}
    alone: dict[int, Adjusted] = {}
    bare: dict[int, NotLocated] = {}
    for k, camera in cameras.items():
        try:
            views[k], alone[k] = _measured(photographs[k], board, camera, radius, turns[k].of(shared), ball, taken[k])
        except PictureError as reason:
            left_out = bare if several and isinstance(reason, NoBall) else refused
            left_out[k] = _not_located(reason, photographs[k], board, taken[k])
    if not views:
        return Together({}, {}, bare, refused, None)

    # The last adjustment is of all; that of a single photograph is all there is.
    first, joint = next(iter(views)), next(iter(alone.values()))
    if len(views) + len(bare) > 1:
        chosen = views | {k: cameras[k].view for k in bare}
        turned = [
            view._replace(turn=Turn(size, photographs[first].orientation, photographs[k].orientation))
            for k, view in chosen.items()
        ]
        joint = adjust(turned, known_before(turns[first].of(lens), radius))
    located = {
        k: Located(
            board,
            photographs[k].size,
            seen.numbers,
            seen.covariance,
            seen.sigma,
            view.direct.where(seen.used[0]),
            view.through.where(seen.used[1]),
            cameras[k].blur,
        )
        for (k, view), seen in zip(views.items(), joint.views, strict=False)
    }
    indices = {k: (float(one.joint[COUNT]), float(np.sqrt(one.covariance[COUNT, COUNT]))) for k, one in alone.items()}
    return Together(located, indices, bare, refused, joint)


def _not_located(reason: PictureError, photograph: Photograph, board: CharucoBoard, taken: Taken) -> NotLocated:
    """A refusal, with where the ball was taken to be."""
    taken.markers, _ = markers_in(photograph.grey, board.dictionary)
    where = ""
    if taken.discs:
        what = "The ball was taken to be" if len(taken.discs) == 1 else "Several discs may be the ball, the clearest is"
        where = f" {what} at {taken.discs[0]}; --ball X Y R says where it is."
    if taken.blur > BLURRED:
        where += f" The picture is blurred by about {2.4 * taken.blur:.0f} pixels: hold the camera still, and focus."
    refusal = NotLocated(f"{reason}{where}", taken)
    refusal.__cause__ = reason
    return refusal


def _measured(
    photograph: Photograph,
    board: CharucoBoard,
    camera: FoundCamera,
    radius: tuple[float, float],
    lens: LensPrior,
    ball: Disc | None,
    taken: Taken,
) -> tuple[PhotoView, Adjusted]:
    """A photograph's corners, and what they say; what is found on the way is written into `taken`."""
    # Of the ball only the radius is known.
    numbers, direct, blur = np.array(camera.view.numbers), camera.view.direct, camera.blur
    numbers[COUNT + RADIUS], taken.direct, taken.blur = radius[0], direct, blur

    # The ball is where the board is hidden.
    light, name = photograph.light, photograph.name
    taken.discs = [ball] if ball else find_discs(light, board, numbers, blur, name)
    numbers = find_ball(light, board, numbers, blur, name, taken.discs)
    taken.discs = [Disc(*Sight(numbers, photograph.size).outline)]

    # Camera and ball are adjusted together to the corners seen directly and through the glass. A better ball says
    # better where these are, so that each round finds more of them.
    known, scale = known_before(lens, radius), step_scales(numbers, radius, lens)
    found, view = None, PhotoView(numbers, scale, photograph.size, direct, Corners.none())
    for _ in range(MOST_ROUNDS):
        taken.through = _corners_through(photograph, board, Sight(view.numbers, photograph.size), blur)
        if len(taken.through.pixels) < LEAST_THROUGH:
            raise PictureError(
                f"{photograph.name}: {len(taken.through.pixels)} corners of the board are found through the ball, and "
                f"{LEAST_THROUGH} are wanted: photograph from nearer, use smaller squares, or put the "
                "ball nearer to the board."
            )
        found = adjust([view._replace(through=taken.through)], known)
        moved, error = found.views[0].numbers - view.numbers, np.sqrt(np.diagonal(found.views[0].covariance))
        view = view._replace(numbers=found.views[0].numbers, through=taken.through)
        if np.all(np.abs(moved[BALL]) <= SETTLED * error[BALL]):
            break
    assert found is not None
    numbers, sigma = view.numbers, found.views[0].sigma

    # What is wrong with the photograph shows in the result: a ball that is not all there, or corners that scatter.
    taken.discs = [disc := Disc(*Sight(numbers, photograph.size).outline)]
    if np.any(disc.center - disc.radius < 0) or np.any(disc.center + disc.radius > np.array(photograph.size)):
        raise PictureError(f"{photograph.name}: the ball reaches beyond the picture's border: photograph all of it.")
    width = photograph.size[0]
    likely = max(MORE_SCATTER * sigma[0], LEAST_SCATTER * width)
    if sigma[1] > min(LARGEST_SCATTER * width, likely):
        raise PictureError(
            f"{photograph.name}: the corners that are seen through the ball scatter by {sigma[1]:.2g} pixels, "
            f"and those beside it by {sigma[0]:.2g}: they are not what they are taken for. Put the ball so that "
            "more squares are seen through it, photograph from nearer, and see that its radius is right and the "
            "picture whole, as the camera took it."
        )
    return view, found


def _corners_through(photograph: Photograph, board: CharucoBoard, sight: Sight, blur: float) -> Corners:
    """The corners that are seen through the ball, by patches."""

    def see(pixels):
        seen = sight.through(pixels)
        return seen.place, seen.valid

    expected, stretch, visible = sight.where_through(board.places, REACH, board.half)
    chosen = visible & (stretch * board.square > LEAST_SQUARE)
    found = align(photograph.light, board, board.places[chosen], expected[chosen], see, blur, rounds=1)
    corners = Corners(found.pixels, board.places[chosen], found.spread)
    return corners.where(found.good & (found.spread < LARGEST_SPREAD))
