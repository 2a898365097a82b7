"""Index estimates from corners and from radiance, their budgets and agreement."""

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaincinv

from ..inverse.judge.model_check import Contradiction, contradicted
from ..inverse.result import FitResult
from ..util.numerics import root_diagonal
from .bundle import Adjusted
from .geometry import LENS, Setup
from .locate import Located, PhotoResult, Together
from .room_scene import RoomScene

AGREE = 3.0
"""The largest difference of corners and light, in its errors, at which they still agree."""

PARTS = {
    "radius": "radius and ruler", "thickness": "thickness and ruler", "wedge": "wedge", "wall": "walls",
    "wall_index": "walls", "liquid": "liquid",
}  # fmt: skip
"""The parts of an index's error, by the measured numbers that they come from."""


def shown(setup: Setup) -> list[int]:
    """Where the numbers of what is looked through, of the ball or of the tank, lie in the raveled set-up."""
    hidden = [] if np.any(setup.vector[setup.places("wall")]) else setup.places("wall", "wall_index")
    hidden += [] if np.any(setup.vector[setup.places("wedge")]) else setup.places("wedge")
    return [k for k, one in enumerate(setup.numbers) if k > LENS[-1] and one.is_result and k not in hidden]


def to_dict(located: Located) -> dict[str, object]:
    """What the corners of a photograph say, as plain values."""
    return {
        "parameters": _parameters(located, [*shown(located.setup), *LENS]),
        "names": located.setup.names,
        "numbers": located.setup.vector.tolist(),
        "covariance": located.covariance.tolist(),
        "corners": {"direct": len(located.direct.pixels), "through": len(located.through.pixels)},
        "scatter": {"direct": located.sigma[0], "through": located.sigma[1]},
        "shared": {"direct": located.shared[0], "through": located.shared[1]},
        "blur": located.blur,
        "size": list(located.size),
    }


def together_to_dict(together: Together) -> dict[str, object]:
    """What the corners of photographs say, as plain values; a single one says what `to_dict` has."""
    assert together.adjusted is not None, "a ball is found"
    parts = budget(together.adjusted)
    made_of: dict[str, object] = {
        "contradicted": [one._asdict() for one in contradictions(together.adjusted)],
        "budget": parts._asdict() | {"advice": parts.advice},
    }
    first = together.located[0]
    if len(together.photographs) == 1:
        return to_dict(first) | made_of
    adjusted = [result for result in together.photographs if result.located]
    adjusted += [result for result in together.photographs if result.is_bare]
    common = [k for k in sorted([*shown(first.setup), *LENS]) if not first.setup.numbers[k].is_own]
    return {
        "parameters": _parameters(first, common),
        "names": [
            f"{result.photograph.name}: {number.name}" if number.is_own else number.name
            for result, view in zip(adjusted, together.adjusted.views, strict=True)
            for number in view.setup.numbers
            if number.is_own or result is adjusted[0]
        ],
        "numbers": together.adjusted.joint.tolist(),
        "covariance": together.adjusted.covariance.tolist(),
        "photographs": {result.photograph.name: _of_several(result) for result in together.photographs},
    } | made_of


def _of_several(result: PhotoResult) -> dict[str, object]:
    """What one of several photographs says."""
    if result.located is None:
        return {"no_ball" if result.is_bare else "refused": result.reason}
    return to_dict(result.located) | {"alone": dict(zip(("value", "error"), result.index_alone, strict=True))}


def _parameters(located: Located, places: Sequence[int]) -> dict[str, dict[str, float]]:
    """Numbers and their errors by name."""
    names, numbers, errors = located.setup.names, located.setup.vector, located.errors.vector
    return {names[k]: {"value": float(numbers[k]), "error": float(errors[k])} for k in places}


class Combined(NamedTuple):
    """What corners and light say together.

    Args:
        ior: the ball's index over the air's, and its standard deviation.
        apart: the difference of the two indices, in errors that they do not have in common.
        share: how much of the index is the light's, 0 to 1.
    """

    ior: tuple[float, float]
    apart: float
    share: float


def combine(room: RoomScene, result: FitResult) -> Combined:
    """Corners and light as one estimate: the update of the corners' numbers by those of a fit that rests on them.

    The corners tell index and centre `a`, and the numbers `s` of camera and radius, with their covariance C. The fit
    holds s and finds `b = a + S ds` and noise of covariance N, with S its dependence on s. So `b - a` is `-H e` and
    noise, where `H = [I, -S]` and e are the errors of (a, s), and the best linear estimate is `(a, s) + K (b - a)` with
    `K = C H^T (H C H^T + N)^-1` (Kalman 1960): that of one least-squares problem whose rows are corners and pixels,
    but for what pixels tell of the camera beyond index and centre. Where these differ by more than chance makes likely,
    N is as much larger.
    """
    count, rows = len(room.glass), [result.names.index(name) for name in room.glass]
    by_name = {one.name: one.sensitivity[rows] for one in result.check.assumptions}
    moved = np.stack([by_name.get(name, np.zeros(count)) for name in room.held], axis=1)
    observe = np.concatenate([np.eye(count), -moved], axis=1)
    noise = (result.uncertainty.covariance + result.check.structure)[np.ix_(rows, rows)]
    common = observe @ room.covariance @ observe.T
    off = result.value[rows] - room.told

    excess = float(off @ np.linalg.solve(common + noise, off)) / count
    apart = float(abs(off[0]) / np.sqrt((common + noise)[0, 0]))
    # One in twenty exceeds this chi squared of index and centres, a degree of freedom, by chance.
    by_chance = 2 * float(gammaincinv(count / 2, 0.95)) / count
    gain = room.covariance @ observe.T @ np.linalg.inv(common + noise * (excess if excess > by_chance else 1.0))
    index = float(room.told[0] + gain[0] @ off)
    variance = float((room.covariance - gain @ observe @ room.covariance)[0, 0])
    return Combined((index, float(np.sqrt(variance))), apart, float(gain[0, 0]))


def contradictions(adjusted: Adjusted) -> tuple[Contradiction, ...]:
    """What was known before of the lens, and measured of ball or tank, and comes out otherwise."""
    (mean, root, _), setup = adjusted.known, adjusted.views[0].setup
    # How high a liquid's surface is, and where a tank stands, nobody has stated.
    stated = root[:, : len(setup.numbers)].any(axis=0)
    known = np.setdiff1d(np.flatnonzero(stated), setup.places("depth", "center"))
    before = np.sqrt(np.diagonal(np.linalg.inv(root[:, known].T @ root[:, known])))
    after = root_diagonal(adjusted.covariance)
    return contradicted(
        Contradiction.of(setup.names[k], (float(adjusted.joint[k]), float(after[k])), (float(mean[k]), float(spread)))
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
    setup, groups = adjusted.views[0].setup, {"lens": [*LENS]}
    (index,), results = setup.places("index"), shown(setup)
    variance = covariance[index, index]
    for name, part in PARTS.items():
        if measured := [k for k in setup.places(name) if k in results]:
            groups[part] = groups.get(part, []) + measured

    def exact(names: Sequence[str]) -> float:
        """The index's variance if these numbers were known."""
        places = [place for name in names for place in groups[name]]
        across = covariance[index, places]
        return float(variance - across @ np.linalg.pinv(covariance[np.ix_(places, places)]) @ across)

    # In units of each number's error; the corners' precision is what is left of all precision.
    spread = root_diagonal(covariance)
    free = np.flatnonzero(spread > 0)
    before = root[:, free] * spread[free]
    whole = np.linalg.pinv(covariance[np.ix_(free, free)] / np.outer(spread[free], spread[free]))
    more = np.linalg.pinv(4 * whole - 3 * before.T @ before)
    fourfold = more[(place := int(np.flatnonzero(free == index)[0])), place] * variance

    orders = list(itertools.permutations(groups))
    gone = {
        name: np.mean([exact(order[: (at := order.index(name))]) - exact(order[: at + 1]) for order in orders])
        for name in groups
    }
    parts, alone = {"corners": exact([*groups])} | gone, {name: exact([name]) for name in groups}
    of_parts, of_exact = ({name: float(np.sqrt(max(v, 0.0))) for name, v in one.items()} for one in (parts, alone))
    return Budget(of_parts, of_exact, float(np.sqrt(max(fourfold, 0.0))))
