"""From a photograph of a board behind a ball of glass to its camera, the ball's place and a first index."""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from raytrace_jax.errors import PictureError
from raytrace_jax.photo.alignment import align
from raytrace_jax.photo.boards import Board
from raytrace_jax.photo.bundle import Corners, adjust
from raytrace_jax.photo.cameras import COUNT
from raytrace_jax.photo.corners import where_seen
from raytrace_jax.photo.find_ball import find_ball
from raytrace_jax.photo.find_camera import CAMERA_SEARCH, Photograph, find_camera, known_before, scale_of
from raytrace_jax.photo.lens import Lens
from raytrace_jax.photo.markers import Markers, find_markers, markers_in
from raytrace_jax.photo.outline import Disc, find_discs
from raytrace_jax.photo.sight import Sight
from raytrace_jax.photo.through_glass import RADIUS


class GlassSearch(NamedTuple):
    """How corners are looked for through the glass.

    Args:
        rounds: how often they are looked for and adjusted to; they may be some pixels off at first.
        reach: nothing is measured beyond this share of the outline's radius: the rim is squashed and shows the room.
        least_square: the least pixels of a square's shorter side, as it is seen through the glass; a patch of a smaller
            one shows a blur.
        more_scatter: corners through the glass may scatter so many times as much as those beside it. In a photograph
            that was cut, whose middle is not where the lens looked, it is 3.5 times.
        least_scatter: a scatter up to this share of the picture's width is right in any case; in the photograph that
            was cut it is three times as much.
        least_corners: the fewest corners through the glass; they err, and tell four numbers.
    """

    rounds: int = 4
    reach: float = 0.94
    least_square: float = 4.0
    more_scatter: float = 3.0
    least_scatter: float = 1e-4
    least_corners: int = 8


GLASS_SEARCH = GlassSearch()

BLURRED = 1.5
"""Standard deviation of a blur in pixels from which on it is named where a photograph is refused."""


class Located(NamedTuple):
    """What the corners in a photograph say.

    Args:
        board: what it shows.
        size: width and height of the photograph.
        numbers: of the camera and the ball, in the board's frame, as `photo.bundle` has them.
        covariance: of all these numbers.
        sigma: standard deviations of corners that are seen directly, and through the glass, in pixels.
        direct, through: the corners that count.
        markers: those that were decoded.
        blur: standard deviation of the camera's blur, in pixels.
    """

    board: Board
    size: tuple[int, int]
    numbers: Float[np.ndarray, " numbers"]
    covariance: Float[np.ndarray, "numbers numbers"]
    sigma: tuple[float, float]
    direct: Corners
    through: Corners
    markers: Markers
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


def locate(
    photograph: Photograph, board: Board, radius: tuple[float, float], lens: Lens, ball: Disc | None = None
) -> Located:
    """Find camera and ball from the board's corners, seen directly and through the glass.

    Args:
        photograph: what was taken.
        board: what it shows.
        radius: of the ball, and its standard deviation, in the board's unit.
        lens: what is known of the camera.
        ball: its outline, if that is known.

    Returns:
        Camera, ball and their joint covariance, all from one adjustment.

    Raises:
        NotLocated: too few markers or corners are found; the message says what to do.
    """
    taken = Taken()
    try:
        return _located(photograph, board, radius, lens, ball, taken)
    except PictureError as reason:
        taken.markers, _ = markers_in(photograph.grey, board.dictionary)
        where = ""
        if taken.discs:
            what = (
                "The ball was taken to be"
                if len(taken.discs) == 1
                else "Several discs may be the ball, the clearest is"
            )
            where = f" {what} at {taken.discs[0]}; --ball X Y R says where it is."
        if taken.blur > BLURRED:
            where += (
                f" The picture is blurred by about {2.4 * taken.blur:.0f} pixels: hold the camera still, and focus."
            )
        raise NotLocated(f"{reason}{where}", taken) from reason


def _located(
    photograph: Photograph,
    board: Board,
    radius: tuple[float, float],
    lens: Lens,
    ball: Disc | None,
    taken: Taken,
) -> Located:
    """As `locate`; what is found on the way is written into `taken`."""
    # The camera follows from the board beside the ball; of the ball only the radius is known.
    markers = find_markers(photograph.grey, board, photograph.name)
    seen = find_camera(photograph, board, markers, lens)
    numbers, direct, blur = np.array(seen.numbers), seen.corners, seen.blur
    numbers[COUNT + RADIUS], taken.direct, taken.blur = radius[0], direct, blur

    # The ball is where the board is hidden.
    light, name = photograph.light, photograph.name
    taken.discs = [ball] if ball else find_discs(light, board, numbers, blur, name)
    numbers = find_ball(light, board, numbers, blur, name, taken.discs)
    taken.discs = [Disc(*Sight(numbers, photograph.size).outline)]

    # Camera and ball are adjusted together to the corners seen directly and through the glass. A better ball says
    # better where these are, so that each round finds more of them.
    known, scale = known_before(lens, radius), scale_of(numbers, radius, lens)
    through, found = Corners.none(), None
    for number in range(GLASS_SEARCH.rounds):
        rounds = 2 if number == GLASS_SEARCH.rounds - 1 else 1
        taken.through = through = _corners_through(photograph, board, Sight(numbers, photograph.size), blur, rounds)
        if len(through.pixels) < GLASS_SEARCH.least_corners:
            raise PictureError(
                f"{photograph.name}: {len(through.pixels)} corners of the board are found through the ball, and "
                f"{GLASS_SEARCH.least_corners} are wanted: photograph from nearer, use smaller squares, or put the "
                "ball nearer to the board."
            )
        found = adjust(numbers, photograph.size, direct, through, scale, known)
        numbers = found.numbers
    assert found is not None

    # What is wrong with the photograph shows in the result: a ball that is not all there, or corners that scatter.
    taken.discs = [disc := Disc(*Sight(numbers, photograph.size).outline)]
    if np.any(disc.center - disc.radius < 0) or np.any(disc.center + disc.radius > np.array(photograph.size)):
        raise PictureError(f"{photograph.name}: the ball reaches beyond the picture's border: photograph all of it.")
    width = photograph.size[0]
    likely = max(GLASS_SEARCH.more_scatter * found.sigma[0], GLASS_SEARCH.least_scatter * width)
    if found.sigma[1] > min(CAMERA_SEARCH.largest_scatter * width, likely):
        raise PictureError(
            f"{photograph.name}: the corners that are seen through the ball scatter by {found.sigma[1]:.2g} pixels, "
            f"and those beside it by {found.sigma[0]:.2g}: they are not what they are taken for. Put the ball so that "
            "more squares are seen through it, photograph from nearer, and see that its radius is right and the "
            "picture whole, as the camera took it."
        )
    direct, through = direct.where(found.used[0]), through.where(found.used[1])
    return Located(board, photograph.size, numbers, found.covariance, found.sigma, direct, through, markers, blur)


def _corners_through(photograph: Photograph, board: Board, sight: Sight, blur: float, rounds: int) -> Corners:
    """The corners that are seen through the ball, by patches."""

    def see(pixels):
        seen = sight.through(pixels)
        inside = np.all(np.abs(seen.place) < board.half, axis=1)
        return seen.place, seen.valid & (seen.reach < GLASS_SEARCH.reach) & inside

    def see_all(pixels):
        seen = sight.through(pixels)
        return seen.place, seen.valid

    center, radius = sight.outline
    expected, stretch, visible = where_seen(see, sight.slopes, center, radius, board.places)
    chosen = visible & (stretch * board.square > GLASS_SEARCH.least_square)
    found = align(photograph.light, board, board.places[chosen], expected[chosen], see_all, blur, rounds)
    corners = Corners(found.pixels, board.places[chosen], found.spread)
    return corners.where(found.good & (found.spread < CAMERA_SEARCH.largest_spread))
