"""Index estimates from corners and from radiance, their budgets and agreement."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..inverse.judge.assumptions import Contradiction, contradicted
from ..inverse.result import FitResult
from .bundle import Adjusted
from .geometry import AT, COUNT, Setup
from .locate import Located, Together
from .room_scene import GLASS, UNCERTAIN, RoomScene

AGREE = 3.0
"""Corners and light may differ by so many of their errors."""

NAMES = (
    *("turn.x", "turn.y", "turn.z", "shift.x", "shift.y", "shift.z"),
    *("fov", "k1", "k2", "principal_point.x", "principal_point.y"),
    *("index", "center.x", "center.y", "center.z", "radius", "tilt.x", "tilt.y", "thickness", "wall", "wall_index"),
    *("liquid", "depth", "wedge.x", "wedge.y"),
)
"""The words for the numbers of a set-up, as it is raveled."""


def shown(setup: Setup) -> list[int]:
    """Where the numbers of what is looked through, of the ball or of the tank, lie in the raveled set-up."""
    through = AT.ball if setup.radius > 0 else AT.tank
    if setup.wall == 0:
        through = np.setdiff1d(through, AT.walls)
    if not np.any(setup.wedge):
        through = np.setdiff1d(through, AT.wedge)
    return [*through, *([AT.liquid, AT.depth] if setup.depth > 0 else [])]


def told(located: Located) -> dict[str, object]:
    """What the corners of a photograph say, as plain values."""
    return {
        "parameters": _parameters(located, [*shown(located.setup), *AT.lens]),
        "names": list(NAMES),
        "numbers": located.setup.vector.tolist(),
        "covariance": located.covariance.tolist(),
        "corners": {"direct": len(located.direct.pixels), "through": len(located.through.pixels)},
        "scatter": {"direct": located.sigma[0], "through": located.sigma[1]},
        "shared": {"direct": located.shared[0], "through": located.shared[1]},
        "blur": located.blur,
        "size": list(located.size),
    }


def told_together(together: Together, names: Sequence[str]) -> dict[str, object]:
    """What the corners of photographs with these names say, as plain values; a single one says what `told` has."""
    assert together.adjusted is not None, "a ball is found"
    parts = budget(together.adjusted)
    made_of: dict[str, object] = {
        "contradicted": [one._asdict() for one in contradictions(together.adjusted)],
        "budget": parts._asdict() | {"advice": parts.advice},
    }
    if len(names) == 1:
        return told(together.located[0]) | made_of
    order = [names[k] for k in (*together.located, *together.bare)]
    first, own = next(iter(together.located.values())), [NAMES[k] for k in AT.own]
    alone = {k: dict(zip(("value", "error"), index, strict=True)) for k, index in together.alone.items()}
    photographs = {names[k]: told(one) | {"alone": alone[k]} for k, one in together.located.items()}
    photographs |= {names[k]: {"no_ball": str(reason)} for k, reason in together.bare.items()}
    photographs |= {names[k]: {"refused": str(reason)} for k, reason in together.refused.items()}
    return {
        "parameters": _parameters(first, [*np.setdiff1d([*shown(first.setup), *AT.lens], AT.own)]),
        "names": [
            *(f"{order[0]}: {name}" if name in own else name for name in NAMES),
            *(f"{photograph}: {name}" for photograph in order[1:] for name in own),
        ],
        "numbers": together.adjusted.joint.tolist(),
        "covariance": together.adjusted.covariance.tolist(),
        "photographs": photographs,
    } | made_of


def _parameters(located: Located, places: Sequence[int]) -> dict[str, dict[str, float]]:
    """Numbers and their errors by name."""
    numbers, errors = located.setup.vector, located.errors.vector
    return {NAMES[k]: {"value": float(numbers[k]), "error": float(errors[k])} for k in places}


class Joined(NamedTuple):
    """What corners and light say together.

    Args:
        ior: the ball's index over the air's, and its standard deviation.
        apart: the difference of the two indices, in errors that they do not have in common.
        share: how much of the index is the light's, 0 to 1.
    """

    ior: tuple[float, float]
    apart: float
    share: float


def joined(located: Located, room: RoomScene, result: FitResult) -> Joined:
    """Corners and light as one estimate: the update of the corners' numbers by those of a fit that rests on them.

    The corners tell index and centre `a`, and the numbers `s` of camera and radius, with their covariance C. The fit
    holds s and finds `b = a + S ds` and noise of covariance N, with S its dependence on s. So `b - a` is `-H e` and
    noise, where `H = [I, -S]` and e are the errors of (a, s), and the best linear estimate is `(a, s) + K (b - a)` with
    `K = C H^T (H C H^T + N)^-1` (Kalman 1960): that of one least-squares problem whose rows are corners and pixels,
    but for what pixels tell of the camera beyond index and centre. Where these differ by more than chance makes likely,
    N is as much larger.
    """
    rows = [result.names.index(name) for name in GLASS]
    by_name = {one.name: one.sensitivity[rows] for one in result.check.assumptions}
    moved = np.stack([by_name.get(name, np.zeros(len(GLASS))) for name in UNCERTAIN], axis=1)
    observe = np.concatenate([np.eye(len(GLASS)), -moved], axis=1)
    noise = (result.uncertainty.covariance + result.check.structure)[np.ix_(rows, rows)]
    common = observe @ room.covariance @ observe.T
    corners = np.array([located.setup.ior, *located.setup.center])
    off = result.value[rows] - corners

    excess = float(off @ np.linalg.solve(common + noise, off)) / len(GLASS)
    apart = float(abs(off[0]) / np.sqrt((common + noise)[0, 0]))
    # One in twenty exceeds this chi squared of index and centre, a degree of freedom, by chance.
    gain = room.covariance @ observe.T @ np.linalg.inv(common + noise * (excess if excess > 2.4 else 1.0))
    index = float(corners[0] + gain[0] @ off)
    variance = float((room.covariance - gain @ observe @ room.covariance)[0, 0])
    return Joined((index, float(np.sqrt(variance))), apart, float(gain[0, 0]))


def contradictions(adjusted: Adjusted) -> tuple[Contradiction, ...]:
    """What was known before of the lens, and measured of ball or tank, and comes out otherwise."""
    mean, root, _ = adjusted.known
    # How high a liquid's surface is, and where a tank stands, nobody has stated.
    known = np.setdiff1d(np.flatnonzero(root[:, :COUNT].any(axis=0)), [AT.depth, *AT.center])
    before = np.sqrt(np.diagonal(np.linalg.inv(root[:, known].T @ root[:, known])))
    after = np.sqrt(np.diagonal(adjusted.covariance))
    return contradicted(
        Contradiction.of(NAMES[k], (float(adjusted.joint[k]), float(after[k])), (float(mean[k]), float(spread)))
        for k, spread in zip(known, before, strict=True)
    )


class Budget(NamedTuple):
    """Parts of an index's standard deviation, whose squares add up to its square; and what it would be.

    Args:
        parts: by what they are of. Of `corners`: what these alone would leave if all that was measured, and the lens,
            were exact; of the others: what is there because they are not.
        exact: the whole if one of the others were exact.
        fourfold: the whole with four times as many photographs like these.
    """

    parts: dict[str, float]
    exact: dict[str, float]
    fourfold: float

    @property
    def advice(self) -> str:
        """A sentence on what would lessen the largest part, and what the error would be then."""
        largest = max(self.parts, key=lambda name: self.parts[name])
        whole = float(np.sqrt(sum(part**2 for part in self.parts.values())))
        way, left = f"measure {largest} better: if exact", self.exact.get(largest, self.fourfold)
        if largest == "corners":
            way = "take more photographs, from and at other places: with four times as many"
        elif largest == "lens":
            way = "calibrate the lens, or with more tilted pictures: if exact"
        return f"To lessen the index's error, {way}, {left:.2g} of {whole:.2g} would be left."


def budget(adjusted: Adjusted) -> Budget:
    """The parts of the error of an adjusted index, which follows linearly from corners, lens and what was measured.

    A part is the variance that goes where its numbers become exact. What goes depends on which others are exact by
    then: it is the mean over all orders (Shapley 1953), so that the parts add up.
    """
    covariance, root = adjusted.covariance, adjusted.known.root
    variance = covariance[AT.ior, AT.ior]
    setup, groups = Setup.of(adjusted.joint[:COUNT]), {"lens": AT.lens}
    groups |= {"radius and ruler": [AT.radius]} if setup.radius > 0 else {"thickness and ruler": [AT.thickness]}
    groups |= {"wedge": AT.wedge} if root[:, AT.wedge].any() else {}
    groups |= {"walls": AT.walls} if setup.wall > 0 else {}
    groups |= {"liquid": [AT.liquid]} if setup.depth > 0 else {}

    def exact(names: Sequence[str]) -> float:
        """The index's variance if these numbers were known."""
        places = [place for name in names for place in groups[name]]
        across = covariance[AT.ior, places]
        return float(variance - across @ np.linalg.pinv(covariance[np.ix_(places, places)]) @ across)

    # In units of each number's error; the corners' precision is what is left of all precision.
    spread = np.sqrt(np.diagonal(covariance))
    free = np.flatnonzero(spread > 0)
    before = root[:, free] * spread[free]
    whole = np.linalg.pinv(covariance[np.ix_(free, free)] / np.outer(spread[free], spread[free]))
    more = np.linalg.pinv(4 * whole - 3 * before.T @ before)
    fourfold = more[(place := int(np.flatnonzero(free == AT.ior)[0])), place] * variance

    orders = list(itertools.permutations(groups))
    gone = {
        name: np.mean([exact(order[: (at := order.index(name))]) - exact(order[: at + 1]) for order in orders])
        for name in groups
    }
    parts, alone = {"corners": exact([*groups])} | gone, {name: exact([name]) for name in groups}
    of_parts, of_exact = ({name: float(np.sqrt(max(v, 0.0))) for name, v in one.items()} for one in (parts, alone))
    return Budget(of_parts, of_exact, float(np.sqrt(max(fourfold, 0.0))))
