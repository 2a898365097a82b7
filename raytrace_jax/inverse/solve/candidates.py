"""Places where a fit may begin, and minima that a fit has not seen."""

import itertools
import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...scene.parameters import Address, Block, material_of, resolve
from ...scene.scene import Camera
from ...tracer.geometry.camera import ray
from ...util.compilation import jit
from ...util.numerics import on_host
from ..judge.structure import EVIDENCE, vuong_evidence
from ..problem.problem import FitState, Problem
from ..problem.sampling import supersampled
from ..problem.unknowns import Images, Values, natural_scale

INDICES = (1.05, 1.15, 1.3, 1.45, 1.6, 1.85, 2.2, 2.6)
"""Indices that are tried for a material that starts at 1 or above: from what is barely denser than air to diamond."""

BUBBLE_INDICES = (0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.97)
"""Indices that are tried for a material that starts below 1."""

FAR, FAR_INDICES = 7, (1.1, 1.5, 2.0)
"""Places in each direction of the picture for a sphere that may be anywhere, and the indices that are tried there."""

MOST_TRIED = 800
"""Pictures in all, about the 747 of one ball with its index; of a larger grid every other value is left out."""


class Choice(NamedTuple):
    """The places of parameters that vary together, and their values on a grid, "*grid places"."""

    places: tuple[int, ...]
    values: np.ndarray

    @classmethod
    def alike(cls, places: Sequence[int], values: Sequence[float]) -> "Choice":
        return cls(tuple(places), np.tile(np.array(values)[:, None], len(places)))


ScanGrid = list[Choice]
"""Choices that vary independently: a grid tries all combinations of their values."""


def table(base: Values, grid: ScanGrid) -> Float[np.ndarray, "rows parameters"]:
    """All combinations of a grid's values; the other parameters have those of `base`."""
    choices = (choice.values.reshape(-1, len(choice.places)) for choice in grid)
    rows = [np.concatenate(values) for values in itertools.product(*choices)]
    rows_of = np.tile(base, (len(rows), 1))
    rows_of[:, [place for choice in grid for place in choice.places]] = rows
    return rows_of


def size(grid: ScanGrid) -> int:
    return math.prod(choice.values[..., 0].size for choice in grid)


def thin_out(grids: list[ScanGrid]) -> None:
    """Leave out every other value, but the first, of the largest grid's longest axis, until they are few enough."""
    while sum(map(size, grids)) > MOST_TRIED:
        grid = max(grids, key=size)
        number = max(range(len(grid)), key=lambda k: max(grid[k].values.shape[:-1]))
        places, values = grid[number]
        axis = int(np.argmax(values.shape[:-1]))
        grid[number] = Choice(places, np.take(values, np.arange(0, values.shape[axis], 2), axis))


class Ball(NamedTuple):
    """A ball whose position is free: where its coordinates, by axis, and its index are among the unknowns."""

    name: str
    center: Values
    axes: dict[int, int]
    indices: tuple[int, ...]


def searched(problem: Problem, places: Iterable[int]) -> tuple[list[Ball], list[tuple[int, ...]]]:
    """The balls with a free position, and the free indices of other materials, each with its places, one a channel."""
    scene, names = problem.whole, problem.unknowns.names
    positions: dict[Address, tuple[Block, dict[int, int]]] = {}
    indices: dict[Address, tuple[int, ...]] = {}
    for place in places:
        address, block, attribute, _ = resolve(scene, names[place])
        if attribute.quantity.role == "position" and address.component is not None:
            positions.setdefault(address.entry, (block, {}))[1][address.component] = place
        elif attribute.quantity.role == "index":
            indices[address.entry] = (*indices.get(address.entry, ()), place)
    balls, used = [], list[Address]()
    for entry, (block, axes) in positions.items():
        material = material_of(scene, block)
        owned = [entry for entry in indices if (entry.group, entry.column) == (material.type.group, material.column)]
        index = tuple(place for entry in owned for place in indices[entry])
        balls.append(Ball(block.name, on_host(entry.read(scene)), axes, index))
        used += owned
    return balls, [places for entry, places in indices.items() if entry not in used]


def groups(problem: Problem) -> list[list[ScanGrid]]:
    """For each ball with a free position, and each index without one, the grids to try.

    Near the start these are all indices, all over the picture a few. A parameter that is neither, or that has a prior,
    stays where it starts: the solver finds it. Indices of one material, one a channel, take the same value in each
    trial.
    """
    scene, initial = problem.whole, problem.initial
    balls, others = searched(problem, np.flatnonzero(np.asarray(problem.prior.precision) == 0).tolist())

    def all_indices(places: tuple[int, ...]) -> ScanGrid:
        return [Choice.alike(places, INDICES if initial[places[-1]] >= 1 else BUBBLE_INDICES)] if places else []

    grids_of, taken_indices = [], set[tuple[int, ...]]()
    depth = int(np.argmax(np.abs(film_normal(scene.camera))))
    for ball in balls:
        # An index that a ball takes is not tried a second time with another one.
        index = () if ball.indices in taken_indices else ball.indices
        taken_indices.add(index)
        near = all_indices(index)
        for axis, place in ball.axes.items():
            # In radii; half and double do as well.
            shifts = np.array((-0.35, 0.0, 0.35) if axis == depth else (-0.5, -0.2, 0.0, 0.2, 0.5))
            scale = natural_scale(scene, problem.unknowns.names[place], problem.base.model)
            near.append(Choice((place,), (ball.center[axis] + scale * shifts)[:, None]))
        grids, far = [near], across_picture(scene.camera, ball.center, ball.axes)
        if far:
            grids.append([Choice.alike(index, FAR_INDICES), far] if index else [far])
        grids_of.append(grids)
    grids_of += [[all_indices(places)] for places in others]
    thin_out([grid for grids in grids_of for grid in grids])
    return grids_of


compiled_ray = jit(ray)
"""`ray` as one program for each number of points: a search asks from outside of all others."""


def looks(camera: Camera, u: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions, "3 *rays" in float64, of the rays through points of the picture."""
    rays = compiled_ray(camera, *(np.asarray(x, camera.viewpoint.dtype) for x in (u, v)))
    return on_host(rays[0]), on_host(rays[1])


def film_normal(camera: Camera) -> Float[np.ndarray, "3"]:
    """A vector, of any length, across the plane of the picture: the direction of its depth."""
    corner, right, up = looks(camera, np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0]))[1].T
    return np.cross(right - corner, up - corner)


def across_picture(camera: Camera, center: Float[np.ndarray, "3"], places: dict[int, int]) -> Choice | None:
    """Centers all over the picture at the depth of the present one; None if the center may not move that way.

    They lie in the plane across the picture's depth. If the depth is not free, or runs along an axis, that plane is the
    one across the nearest axis.
    """
    normal = film_normal(camera)
    depth = int(np.argmax(np.abs(normal)))
    if len(places) < 3 or np.count_nonzero(normal) == 1:
        places = {axis: place for axis, place in places.items() if axis != depth}
        normal = np.eye(3)[depth]
    if len(places) < 2:
        return None
    # Intersect the rays through a grid of places in the picture with that plane.
    spread = (np.arange(FAR) + 0.5) / FAR
    origin, direction = looks(camera, *np.meshgrid(spread, spread, indexing="ij"))
    away, ahead = np.tensordot(normal, center[:, None, None] - origin, 1), np.tensordot(normal, direction, 1)
    meets = away * ahead > 0
    if not meets.any():
        return None
    reach = away / np.where(meets, ahead, 1)
    # A ray that never comes to this plane, or meets it behind the camera, leaves the center where it is.
    points = np.where(meets, origin + reach * direction, center[:, None, None])
    return Choice(tuple(places.values()), np.moveaxis(points[list(places)], 0, -1))


def unseen_balls(solution: FitState) -> dict[str, tuple[str, ...]]:
    """The balls without which the picture explains the target as well: their free index and positions, by name.

    Each ball whose index is near 1 is moved out of sight, and the residuals with it and without it are compared.
    """
    problem = solution.problem
    names, values, unseen = problem.unknowns.names, problem.values(solution.y), dict[str, tuple[str, ...]]()

    def residuals(values: Values) -> Images:
        pairs = [(view, supersampled(view, problem.y_of(values), view.samples or 4)) for view in problem.views]
        return tuple(view.observation.with_bias(np.zeros_like(image)).residual(image) for view, image in pairs)

    for ball in searched(problem, range(len(names)))[0]:
        # Such a ball deflects light by less than a tenth of a radian; a search that finds nothing ends still nearer.
        if not ball.indices or np.any(np.abs(values[list(ball.indices)] - 1) >= 0.05):
            continue
        center, without = list(ball.axes.values()), values.copy()
        without[center] += 1e4 * problem.scale[center]  # Out of sight.
        if vuong_evidence(residuals(values), residuals(without)) < EVIDENCE:
            unseen[ball.name] = tuple(names[place] for place in (*ball.indices, *center))
    return unseen
