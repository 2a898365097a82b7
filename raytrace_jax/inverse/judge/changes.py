"""The picture's derivatives by each number, free or fixed, at the pixels that a check looks at."""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from raytrace_jax.inverse.judge.structure import square_sums
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.fixed import FixedNumbers, inward_steps, moved_together
from raytrace_jax.inverse.problem.linearize import Linearization
from raytrace_jax.inverse.problem.prediction import PredictedPicture
from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.inverse.problem.unknowns import Image, Mask, Vector
from raytrace_jax.scene.scene import Scene, map_scenes
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.geometry.camera import pixel_step
from raytrace_jax.tracer.pixels import sample_offsets
from raytrace_jax.util.numerics import TINY

SIDE = 4
"""Side in pixels of the squares that are looked at as a whole: neighbours which err together are seen together."""


class PixelSample(NamedTuple):
    """Pixels, by whole squares.

    Args:
        chance: that it was looked at; it stands for one over that many pixels.
    """

    row: Int[np.ndarray, " pixels"]
    column: Int[np.ndarray, " pixels"]
    square: Int[np.ndarray, " pixels"]
    chance: Float[np.ndarray, " pixels"]

    def of(self, image: np.ndarray) -> np.ndarray:
        """The pixels' values in a picture, "*any height width", as "*any pixels"."""
        return image[..., self.row, self.column]

    def inner(self, counts: Mask, margin: int) -> "PixelSample":
        """The pixels that count and whose neighbours, up to `margin` away, are all looked at or beyond the border."""
        seen = np.zeros(counts.shape, bool)
        seen[self.row, self.column] = True
        if margin:
            seen = ndimage.binary_erosion(seen, np.ones((2 * margin + 1,) * 2), border_value=1)
        kept = (seen & counts)[self.row, self.column]
        return PixelSample(*(part[kept] for part in self))


def draw_sample(
    counts: Mask, weight: Float[np.ndarray, "height width"], most: int, side: int = SIDE, together: int = SIDE
) -> PixelSample:
    """Choose squares at random, with a chance in proportion to what is in them (Horvitz and Thompson 1952).

    Args:
        together: side in pixels of the squares in which neighbours are taken to err together.
    """
    # The chance of each square: mostly by what decides, three tenths spread evenly over the picture.
    chosen_from, square = (squares_of(counts.shape, each) for each in (side, together))
    pixels = square_sums(counts[None].astype(float), side).reshape(-1)
    chance = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        size = square_sums(np.where(counts, weight, 0.0)[None], side).reshape(-1)
        even = 0.3
        size = (1 - even) * size / max(size.sum(), 1e-300) + even * pixels / pixels.sum()
        chance = chances(size, pixels, most)

    # Systematic sampling: one draw u decides. A square is chosen where u plus the cumulative chance passes a whole
    # number, so that as many are chosen as are wanted.
    steps = np.floor(np.cumsum(chance) + np.random.default_rng(0).uniform())
    chosen = np.diff(steps, prepend=np.floor(steps[0] - chance[0])) > 0
    chosen = (chosen | (chance >= 1)) & (pixels > 0)
    row, column = np.nonzero(counts & chosen[chosen_from])
    return PixelSample(row, column, square[row, column], chance[chosen_from[row, column]])


def squares_of(shape: tuple[int, ...], side: int) -> Int[np.ndarray, "height width"]:
    """The number of the square, of so many pixels a side, in which each pixel of a picture is."""
    height, width = shape
    number = np.arange(-(-height // side) * -(-width // side)).reshape(-(-height // side), -1)
    return np.repeat(np.repeat(number, side, 0), side, 1)[:height, :width]


def chances(size: Float[np.ndarray, " squares"], pixels: Float[np.ndarray, " squares"], most: int) -> np.ndarray:
    """Chances in proportion to sizes, at most 1, such that about `most` pixels are expected."""
    # Chances above 1 are cut to 1, and the others grow to make up for it, until none is above 1.
    chance = np.zeros_like(size)
    for _ in range(20):
        sure = chance >= 1
        left = most - pixels[sure].sum()
        rest = np.where(sure, 0.0, size)
        if left <= 0 or not rest.any():
            break
        chance = np.where(sure, 1.0, np.minimum(rest * left / (rest * pixels).sum(), 1.0))
        if np.array_equal(chance >= 1, sure):
            break
    return chance


@dataclasses.dataclass(frozen=True)
class SampledPicture:
    """Renders some pixels of moved scenes.

    Args:
        offset: where in each pixel it is looked at, in pixels to the right and down from its point.
        check_clock: called before each few scenes; what it raises ends the work.
    """

    problem: Problem
    y: Vector
    sample: PixelSample
    edges: EdgeMode
    offset: tuple[float, float] = (0.0, 0.0)
    check_clock: Callable[[], None] = lambda: None

    @functools.cached_property
    def radiance(self) -> Image | None:
        """The whole picture before the film, where the scene has a film."""
        if not self.problem.camera.is_needed:
            return None
        return np.asarray(self.problem.radiance(self.y, self.edges).image, np.float64)

    @functools.cached_property
    def judged(self) -> PixelSample:
        """The pixels whose colour is known; where the film mixes pixels, those whose neighbours are traced as well."""
        counts = np.asarray(self.problem.observation.root_weight) > 0
        return self.sample.inner(counts, margin_at(self.problem, self.y))

    @property
    def step(self) -> float:
        """The fraction of its size by which a number is moved."""
        # In float64 so little that hardly any pixel jumps, which no derivative sees, and 1e-5 of the difference is
        # rounding: of points 1e-9 gives the same to a thousandth, with 1e-7 jumps are no longer told by their height.
        # In float32 the root of the roundings.
        return 1e-8 if self.problem.observation.target.dtype == np.float64 else 3e-4

    @property
    def root_weight(self) -> Float[np.ndarray, " pixels"]:
        """Square roots of the pixels' weights."""
        return self.judged.of(np.asarray(self.problem.observation.root_weight, np.float64))

    @property
    def _where(self):
        """The arguments of the model's `points` but for the scenes."""
        step = None if self.edges == "point" else pixel_step(self.problem.scene.camera, self.problem.base)
        right, down = self.offset
        points = self.problem.raster().points(self.sample.column + right, self.sample.row + down)
        return points, self.problem.base, step

    def points(self, offset: tuple[float, float] = (0.0, 0.0), by: int = 1) -> "SampledPicture":
        """These pixels, or one in `by` of them, each seen at one point."""
        sample = PixelSample(*(x[::by] for x in self.sample))
        return dataclasses.replace(self, sample=sample, edges="point", offset=offset)

    def prepare(self) -> None:
        """Compile what `render` will run, and run nothing."""
        self.problem.model.prepare_points(self.problem.scene_at(self.y), *self._where[1:])

    def render(self, scenes: Scene) -> Float[np.ndarray, "scenes 3 pixels"]:
        """Render the pixels of several scenes, before the film."""
        # Some at a time, for the clock: eight of 20,000 edge-aware pixels take some seconds.
        found, at_once = [], max(1, 160_000 // max(len(self.sample.row), 1))
        for first in range(0, len(scenes.camera.viewpoint), at_once):
            self.check_clock()
            some = map_scenes(lambda x, first=first: np.asarray(x)[first : first + at_once], scenes)
            found.append(self.problem.model.points(some, *self._where).astype(np.float64))
        return np.concatenate(found)

    def derivative(self, change, step: Float[np.ndarray, " changes"], size: Float[np.ndarray, " changes"]):
        """Convert differences of pictures to derivatives of the weighted residual; 0 where a pixel jumped or is NaN.

        Args:
            change: difference of the pictures before the film, "changes 3 pixels", one for each number.
        """
        # A silhouette that moves across 4000 pixels changes one by 4000 times its light for a change of a number by its
        # own size: a pixel that changes by more has jumped.
        slope = change / step[:, None, None]
        slope = np.where(np.abs(slope) * size[:, None, None] <= 1e4 * self.problem.observation.light_unit, slope, 0.0)
        if self.radiance is None:
            return slope * self.root_weight
        # The film develops whole pictures of changes, each 15 MB at 640 x 480: a few at once.
        found, at_once = np.zeros((len(slope), 3, len(self.judged.row))), 8
        for first in range(0, len(slope), at_once):
            some = slope[first : first + at_once]
            image = np.zeros((len(some), *self.radiance.shape))
            image[:, :, self.sample.row, self.sample.column] = some
            values, frame = self.problem.values(self.y), self.problem.raster().frame
            developed = self.problem.camera.changes(self.radiance, image, values, frame)
            found[first : first + at_once] = self.judged.of(developed)
        return found * self.root_weight


def extent_of(problem: Problem) -> int:
    """Side in pixels of the squares in which neighbours err together, by what stages say of themselves."""
    return max((stage.extent for stage in problem.stages), default=1)


def margin_at(problem: Problem, y: Vector) -> int:
    """Pixels around one that must be known for its developed colour."""
    # Beyond 8 pixels the tails of a point-spread function are left out.
    return min(math.ceil(problem.camera.reach(problem.values(y))), 8)


def pixels_to_check(
    problem: Problem, y: Vector, stage: Stage, linearization: Linearization | None = None
) -> SampledPicture:
    """The pixels that stand for a picture.

    In a point-sampled picture some pixels at the rim of glass decide as much as all others: pixels are chosen in
    proportion to their derivatives. Edge-aware pixels are alike, and each takes longer where many are at edges than
    one of a whole picture: they are chosen evenly, and need no linearization.
    """
    # All of 160 x 120: some seconds of points, about ten of edge-aware pixels.
    most = 20_000
    counts = np.asarray(problem.observation.root_weight) > 0
    decides = np.ones(counts.shape)
    if stage.edges == "point" and linearization is not None:
        length = np.linalg.norm(np.asarray(linearization.jacobian, np.float64), axis=0)
        jacobian = np.asarray(linearization.pixel_jacobian, np.float64) / np.maximum(length, TINY)[:, None, None, None]
        decides = np.sqrt(np.sum(jacobian**2, axis=(0, 1)))
    margin = margin_at(problem, y)
    together = extent_of(problem)
    if not margin:
        return SampledPicture(problem, y, draw_sample(counts, decides, most, together, together), stage.edges)
    # The film mixes pixels: those in the midst of larger squares are judged, and all around them are looked at.
    sample = draw_sample(np.ones_like(counts), np.where(counts, decides, 0.0), most, SIDE * 2 * margin, together)
    return SampledPicture(problem, y, sample, stage.edges)


def parameter_changes(pixels: SampledPicture) -> Float[np.ndarray, "parameters 3 pixels"]:
    """The derivative of the weighted residual by the value of each free parameter."""
    # The scene's parameters: one moved scene for each, and last the one as it is.
    problem, values = pixels.problem, pixels.problem.values(pixels.y)
    places = np.array(problem.unknowns.traced, int)
    count, size = len(places), problem.scale[places]
    rows = np.tile(values, (count + 1, 1))
    rows[np.arange(count), places] += pixels.step * size
    images = pixels.render(problem.scenes_with(rows))
    # The fit's own precision decides how far a number has moved.
    moved = np.asarray(problem.array(rows))[np.arange(count), places] - np.asarray(problem.array(values))[places]
    found = np.zeros((len(values), 3, len(pixels.judged.row)))
    found[places] = pixels.derivative(images[:-1] - images[-1], moved.astype(np.float64), size)
    # The film's parameters: the film knows its derivatives, and the light stays as it is.
    if pixels.radiance is not None:
        still = PredictedPicture(
            problem.array(pixels.radiance), problem.array(np.zeros((count, *pixels.radiance.shape)))
        )
        jacobian = problem.camera.picture(still, pixels.y, problem.raster().frame).jacobian
        of_film = np.setdiff1d(np.arange(len(values)), places)
        slope = problem.slopes(pixels.y)[of_film, None, None]
        found[of_film] = pixels.judged.of(np.asarray(jacobian, np.float64)[of_film]) / slope * pixels.root_weight
    return found


def number_changes(pixels: SampledPicture, numbers: FixedNumbers) -> Float[np.ndarray, "fixed 3 pixels"]:
    """The derivative of the weighted residual by each fixed number.

    Light of one colour stays light of that colour, so the three numbers of a colour move in one scene, and each is seen
    in its own channel. A colour moves no edge, so a few points tell as much of a pixel as its edges would. A number
    that changes nothing at a sample of the pixels, such as the index of an opaque wall, is taken to change nothing.
    """
    # Which numbers change anything, from one in 16 of the pixels: a thousand of 20000.
    thin = 16
    steps = inward_steps(numbers, pixels.problem.scene_at(pixels.y), pixels.step)
    acts = np.any(differences([pixels.points(by=thin)], numbers, steps) != 0, axis=(1, 2))
    is_color = np.array([parameter.is_color for parameter in numbers.parameters], bool)
    if pixels.edges == "aware":
        # The size of the squares of a checker that shines moves edges only, which no point sees.
        unseen = ~acts & ~is_color
        some = dataclasses.replace(pixels, sample=PixelSample(*(x[::thin] for x in pixels.sample)))
        acts[unseen] = np.any(differences([some], numbers.where(unseen), steps[unseen]) != 0, axis=(1, 2))

    # Two points a pixel and side tell how an edge-aware picture changes with a colour.
    count = 2 if pixels.edges == "aware" else 1
    samples = [pixels.points((float(right), float(down))) for right, down in sample_offsets(count)]
    changes = np.zeros((len(steps), 3, len(pixels.sample.row)))
    for which, how in ((acts & ~is_color, [pixels]), (acts & is_color, samples)):
        if which.any():
            changes[which] = differences(how, numbers.where(which), steps[which])
    return pixels.derivative(changes, steps, np.where(numbers.size > 0, numbers.size, 1))


def differences(
    samples: Sequence[SampledPicture], numbers: FixedNumbers, steps: Float[np.ndarray, " fixed"]
) -> Float[np.ndarray, "fixed 3 pixels"]:
    """The change of the mean of some pictures with a step of each number."""
    # One scene for each number or colour, and last the one as it is.
    scene = samples[0].problem.scene_at(samples[0].y)
    moved_with = [p.address.entry if p.is_color else p.address for p in numbers.parameters]
    turns = {address: turn for turn, address in enumerate(dict.fromkeys(moved_with))}
    turn = np.array([turns[address] for address in moved_with], int)
    rows = np.zeros((len(turns) + 1, len(steps)))
    rows[turn, np.arange(len(steps))] = steps
    scenes = moved_together(scene, numbers, rows)
    images = np.mean([pixels.render(scenes) for pixels in samples], axis=0)
    changes = images[turn] - images[-1]
    # The channels of a colour moved together: each number has only its own.
    for k, parameter in enumerate(numbers.parameters):
        if parameter.is_color:
            changes[k, np.arange(3) != parameter.address.component] = 0
    return changes


def flat(changes: Float[np.ndarray, "changes 3 pixels"]) -> Float[np.ndarray, "changes rows"]:
    """Changes of pixels as rows of a least-squares problem."""
    return changes.reshape(len(changes), -1)
