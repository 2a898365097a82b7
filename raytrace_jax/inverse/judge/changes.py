"""The picture's derivatives by each number, free or fixed, at the pixels that a check looks at."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from ...scene.parameters import Parameter
from ...scene.scene import Scene, map_scenes
from ...scene.setting_words import EdgeMode
from ...tracer.geometry.camera import pixel_step
from ...tracer.pixels import sample_offsets
from ...util.numerics import TINY
from ..options import Stage
from ..problem.fixed import inward_step, moved_together, number_size
from ..problem.linearize import Linearization
from ..problem.prediction import PredictedPicture
from ..problem.problem import Problem
from ..problem.unknowns import Image, Mask, Vector
from .structure import square_sums


class PixelSample(NamedTuple):
    """Pixels, by whole squares.

    Args:
        square: number of the square in which each is; the pixels of one may err together.
        probability: that it was sampled; its weight is the inverse (Horvitz and Thompson 1952).
    """

    row: Int[np.ndarray, " pixels"]
    column: Int[np.ndarray, " pixels"]
    square: Int[np.ndarray, " pixels"]
    probability: Float[np.ndarray, " pixels"]

    def of(self, image: np.ndarray) -> np.ndarray:
        """The pixels' values in a picture, "*any height width", as "*any pixels"."""
        return image[..., self.row, self.column]


def draw_sample(counts: Mask, weight: Float[np.ndarray, "height width"], most: int, side: int, near: int):
    """Choose squares with probabilities in proportion to what is in them, by systematic sampling (Madow 1949).

    One draw u decides: a square is chosen where u plus the cumulative probability passes a whole number, so that as
    many are chosen as are wanted.

    Args:
        most: about so many pixels are chosen; all, if no more count.
        side: side in pixels of the squares that are chosen.
        near: side of the squares in which neighbours are taken to err together.
    """
    chosen_from, square = (squares_of(counts.shape, each) for each in (side, near))
    pixels = square_sums(counts[None].astype(float), side).reshape(-1)
    probability = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        # Mostly by what decides, three tenths spread evenly over the picture.
        size = square_sums(np.where(counts, weight, 0.0)[None], side).reshape(-1)
        size = 0.7 * size / max(size.sum(), TINY) + 0.3 * pixels / pixels.sum()
        # What is above 1 is cut to 1, and the others grow to make up for it, until none is above 1.
        probability = np.zeros_like(size)
        for _ in range(20):
            rest, left = np.where(probability >= 1, 0.0, size), most - pixels[probability >= 1].sum()
            if left <= 0 or not rest.any():
                break
            larger = np.minimum(rest * left / (rest * pixels).sum(), 1.0)
            probability = np.where(probability >= 1, 1.0, larger)
    steps = np.floor(np.cumsum(probability) + np.random.default_rng(0).uniform())
    chosen = np.diff(steps, prepend=np.floor(steps[0] - probability[0])) > 0
    chosen = (chosen | (probability >= 1)) & (pixels > 0)
    row, column = np.nonzero(counts & chosen[chosen_from])
    return PixelSample(row, column, square[row, column], probability[chosen_from[row, column]])


def squares_of(shape: tuple[int, ...], side: int) -> Int[np.ndarray, "height width"]:
    """The number of the square, of so many pixels a side, in which each pixel of a picture is."""
    row, column = (np.arange(count) // side for count in shape)
    return row[:, None] * -(-shape[1] // side) + column


@dataclasses.dataclass(frozen=True)
class SampledPicture:
    """Renders the traced pixels of moved scenes; calls `check_clock` before each few, whose error ends the work."""

    problem: Problem
    y: Vector
    traced: PixelSample
    edges: EdgeMode
    check_clock: Callable[[], None] = lambda: None

    @functools.cached_property
    def radiance(self) -> Image | None:
        """The whole picture before the film, where the scene has a film."""
        is_needed = self.problem.camera.is_needed
        return np.asarray(self.problem.radiance(self.y, self.edges).image, np.float64) if is_needed else None

    @functools.cached_property
    def sampled(self) -> PixelSample:
        """The traced pixels that count; where the film mixes pixels, those whose neighbours are traced as well."""
        seen, margin = np.zeros(self.problem.observation.counts.shape, bool), margin_at(self.problem, self.y)
        seen[self.traced.row, self.traced.column] = True
        if margin:
            seen = ndimage.binary_erosion(seen, np.ones((2 * margin + 1,) * 2), border_value=1)
        kept = self.traced.of(seen & self.problem.observation.counts)
        return PixelSample(*(part[kept] for part in self.traced))

    @property
    def step(self) -> float:
        """The fraction of its size by which a number is moved."""
        # In float64 so little that hardly any pixel jumps, which no derivative sees, and 1e-5 of the difference is
        # rounding: of points 1e-9 gives the same to a thousandth, with 1e-7 jumps are no longer told by their height.
        # In float32 the root of the roundings.
        return 1e-8 if self.problem.observation.target.dtype == np.float64 else 3e-4

    @property
    def root_weight(self) -> Float[np.ndarray, "3 pixels"]:
        return self.sampled.of(np.asarray(self.problem.observation.root_weight, np.float64))

    def _step_of(self, edges: EdgeMode) -> Float[np.ndarray, "2"] | None:
        return None if edges == "point" else pixel_step(self.problem.scene.camera, self.problem.base)

    def render(
        self, scenes: Scene, edges: EdgeMode, offsets: Sequence[Sequence[float]] = ((0.0, 0.0),), thin: int = 1
    ) -> Float[np.ndarray, "scenes 3 pixels"]:
        """Render one in `thin` of the traced pixels of several scenes, before the film.

        Args:
            offsets: places in each pixel over which to take the mean, in pixels to the right and down from its point.
        """
        # Some at a time, for the clock: eight of 20,000 edge-aware pixels take some seconds.
        row, column = self.traced.row[::thin], self.traced.column[::thin]
        found, at_once = [], max(1, 160_000 // max(len(row), 1))
        for first in range(0, len(scenes.camera.viewpoint), at_once):
            some, images = map_scenes(lambda x, first=first: np.asarray(x)[first : first + at_once], scenes), []
            for right, down in offsets:
                self.check_clock()
                points = self.problem.raster().points(column + right, row + down)
                images.append(self.problem.model.points(some, points, self.problem.base, self._step_of(edges)))
            found.append(np.mean(np.asarray(images, np.float64), axis=0))
        return np.concatenate(found)

    def derivative(self, change, step: Float[np.ndarray, " changes"], size: Float[np.ndarray, " changes"]):
        """Convert differences of the traced pixels before the film, "changes 3 pixels", one for each number.

        They become derivatives of the weighted residual; 0 where a pixel jumped or is NaN.
        """
        # A silhouette that moves across 4000 pixels changes one by 4000 times its light for a change of a number by its
        # own size: a pixel that changes by more has jumped.
        slope = change / step[:, None, None]
        slope = np.where(np.abs(slope) * size[:, None, None] <= 1e4 * self.problem.observation.light_unit, slope, 0.0)
        if self.radiance is None:
            return slope * self.root_weight
        # The film develops whole pictures of changes, each 15 MB at 640 x 480: a few at once.
        values, frame, at_once = self.problem.values(self.y), self.problem.raster().frame, 8
        found = np.zeros((len(slope), 3, len(self.sampled.row)))
        for first in range(0, len(slope), at_once):
            some = slope[first : first + at_once]
            image = np.zeros((len(some), *self.radiance.shape))
            image[:, :, self.traced.row, self.traced.column] = some
            developed = self.problem.camera.changes(self.radiance, image, values, frame)
            found[first : first + at_once] = self.sampled.of(developed)
        return found * self.root_weight


def extent_of(problem: Problem) -> int:
    """Side in pixels of the squares in which neighbours err together, by what stages say of themselves."""
    return max((stage.extent for stage in problem.stages), default=1)


def margin_at(problem: Problem, y: Vector) -> int:
    """Pixels around one that must be known for its developed colour."""
    # Beyond 8 pixels the tails of a point-spread function are left out.
    return min(math.ceil(problem.camera.reach(problem.values(y))), 8)


def pixels_to_check(
    problem: Problem, y: Vector, stage: Stage, linearization: Linearization | None = None, most: int = 20_000
) -> SampledPicture:
    """The pixels that stand for a picture, about so many at most.

    In a point-sampled picture some pixels at the rim of glass decide as much as all others: pixels are chosen in
    proportion to their derivatives. Edge-aware pixels are chosen evenly: 8,000 of 19,200 by their derivatives tell how
    an estimate moves to a hundredth, but do not see a board whose squares are .05 % larger (an index 10 errors off),
    nor do 8,000 of which half are chosen by their residuals. 20,000 are all of 160 x 120.
    """
    counts = problem.observation.counts
    decides = np.ones(counts.shape)
    if stage.edges == "point" and linearization is not None:
        length = np.linalg.norm(np.asarray(linearization.jacobian, np.float64), axis=0)
        jacobian = np.asarray(linearization.pixel_jacobian, np.float64) / np.maximum(length, TINY)[:, None, None, None]
        decides = np.sqrt(np.sum(jacobian**2, axis=(0, 1)))
    margin, near = margin_at(problem, y), extent_of(problem)
    if margin:  # The film mixes pixels: those in the midst of larger squares are sampled, and all around are traced.
        sample = draw_sample(np.ones_like(counts), np.where(counts, decides, 0.0), most, 8 * margin, near)
    else:
        sample = draw_sample(counts, decides, most, near, near)
    return SampledPicture(problem, y, sample, stage.edges)


def parameter_changes(pixels: SampledPicture) -> Float[np.ndarray, "parameters 3 pixels"]:
    """The derivative of the weighted residual by the value of each free parameter.

    A linearization has it as well, but the free numbers are to make up for the fixed ones: both are by differences, and
    err alike where a pixel jumps or an edge is sampled.
    """
    # The scene's parameters: one moved scene for each, and last the one as it is.
    problem, values = pixels.problem, pixels.problem.values(pixels.y)
    places = np.array(problem.unknowns.traced, int)
    count, size = len(places), problem.scale[places]
    rows = np.tile(values, (count + 1, 1))
    rows[np.arange(count), places] += pixels.step * size
    images = pixels.render(problem.scenes_with(rows), pixels.edges)
    # The fit's own precision decides how far a number has moved.
    moved = np.asarray(problem.array(rows))[np.arange(count), places] - np.asarray(problem.array(values))[places]
    found = np.zeros((len(values), 3, len(pixels.sampled.row)))
    found[places] = pixels.derivative(images[:-1] - images[-1], moved.astype(np.float64), size)
    # The film's parameters: the film knows its derivatives, and the light stays as it is.
    if pixels.radiance is not None:
        still = np.zeros((count, *pixels.radiance.shape))
        picture = PredictedPicture(problem.array(pixels.radiance), problem.array(still))
        jacobian = problem.camera.picture(picture, pixels.y, problem.raster().frame).jacobian
        of_film = np.setdiff1d(np.arange(len(values)), places)
        slope = problem.slopes(pixels.y)[of_film, None, None]
        found[of_film] = pixels.sampled.of(np.asarray(jacobian, np.float64)[of_film]) / slope * pixels.root_weight
    return found


def number_changes(pixels: SampledPicture, numbers: Mapping[str, Parameter]) -> Float[np.ndarray, "fixed 3 pixels"]:
    """The derivative of the weighted residual by each fixed number.

    Light of one colour stays light of that colour, so the three numbers of a colour move in one scene, and each is seen
    in its own channel. A colour moves no edge, so a few points tell as much of a pixel as its edges would. A number
    that changes nothing at a sample of the pixels, such as the index of an opaque wall, is taken to change nothing.
    """
    problem, parameters, is_aware = pixels.problem, list(numbers.values()), pixels.edges == "aware"
    scene = problem.scene_at(pixels.y)
    sizes = np.array([number_size(problem.scene, parameter.address) or 1.0 for parameter in parameters])
    steps = np.array([inward_step(scene, *each) for each in zip(parameters, pixels.step * sizes, strict=True)])
    is_color = np.array([parameter.is_color for parameter in parameters], bool)

    def differences(which: np.ndarray, edges: EdgeMode, **how) -> np.ndarray:
        """The changes by the chosen numbers: one scene for each number or colour, and last the one as it is."""
        chosen = [(parameters[k].address, is_color[k]) for k in np.flatnonzero(which)]
        moved_with = [address.entry if colored else address for address, colored in chosen]
        _, place = np.unique([moved_with.index(one) for one in moved_with], return_inverse=True)
        rows = np.zeros((len(set(moved_with)) + 1, len(chosen)))
        rows[place, np.arange(len(chosen))] = steps[which]
        images = pixels.render(moved_together(scene, [address for address, _ in chosen], rows), edges, **how)
        changes = images[place] - images[-1]
        # The channels of a colour moved together: each number has only its own.
        for change, (address, colored) in zip(changes, chosen, strict=True):
            if colored:
                change[np.arange(3) != address.component] = 0
        return changes

    # Which numbers change anything, from one in 16 of the pixels: a thousand of 20000.
    acts = np.any(differences(np.ones(len(steps), bool), "point", thin=16) != 0, axis=(1, 2))
    if is_aware:
        # The size of the squares of a checker that shines moves edges only, which no point sees.
        unseen = ~acts & ~is_color
        acts[unseen] = np.any(differences(unseen, "aware", thin=16) != 0, axis=(1, 2))

    changes = np.zeros((len(steps), 3, len(pixels.traced.row)))
    changes[acts & ~is_color] = differences(acts & ~is_color, pixels.edges)
    # Two points a pixel and side tell how an edge-aware picture changes with a colour.
    offsets = sample_offsets(2 if is_aware else 1).tolist()
    changes[acts & is_color] = differences(acts & is_color, "point", offsets=offsets)
    return pixels.derivative(changes, steps, sizes)
