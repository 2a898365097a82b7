"""Columns of a check of the model: the derivative of the residual by each number, free or fixed, at some pixels."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy import ndimage

from ...scene.parameters import Parameter, resolve
from ...scene.scene import Scene, map_scenes
from ...tracer.geometry.camera import pixel_step
from ...tracer.pixels import sample_offsets
from ...util.numerics import TINY, on_host
from ..problem.fixed import inward_step, moved_together, number_size
from ..problem.problem import FitState, Problem
from ..problem.unknowns import Image, Mask, PixelIndices
from .structure import block_sums

CheckClock = Callable[[], None]
"""What is called before each few scenes are rendered; it raises to abort."""


class PixelSample(NamedTuple):
    """Pixels, by whole blocks.

    Args:
        block: number of the block in which each is; the pixels of one may err together.
        probability: that it was sampled; its weight is the inverse (Horvitz and Thompson 1952).
    """

    row: PixelIndices
    column: PixelIndices
    block: PixelIndices
    probability: Float[np.ndarray, " pixels"]

    def of(self, image: np.ndarray) -> np.ndarray:
        """The pixels' values in a picture, "*any height width", as "*any pixels"."""
        return image[..., self.row, self.column]


def draw_sample(
    counts: Mask, decides: Float[np.ndarray, "height width"], most: int, side: int, near: int
) -> PixelSample:
    """Choose blocks with probabilities in proportion to what is in them, by systematic sampling (Madow 1949).

    One draw u decides: a block is chosen where u plus the cumulative probability passes a whole number, so that as many
    are chosen as are wanted.

    Args:
        decides: how much each pixel decides.
        most: about so many pixels are chosen; all, if no more count.
        side: side in pixels of the blocks that are chosen.
        near: side of the blocks in which neighbours are taken to err together.
    """
    chosen_from, block = (blocks_of(counts.shape, each) for each in (side, near))
    pixels = block_sums(counts[None].astype(float), side).reshape(-1)
    probability = np.where(pixels > 0, 1.0, 0.0)
    if counts.sum() > most:
        # Mostly by what decides, three tenths spread evenly over the picture.
        size = block_sums(np.where(counts, decides, 0.0)[None], side).reshape(-1)
        size = 0.7 * size / max(size.sum(), TINY) + 0.3 * pixels / pixels.sum()
        # The largest, those above 1, are cut to 1, and the others grow to make up for it.
        order = np.argsort(-size)
        left = most - (np.cumsum(pixels[order]) - pixels[order])
        growth = left / np.maximum(np.cumsum((pixels * size)[order][::-1])[::-1], TINY)
        probability = np.minimum(growth[np.argmax(growth * size[order] <= 1)] * size, 1.0)
    steps = np.floor(np.cumsum(probability) + np.random.default_rng(0).uniform())
    chosen = np.diff(steps, prepend=np.floor(steps[0] - probability[0])) > 0
    chosen = (chosen | (probability >= 1)) & (pixels > 0)
    row, column = np.nonzero(counts & chosen[chosen_from])
    return PixelSample(row, column, block[row, column], probability[chosen_from[row, column]])


def blocks_of(shape: tuple[int, ...], side: int) -> Int[np.ndarray, "height width"]:
    """For each pixel of a picture the number of its block of `side` pixels a side."""
    row, column = (np.arange(count) // side for count in shape)
    return row[:, None] * -(-shape[1] // side) + column


@dataclasses.dataclass(frozen=True)
class SampledPicture:
    """The traced pixels of a fit's picture, rendered for moved scenes.

    Args:
        check_clock: called before each few scenes are rendered; raise in it to abort.
    """

    state: FitState
    traced: PixelSample
    check_clock: CheckClock = lambda: None

    @property
    def problem(self) -> Problem:
        return self.state.problem

    @property
    def is_aware(self) -> bool:
        """Whether the picture is edge-aware."""
        return self.state.stage.edges == "aware"

    @functools.cached_property
    def radiance(self) -> Image | None:
        """The whole picture before the film, where the scene has a film."""
        is_needed = self.problem.camera.is_needed
        found = self.problem.radiance(self.state.y, self.state.stage.edges) if is_needed else None
        return None if found is None else on_host(found.image)

    @functools.cached_property
    def sampled(self) -> PixelSample:
        """The traced pixels that count; where the film mixes pixels, those whose neighbours are traced as well."""
        is_known, margin = np.zeros(self.problem.observation.counts.shape, bool), margin_at(self.state)
        is_known[self.traced.row, self.traced.column] = True
        if margin:
            is_known = ndimage.binary_erosion(is_known, np.ones((2 * margin + 1,) * 2), border_value=1)
        kept = self.traced.of(is_known & self.problem.observation.counts)
        return PixelSample(*(part[kept] for part in self.traced))

    @property
    def step(self) -> float:
        """The fraction of its size by which a number is moved."""
        # In float64 so little that hardly any pixel jumps, which no derivative sees, and 1e-5 of the difference is
        # rounding: of points 1e-9 gives the same to a thousandth, with 1e-7 jumps are no longer told by their height.
        # In float32 the root of the roundings.
        return 1e-8 if self.problem.dtype == np.float64 else 3e-4

    @property
    def root_weight(self) -> Float[np.ndarray, "3 pixels"]:
        return self.sampled.of(on_host(self.problem.observation.root_weight))

    def render(
        self, scenes: Scene, is_aware: bool, offsets: Sequence[Sequence[float]] = ((0.0, 0.0),), thin: int = 1
    ) -> Float[np.ndarray, "scenes 3 pixels"]:
        """Render one in `thin` of the traced pixels of several scenes, before the camera's response.

        Args:
            is_aware: whether by areas; else by points.
            offsets: places in each pixel over which to take the mean, in pixels to the right and down from its point.
        """
        # Some at a time, for the clock: eight of 20,000 edge-aware pixels take some seconds.
        row, column = self.traced.row[::thin], self.traced.column[::thin]
        rendered, at_once = [], max(1, 160_000 // max(len(row), 1))
        pixel = pixel_step(self.problem.scene.camera, self.problem.base) if is_aware else None
        for first in range(0, len(scenes.camera.viewpoint), at_once):
            chunk, images = map_scenes(lambda x, first=first: np.asarray(x)[first : first + at_once], scenes), []
            for right, down in offsets:
                self.check_clock()
                points = self.problem.points(column + right, row + down)
                images.append(self.problem.model.points(chunk, points, self.problem.base, pixel))
            rendered.append(np.mean(on_host(images), axis=0))
        return np.concatenate(rendered)

    def derivative(self, change, step: Float[np.ndarray, " changes"], size: Float[np.ndarray, " changes"]):
        """Derivatives of the weighted residual, from differences of the traced pixels before the camera's response.

        Both are "changes 3 pixels", one for each number; they are 0 where a pixel jumped or is NaN.
        """
        # A silhouette that moves across 4000 pixels changes one by 4000 times its light for a change of a number by its
        # own size: a pixel that changes by more has jumped.
        slope = change / step[:, None, None]
        slope = np.where(np.abs(slope) * size[:, None, None] <= 1e4 * self.problem.observation.light_unit, slope, 0.0)
        if self.radiance is None:
            return slope * self.root_weight
        # The response takes whole pictures of changes, each 15 MB at 640 x 480: a few at once.
        values, frame, at_once = self.problem.values(self.state.y), self.problem.frame(), 8
        responses = np.zeros((len(slope), 3, len(self.sampled.row)))
        for first in range(0, len(slope), at_once):
            chunk = slope[first : first + at_once]
            image = np.zeros((len(chunk), *self.radiance.shape))
            image[:, :, self.traced.row, self.traced.column] = chunk
            changes = self.problem.camera.changes(self.radiance, image, values, frame)
            responses[first : first + at_once] = self.sampled.of(changes)
        return responses * self.root_weight


def margin_at(state: FitState) -> int:
    """Pixels around one that must be known for what the camera makes of it."""
    # Beyond 8 pixels the tails of a point-spread function are left out.
    return min(math.ceil(state.problem.response_reach(state.y)), 8)


def pixels_to_check(state: FitState, most: int = 20_000, check_clock: CheckClock = lambda: None) -> SampledPicture:
    """The pixels that stand for a picture: all, or a sample of about `most`.

    In a point-sampled picture some pixels at the rim of glass decide as much as all others, as their derivatives tell.
    Edge-aware pixels are chosen evenly: 8,000 of 19,200 by their derivatives tell how an estimate moves to a hundredth,
    but do not see a board whose squares are .05 % larger (an index 10 errors off), nor do 8,000 of which half are
    chosen by their residuals. 20,000 are all of 160 x 120.
    """
    counts, linearization = state.problem.observation.counts, state.linearization
    decides = np.ones(counts.shape)
    if state.stage.edges == "point":
        length = np.linalg.norm(on_host(linearization.jacobian), axis=0)
        jacobian = on_host(linearization.pixel_jacobian) / np.maximum(length, TINY)[:, None, None, None]
        decides = np.sqrt(np.sum(jacobian**2, axis=(0, 1)))
    margin, near = margin_at(state), state.problem.extent
    # Where the camera mixes pixels those in the midst of larger blocks are judged, and all around are traced.
    traced = np.ones_like(counts) if margin else counts
    sample = draw_sample(traced, np.where(counts, decides, 0.0), most, 8 * margin or near, near)
    return SampledPicture(state, sample, check_clock)


def free_columns(pixels: SampledPicture) -> Float[np.ndarray, "parameters 3 pixels"]:
    """The derivative of the weighted residual by the value of each free parameter.

    The linearisation has those of areas, in which footprints are held, where differences move them. The free numbers
    are to make up for the fixed ones, so that those of the scene are by differences as well; the response's are exact.
    """
    problem, unknowns = pixels.problem, pixels.problem.local
    slopes = problem.slopes(pixels.state.y)[:, None, None, None]
    columns = on_host(pixels.state.linearization.pixel_jacobian) / np.where(slopes, slopes, 1.0)
    columns = pixels.sampled.of(columns)
    numbers = {name: [resolve(problem.scene, name)] for name in unknowns.traced_unknowns.names}
    for follower, leader in unknowns.traced_unknowns.ties:
        numbers[leader].append(resolve(problem.scene, follower))
    columns[unknowns.traced] = number_columns(pixels, numbers)
    return columns


def number_columns(
    pixels: SampledPicture, numbers: Mapping[str, Sequence[Parameter]]
) -> Float[np.ndarray, "numbers 3 pixels"]:
    """The derivative of the weighted residual by each number of the scene, with those that are tied to it.

    Light of one colour stays light of that colour, so the three numbers of a colour move in one scene, and each is seen
    in its own channel. A colour moves no edge, so a few points tell as much of a pixel as its edges would. A number
    that changes nothing at a sample of the pixels, such as the index of an opaque wall, is taken to change nothing.
    """
    problem, parameters = pixels.problem, list(numbers.values())
    scene = problem.scene_at(pixels.state.y)
    sizes = np.array([number_size(problem.scene, leader.address) or 1.0 for leader, *_ in parameters])
    by_number = zip(parameters, pixels.step * sizes, strict=True)
    steps = np.array([inward_step(scene, leader, step) for (leader, *_), step in by_number])
    # Of tied colours each moves alone, all in one scene.
    is_color = np.array([tied[0].is_color and len(tied) == 1 for tied in parameters], bool)

    def differences(which: np.ndarray, is_aware: bool, **how) -> np.ndarray:
        """The changes by the chosen numbers: one scene for each number or colour, and last the one as it is."""
        chosen = np.flatnonzero(which).tolist()
        moved_with = [parameters[k][0].address.entry if is_color[k] else k for k in chosen]
        _, scene_of = np.unique([moved_with.index(key) for key in moved_with], return_inverse=True)
        rows = np.zeros((len(set(moved_with)) + 1, len(chosen)))
        rows[scene_of, np.arange(len(chosen))] = steps[which]
        tied = [(number, tied.address) for number, k in enumerate(chosen) for tied in parameters[k]]
        moved = moved_together(scene, [address for _, address in tied], rows[:, [number for number, _ in tied]])
        images = pixels.render(moved, is_aware, **how)
        changes = images[scene_of] - images[-1]
        # The channels of a colour moved together: each number has only its own.
        for change, k in zip(changes, chosen, strict=True):
            if is_color[k]:
                change[np.arange(3) != parameters[k][0].address.component] = 0
        return changes

    # Which numbers change anything, from one in 16 of the pixels: a thousand of 20000.
    acts = np.any(differences(np.ones(len(steps), bool), False, thin=16) != 0, axis=(1, 2))
    if pixels.is_aware:
        # The size of the squares of a checker that shines moves edges only, which no point sees.
        unseen = ~acts & ~is_color
        acts[unseen] = np.any(differences(unseen, True, thin=16) != 0, axis=(1, 2))

    changes = np.zeros((len(steps), 3, len(pixels.traced.row)))
    changes[acts & ~is_color] = differences(acts & ~is_color, pixels.is_aware)
    # Two points a pixel and side tell how an edge-aware picture changes with a colour.
    offsets = sample_offsets(2 if pixels.is_aware else 1).tolist()
    changes[acts & is_color] = differences(acts & is_color, False, offsets=offsets)
    return pixels.derivative(changes, steps, sizes)
