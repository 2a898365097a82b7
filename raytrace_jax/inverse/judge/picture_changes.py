"""How a picture changes with its free parameters and with the numbers that a fit takes for granted.

By differences of pictures of moved scenes: one program renders some pixels of any number of scenes, and compiles once.
"""

import dataclasses
import functools
import math
from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.judge.looked_at import LookedAt
from raytrace_jax.inverse.problem.fixed_numbers import FixedNumbers, inward_steps, moved_together
from raytrace_jax.inverse.problem.picture import Picture
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.geometry.camera import pixel_step
from raytrace_jax.tracer.programs.tiles import sample_offsets

STEP_64, STEP_32 = 1e-8, 3e-4
"""Share of its size by which a number is moved, by precision. In float64 so little that hardly any pixel jumps, which
no derivative sees, and 1e-5 of the difference is rounding: of points 1e-9 gives the same to a thousandth, with 1e-7
jumps are no longer told by their height. In float32 the root of the roundings."""

STEEPEST = 1e4
"""A pixel that changes by more than this for a change of a number by its own size has jumped: a silhouette that moves
across 4000 pixels changes one by 4000 at most."""


AT_ONCE = 8
"""Whole pictures of changes, each 15 MB at 640 x 480, that a film develops at once."""

WIDEST = 8
"""Pixels beyond which the tails of a point-spread function are left out."""

THIN = 16
"""One in so many of the pixels tells whether a number changes the picture at all: a thousand of 20000."""

COLOR_SAMPLES = 2
"""Points a pixel and side that tell how an edge-aware picture changes with a colour."""


@dataclasses.dataclass(frozen=True)
class Pixels:
    """Renders some pixels of moved scenes.

    Args:
        problem: what is fitted.
        y: the unknowns.
        looked: the pixels that are traced.
        edges: how they are sampled.
        offset: where in each pixel it is looked at, in pixels to the right and down from its point.
    """

    problem: Problem
    y: Float[Array, " parameters"]
    looked: LookedAt
    edges: EdgeMode
    offset: tuple[float, float] = (0.0, 0.0)

    @functools.cached_property
    def light(self) -> Float[np.ndarray, "3 height width"] | None:
        """The whole picture before the film, where the scene has a film."""
        if not self.problem.development.is_needed:
            return None
        return np.asarray(self.problem.picture_of_light(self.y, self.edges).image, np.float64)

    @functools.cached_property
    def judged(self) -> LookedAt:
        """The pixels of which is known what they see: where the film mixes pixels, those in the midst of others."""
        counts = np.asarray(self.problem.observation.root_weight) > 0
        return self.looked.inner(counts, margin_at(self.problem, self.y))

    @property
    def share(self) -> float:
        """Of a number's size, by which it is moved."""
        return STEP_64 if self.problem.observation.target.dtype == np.float64 else STEP_32

    @property
    def root_weight(self) -> Float[np.ndarray, " pixels"]:
        """Square roots of the pixels' weights."""
        return self.judged.of(np.asarray(self.problem.observation.root_weight, np.float64))

    @property
    def _where(self):
        """The arguments of the model's `points` but for the scenes."""
        step = None if self.edges == "point" else pixel_step(self.problem.scene.camera, self.problem.base)
        right, down = self.offset
        return self.problem.places(self.looked.column + right, self.looked.row + down), self.problem.base, step

    def points(self, offset: tuple[float, float] = (0.0, 0.0), by: int = 1) -> "Pixels":
        """Points in these pixels, or in every so many of them."""
        looked = LookedAt(*(x[::by] for x in self.looked))
        return dataclasses.replace(self, looked=looked, edges="point", offset=offset)

    def prepare(self) -> None:
        """Plan and compile what `render` will run, and run nothing."""
        self.problem.model.prepare_points(self.problem.scene_at(self.y), *self._where)

    def render(self, scenes: Scene) -> Float[np.ndarray, "scenes 3 pixels"]:
        """Of several scenes, before the film."""
        return self.problem.model.points(scenes, *self._where).astype(np.float64)

    def derivative(self, change, step: Float[np.ndarray, " changes"], size: Float[np.ndarray, " changes"]):
        """Of the weighted residual, from changes of the picture by steps; 0 where a pixel has jumped or is NaN.

        Args:
            change: of the picture before the film, "changes 3 pixels".
            step: by which a number was moved.
            size: how large the number is.
        """
        slope = change / step[:, None, None]
        slope = np.where(np.abs(slope) * size[:, None, None] <= STEEPEST, slope, 0.0)
        if self.light is None:
            return slope * self.root_weight
        found = np.zeros((len(slope), 3, len(self.judged.row)))
        for first in range(0, len(slope), AT_ONCE):
            some = slope[first : first + AT_ONCE]
            image = np.zeros((len(some), *self.light.shape))
            image[:, :, self.looked.row, self.looked.column] = some
            values, frame = self.problem.values(self.y), self.problem.frame()
            developed = self.problem.development.changes(self.light, image, values, frame)
            found[first : first + AT_ONCE] = self.judged.of(developed)
        return found * self.root_weight


def margin_at(problem: Problem, y: Float[Array, " parameters"]) -> int:
    """How many pixels around each have to be known, so that it is known what the film makes of it."""
    return min(math.ceil(problem.film_reach(y)), WIDEST)


def parameter_changes(pixels: Pixels) -> Float[np.ndarray, "parameters 3 pixels"]:
    """The derivative of the weighted residual by the value of each free parameter."""
    problem, values = pixels.problem, pixels.problem.values(pixels.y)
    places = np.array(problem.unknowns.light_places, int)
    count, size = len(places), problem.scale[places]
    rows = np.tile(values, (count + 1, 1))
    rows[np.arange(count), places] += pixels.share * size
    images = pixels.render(problem.scenes_with(rows))
    # The fit's own precision decides how far a number has moved.
    moved = np.asarray(problem.array(rows))[np.arange(count), places] - np.asarray(problem.array(values))[places]
    found = np.zeros((len(values), 3, len(pixels.judged.row)))
    found[places] = pixels.derivative(images[:-1] - images[-1], moved.astype(np.float64), size)
    if pixels.light is not None:
        still = Picture(problem.array(pixels.light), problem.array(np.zeros((count, *pixels.light.shape))))
        columns = problem.development.picture(still, pixels.y, problem.frame()).columns
        of_film = np.setdiff1d(np.arange(len(values)), places)
        slope = problem.slopes(pixels.y)[of_film, None, None]
        found[of_film] = pixels.judged.of(np.asarray(columns, np.float64)[of_film]) / slope * pixels.root_weight
    return found


def number_changes(pixels: Pixels, numbers: FixedNumbers) -> Float[np.ndarray, "fixed 3 pixels"]:
    """The same by each fixed number.

    Light of one colour stays light of that colour: the numbers of a colour move in one scene, each seen in its own
    channel. It moves no edge, so that a few points tell as much of a pixel as its edges would. What changes nothing at
    a few points and pixels, such as the index of an opaque wall, changes nothing.
    """
    steps = inward_steps(numbers, pixels.problem.scene_at(pixels.y), pixels.share)
    acts = np.any(differences([pixels.points(by=THIN)], numbers, steps) != 0, axis=(1, 2))
    is_color = np.array([parameter.is_color for parameter in numbers.parameters], bool)
    if pixels.edges == "aware":
        # Of a checker that shines the squares' size moves edges only, which no point sees.
        unseen = ~acts & ~is_color
        some = dataclasses.replace(pixels, looked=LookedAt(*(x[::THIN] for x in pixels.looked)))
        acts[unseen] = np.any(differences([some], numbers.where(unseen), steps[unseen]) != 0, axis=(1, 2))
    count = COLOR_SAMPLES if pixels.edges == "aware" else 1
    samples = [pixels.points((float(right), float(down))) for right, down in sample_offsets(count)]
    changes = np.zeros((len(steps), 3, len(pixels.looked.row)))
    for which, how in ((acts & ~is_color, [pixels]), (acts & is_color, samples)):
        if which.any():
            changes[which] = differences(how, numbers.where(which), steps[which])
    return pixels.derivative(changes, steps, np.where(numbers.size > 0, numbers.size, 1))


def differences(
    samples: Sequence[Pixels], numbers: FixedNumbers, steps: Float[np.ndarray, " fixed"]
) -> Float[np.ndarray, "fixed 3 pixels"]:
    """What a step of each number changes of the mean of some pictures."""
    scene = samples[0].problem.scene_at(samples[0].y)
    moved_with = [p.address.entry if p.is_color else p.address for p in numbers.parameters]
    turns = {address: turn for turn, address in enumerate(dict.fromkeys(moved_with))}
    turn = np.array([turns[address] for address in moved_with], int)
    rows = np.zeros((len(turns) + 1, len(steps)))
    rows[turn, np.arange(len(steps))] = steps
    scenes = moved_together(scene, numbers, rows)
    images = np.mean([pixels.render(scenes) for pixels in samples], axis=0)
    changes = images[turn] - images[-1]
    for k, parameter in enumerate(numbers.parameters):
        if parameter.is_color:
            changes[k, np.arange(3) != parameter.address.component] = 0
    return changes


def flat(changes: Float[np.ndarray, "changes 3 pixels"]) -> Float[np.ndarray, "changes rows"]:
    """As rows of a least-squares problem."""
    return changes.reshape(len(changes), -1)
