"""From photographs of a board behind a ball of glass, or a tank of liquid, to their cameras and the index."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..errors import PictureError
from ..util.digits import with_error
from .alignment import align
from .boards import CharucoBoard
from .bundle import Adjusted, AdjustedView, Known, Measured, PhotoView, adjust, known_before
from .find_ball import find_ball
from .find_camera import LARGEST_SCATTER, FoundCamera, find_camera, one_lens, one_size
from .geometry import AT
from .lens import LensPrior
from .markers import markers_in
from .outline import Disc, NothingThrough, find_discs
from .photograph import Corners, Photograph
from .sight import Sight
from .tank import Layers, layers_of

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
    size: tuple[int, int]
    blur: float

    @property
    def sight(self) -> Sight:
        """What the photograph's pixels see."""
        return Sight(self.setup, self.size)


@dataclass
class Diagnostics:
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

    def __init__(self, words: str, taken: Diagnostics):
        super().__init__(words)
        self.taken = taken


class Together(NamedTuple):
    """What photographs of one ball say together, each by its place in the list.

    Args:
        located: those that show the ball, with the numbers and the covariance that follow from all.
        alone: the index of each, and its standard deviation, with the lens of all and the corners of this one alone.
        bare: why no ball is found in those that only tell of the lens.
        refused: why the others are left out.
        adjusted: the numbers of all in `located`, then of those in `bare`, with their covariance; None without a ball.
    """

    located: dict[int, Located]
    alone: dict[int, tuple[float, float]]
    bare: dict[int, NotLocated]
    refused: dict[int, NotLocated]
    adjusted: Adjusted | None


def locate(
    photograph: Photograph,
    board: CharucoBoard,
    measured: Measured,
    lens: LensPrior,
    ball: Disc | None = None,
) -> Located:
    """As `locate_together`, of one photograph. Raises NotLocated."""
    found = locate_together([photograph], board, measured, lens, ball)
    if found.refused:
        raise found.refused[0]
    return found.located[0]


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
            latter's `depth`; of the tank `thickness`, `wall` and `wall_ior`; each with its standard deviation, in the
            board's unit.
        lens: what is known of the camera, as the first photograph has it.
        ball: its outline, if that is known.

    Returns:
        What each says, and all together; photographs that tell no index are told with what to do.

    Raises:
        PictureError: the photographs are not by one camera.
    """
    one_size(photographs)
    first, several = photographs[0], len(photographs) > 1
    taken = [Diagnostics() for _ in photographs]
    refused: dict[int, NotLocated] = {}
    bare: dict[int, NotLocated] = {}

    # The cameras follow from the board beside the ball or the tank, and all tell of one lens.
    cameras: dict[int, FoundCamera] = {}
    layers: dict[int, Layers] = {}
    for k, photograph in enumerate(photographs):
        known_lens, beside = first.turn_to(photograph).of(lens), board
        try:
            if "thickness" in measured:
                try:
                    layers[k] = layers_of(photograph, board, known_lens)
                    beside = layers[k].direct
                except NothingThrough as reason:
                    if not several:
                        raise
                    bare[k] = _not_located(reason, photograph, board, taken[k])
            liquid = {name: measured[name] for name in ("liquid", "depth") if name in measured}
            cameras[k] = find_camera(photograph, beside, known_lens, liquid)
        except PictureError as reason:
            bare.pop(k, None)
            refused[k] = _not_located(reason, photograph, board, taken[k])
    shared = lens
    if several and cameras:
        pictures = [photographs[k] for k in cameras]
        found = one_lens(pictures, list(cameras.values()), first.turn_to(pictures[0]).of(lens))
        cameras = dict(zip(cameras, found, strict=True))
        shared = pictures[0].turn_to(first).of(found[0].lens)

    # The corners through the glass follow photograph by photograph.
    views: dict[int, PhotoView] = {}
    alone: dict[int, Adjusted] = {}
    for k, camera in cameras.items():
        if k in bare:
            continue
        known_lens = first.turn_to(photographs[k]).of(shared)
        try:
            known, behind = known_before(known_lens, measured), board
            if k in layers:
                start, behind = _before_tank(camera, layers[k], measured, known), layers[k].through
            else:
                start = _before_ball(photographs[k], board, camera, measured["radius"][0], ball, taken[k])
            views[k], alone[k] = _measured(photographs[k], behind, start, camera.blur, known, taken[k])
        except PictureError as reason:
            left_out = bare if several and isinstance(reason, NothingThrough) else refused
            left_out[k] = _not_located(reason, photographs[k], board, taken[k])
    if not views:
        if asked := _other_size(photographs, board, cameras, layers, measured, ball):
            for k in cameras:
                left_out = bare if k in bare else refused
                left_out[k] = NotLocated(f"{left_out[k]} {asked}", taken[k])
        return Together({}, {}, bare, refused, None)

    # The last adjustment is of all; that of a single photograph is all there is.
    leading, joint = photographs[next(iter(views))], next(iter(alone.values()))
    if len(views) + len(bare) > 1:
        chosen = views | {k: cameras[k].view for k in bare}
        turned = [view._replace(turn=leading.turn_to(photographs[k])) for k, view in chosen.items()]
        joint = adjust(turned, known_before(first.turn_to(leading).of(lens), measured))
    located = {
        k: Located(**vars(seen), board=board, size=photographs[k].size, blur=cameras[k].blur)
        for k, seen in zip(views, joint.views, strict=False)
    }
    return Together(located, {k: one.views[0].ior for k, one in alone.items()}, bare, refused, joint)


def _not_located(reason: PictureError, photograph: Photograph, board: CharucoBoard, taken: Diagnostics) -> NotLocated:
    """A refusal, with where the ball was taken to be."""
    taken.markers, _ = markers_in(photograph.grey, board.dictionary)
    where = ""
    if taken.discs:
        what = "The ball was taken to be" if len(taken.discs) == 1 else "Several discs may be the ball, the clearest is"
        where = f" {what} at {taken.discs[0]}; --ball X Y R says where it is."
    if taken.blur > 1.5:
        where += f" The picture is blurred by about {2.4 * taken.blur:.0f} pixels: hold the camera still, and focus."
    refusal = NotLocated(f"{reason}{where}", taken)
    refusal.__cause__ = reason
    return refusal


def _other_size(
    photographs: Sequence[Photograph],
    board: CharucoBoard,
    cameras: dict[int, FoundCamera],
    layers: dict[int, Layers],
    measured: Measured,
    ball: Disc | None,
) -> str | None:
    """Ask about a radius, or a thickness, with which a photograph would tell an index, where the stated one fails."""
    name, what, mistake, factors = "radius", "ball", "another unit or a diameter", (0.5, 2, 0.1, 10)
    if "thickness" in measured:
        name, what, mistake, factors = "thickness", "tank", "another unit", (0.1, 10, 0.5, 2)
    ways = {0.5: f"half of that {name}", 2: f"twice that {name}", 0.1: f"a tenth of that {name}", 10: "ten times that"}
    for k, camera in cameras.items():
        for factor in factors:
            size = factor * measured[name][0]
            if size <= 2 * measured.get("wall", (0.0, 0.0))[0]:
                continue
            other = {**measured, name: (size, 0.0)}
            known, behind = known_before(camera.lens, other), board
            with contextlib.suppress(PictureError):
                if k in layers:
                    start, behind = _before_tank(camera, layers[k], other, known), layers[k].through
                else:
                    start = _before_ball(photographs[k], board, camera, size, ball, Diagnostics())
                _measured(photographs[k], behind, start, camera.blur, known, Diagnostics())
                return (
                    f"With {ways[factor]}, {size:.3g} mm, the board is seen through the {what}: was {mistake} stated?"
                )
    return None


def _before_ball(
    photograph: Photograph,
    board: CharucoBoard,
    camera: FoundCamera,
    radius: float,
    ball: Disc | None,
    taken: Diagnostics,
) -> PhotoView:
    """A photograph's camera, and the ball where the board is hidden."""
    taken.direct, taken.blur = camera.view.direct, camera.blur
    setup = camera.view.setup._replace(radius=radius)
    taken.discs = [ball] if ball else find_discs(photograph, board, setup, camera.blur)
    setup = find_ball(photograph, board, setup, camera.blur, taken.discs)
    taken.discs = [disc := Disc(*Sight(setup, photograph.size).outline)]
    if np.any(disc.center - disc.radius < 0) or np.any(disc.center + disc.radius > np.array(photograph.size)):
        raise PictureError(f"{photograph.name}: the ball reaches beyond the picture's border: photograph all of it.")
    return camera.view._replace(setup=setup)


def _before_tank(camera: FoundCamera, layers: Layers, measured: Measured, known: Known) -> PhotoView:
    """A photograph's camera, and the tank as the markers that are seen through it tell."""
    sizes = {name: np.full(np.shape(getattr(AT, name)), value) for name, (value, _) in measured.items()}
    # The thickness is that in the middle of what is seen through the tank.
    middle = np.append(layers.seen.places.mean(axis=0), known.mean[AT.center[2]])
    setup = camera.view.setup._replace(ior=1.4, radius=0.0, center=middle, **sizes)
    view = camera.view._replace(setup=setup, through=layers.seen)
    return view._replace(setup=adjust([view], known).views[0].setup)


def _measured(
    photograph: Photograph, board: CharucoBoard, view: PhotoView, blur: float, known: Known, taken: Diagnostics
) -> tuple[PhotoView, Adjusted]:
    """A photograph's corners, and what they say; what is found on the way is written into `taken`."""
    # All is adjusted together to the corners seen directly and through ball or tank. A better estimate says better
    # where these are, so that each round finds more of them.
    taken.direct, taken.blur, found = view.direct, blur, None
    is_tank = view.setup.thickness > 0
    what, moving = ("tank", AT.tank) if is_tank else ("ball", AT.ball)
    for _ in range(12):
        sight = Sight(view.setup, photograph.size)
        taken.through = _corners_through(photograph, board, sight, blur)
        if len(taken.through.pixels) < 8:  # They err, and tell four numbers.
            raise PictureError(
                f"{photograph.name}: {len(taken.through.pixels)} corners of the board are found through the {what}, "
                "and 8 are wanted: photograph from nearer, use smaller squares"
                f"{', or put the ball nearer to the board' * (not is_tank)}."
            )
        found = adjust([view._replace(through=taken.through)], known)
        (seen,) = found.views
        moved = np.abs(seen.setup.vector - view.setup.vector)[moving]
        view = view._replace(setup=seen.setup, through=taken.through)
        if np.all(moved <= 0.2 * seen.errors.vector[moving]):
            break
    assert found is not None, "there is a round"
    if not is_tank:
        taken.discs = [Disc(*Sight(view.setup, photograph.size).outline)]
    sigma, index = found.views[0].sigma, found.views[0].ior

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
    return view, found


def _corners_through(photograph: Photograph, board: CharucoBoard, sight: Sight, blur: float) -> Corners:
    """The corners that are seen through ball or tank, by patches."""

    def see(pixels):
        seen = sight.through(pixels)
        return seen.place, seen.valid

    expected, stretch, visible = sight.where_through(board.places, board.half)
    chosen = visible & (stretch * board.square > LEAST_SQUARE)
    return align(photograph.light, board, board.places[chosen], expected[chosen], see, blur, rounds=1)
