"""The problem of a fit, a scene with free numbers beside a target, and the state of a fit at one place."""

import dataclasses
import functools
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int, Num

from raytrace_jax.images.jpeg import JpegStorage
from raytrace_jax.inverse.options import Stage
from raytrace_jax.inverse.problem.forward import (
    Development,
    ForwardModel,
    Observation,
    PredictedPicture,
    forward_model,
    nearest_power,
)
from raytrace_jax.inverse.problem.linearize import Linearization, evaluate, linearize
from raytrace_jax.inverse.problem.unknowns import (
    Covariance,
    Image,
    Mask,
    Prior,
    Unknowns,
    Values,
    Vector,
    moved_scene,
    moved_scenes,
    natural_scale,
    values_and_slopes,
)
from raytrace_jax.scene.response import Frame, light_reach
from raytrace_jax.scene.scene import Scene, with_texels, without_texels
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.geometry.camera import picture_place, pixel_step
from raytrace_jax.tracer.pixels import Pixels
from raytrace_jax.tracer.resolved_settings import ResolvedSettings


@dataclasses.dataclass(frozen=True)
class Problem:
    """A scene, a target, and what is free between them.

    Args:
        unit: the light that a weighted residual of 1 is at a weight of 1.
    """

    scene: Scene
    observation: Observation
    unknowns: Unknowns
    prior: Prior
    base: ResolvedSettings
    storage: JpegStorage | None = None
    unit: float = 1.0
    # What was traced last; a copy with another observation has the same pictures.
    _pictures: OrderedDict[Hashable, PredictedPicture] = dataclasses.field(repr=False, default_factory=OrderedDict)
    # Not an argument, so that a copy with another observation does not keep the old one's.
    _binned: dict[int, Observation] = dataclasses.field(init=False, repr=False, default_factory=dict)

    @property
    def model(self) -> ForwardModel:
        """The program that computes the scene's pictures."""
        return forward_model(self.scene)

    def settings(self, edges: EdgeMode, binning: int = 1) -> ResolvedSettings:
        """The settings of the whole picture in the target's own or in larger pixels; the target is its `frame`."""
        return dataclasses.replace(self.base, edges=edges, binning=self.base.binning * binning, crop=None)

    def binned(self, binning: int) -> Observation:
        """The target in larger pixels."""
        if binning not in self._binned:
            self._binned[binning] = self.observation.binned(binning) if binning > 1 else self.observation
        return self._binned[binning]

    def with_bias(self, bias: ArrayLike) -> "Problem":
        """Give the pictures of this problem another bias, "3 height width"."""
        observation = dataclasses.replace(self.observation, bias=self.array(bias))
        return dataclasses.replace(self, observation=observation)

    def weighted(self, weight: Float[np.ndarray, "height width"]) -> "Problem":
        """Multiply each pixel's weight by a factor."""
        root = self.array(np.asarray(self.observation.root_weight) * np.sqrt(weight))
        return dataclasses.replace(self, observation=dataclasses.replace(self.observation, root_weight=root))

    @property
    def light_unit(self) -> float:
        """How large the target's light is."""
        return self.observation.light_unit

    def in_own_unit(self) -> "Problem":
        """The same problem, whose residuals have no unit: about 1 where the picture is black and the target is not.

        So no tolerance knows the unit of light or of weights. Powers of two change no digit.
        """
        root = np.asarray(self.observation.root_weight, np.float64)
        unit = self.light_unit * nearest_power(np.sqrt(np.mean(root[root > 0] ** 2)))
        observation = dataclasses.replace(self.observation, root_weight=self.array(root / unit))
        return dataclasses.replace(self, observation=observation, unit=self.unit * unit)

    def frame(self, binning: int = 1) -> Frame:
        """The target's part of the whole picture, in its own or in larger pixels.

        A crop begins between larger pixels of the whole picture: they are laid from its corner on.
        """
        own = self.base.frame(self.scene.camera.pixeldim)
        return own._replace(left=own.left / binning, top=own.top / binning, binning=own.binning * binning)

    def picture_points(
        self, column: Num[np.ndarray, " points"], row: Num[np.ndarray, " points"], binning: int = 1
    ) -> Float[np.ndarray, "2 points"]:
        """Places in the whole picture of points of the target, in its own or in larger pixels."""
        settings, frame = self.settings("point", binning), self.frame(binning)
        return np.stack(picture_place(self.scene.camera, settings, column + frame.left, row + frame.top))

    def all_pixels(self, binning: int = 1) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"]]:
        """Columns and rows of all pixels of the target in their order, in own or in larger ones."""
        height, width = self.binned(binning).root_weight.shape
        row, column = np.divmod(np.arange(width * height), width)
        return column, row

    def pixels(self, binning: int = 1) -> Pixels:
        """All pixels of the target, in own or in larger ones."""
        step = pixel_step(self.scene.camera, self.settings("point", binning))
        return Pixels(self.picture_points(*self.all_pixels(binning), binning), step)

    def start(self) -> Vector:
        """The unknowns at the start."""
        return self.array(self.unknowns.unknowns(self.unknowns.initial(self.scene)))

    def array(self, values: ArrayLike | Sequence[float]) -> Array:
        """Unknowns, values, or pictures in the fit's dtype, as an argument of its programs.

        They go by way of the host: an array on several devices is another kind of argument, and would compile anew.
        """
        return jnp.asarray(np.asarray(values), self.observation.target.dtype)

    def values(self, y: Vector) -> Values:
        """The parameters' values at unknowns `y`."""
        return np.asarray(values_and_slopes(self.array(y), self.unknowns)[0], np.float64)

    def slopes(self, y: Vector) -> Values:
        """The derivative of each parameter's value by its unknown at `y`."""
        return np.asarray(values_and_slopes(self.array(y), self.unknowns)[1], np.float64)

    @functools.cached_property
    def scale(self) -> Values:
        """The natural scales of the parameters: how large a large change of each is."""
        return np.array(
            [natural_scale(self.scene, name, self.base.model, self.light_unit) for name in self.unknowns.names]
        )

    def scaled_distance(self, one: Values, other: Values) -> float:
        """The largest difference of any value, in natural scales."""
        return float(np.max(np.abs(one - other) / self.scale))

    def scene_at(self, y: Vector) -> Scene:
        """The scene at unknowns `y`."""
        moved = moved_scene(without_texels(self.scene), self.array(self.values(y)), self.unknowns)
        return with_texels(moved, self.scene)

    @functools.cached_property
    def traced_scene(self) -> Scene:
        """The scene without its film: what is traced."""
        return dataclasses.replace(self.scene, film=None)

    @functools.cached_property
    def development(self) -> Development:
        """The camera's response to the scene's light."""
        return Development(self.scene, self.unknowns)

    @property
    def linear_indices(self) -> tuple[int, ...]:
        """The places of the film's unknowns whose best values have a closed form."""
        return self.development.linear_indices(np.asarray(self.prior.precision))

    def film_reach(self, y: Vector) -> float:
        """The distance in pixels from which the light of a pixel may come; 0 if all of it is its own."""
        return light_reach(self.development.film(self.values(y)))

    @functools.cached_property
    def balls_outside(self) -> Bool[np.ndarray, " spheres"]:
        """The balls in which the scene's camera is not."""
        return gaps(self.scene) > 0

    def is_possible(self, y: Vector) -> bool:
        """Whether the camera is in no ball in which it was not at the start."""
        return bool(np.all(gaps(self.scene_at(y))[self.balls_outside] > 0))

    def scenes_with(self, values: Float[np.ndarray, "scenes parameters"]) -> Scene:
        """Scenes without film that have these values of the other free parameters, stacked as by `map_scenes`."""
        rows = self.array(values[:, list(self.unknowns.traced)])
        moved = moved_scenes(without_texels(self.traced_scene), rows, self.unknowns.traced_unknowns)
        return with_texels(moved, self.scene)

    def picture(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture at `y` and its derivatives."""
        y = self.array(y)
        return self.development.picture(self.radiance(y, edges, binning), y, self.frame(binning))

    def radiance(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture before the film, and its derivatives by the unknowns that are not the film's.

        The last few pictures are remembered: one point is looked at with several blurs, losses, targets and films.
        """
        traced, unknowns = self.traced_at(y), self.unknowns.traced_unknowns
        place = np.asarray(traced).tobytes(), edges, binning
        if place in self._pictures:
            self._pictures.move_to_end(place)
            return self._pictures[place]

        pixels, size = self.pixels(binning), self.binned(binning).root_weight.shape
        found = self.model.differentiate(traced, self.traced_scene, pixels, unknowns, self.settings(edges, binning))
        image, jacobian = found.color.reshape(3, *size), found.jacobian.reshape(-1, 3, *size)
        sees_edge = found.sees_edge.reshape(size) if edges == "aware" else None
        picture = PredictedPicture(self.array(image), self.array(jacobian), sees_edge)
        self._pictures[place] = picture
        # Three are kept: after a rejected step the solver goes on from where the step began.
        while len(self._pictures) > 3:
            self._pictures.popitem(last=False)
        return picture

    def traced_at(self, y: Vector) -> Float[Array, " light"]:
        """The unknowns that are not the film's."""
        return self.array(np.asarray(y)[list(self.unknowns.traced)])

    def linearize(self, y: Vector, stage: Stage) -> Linearization:
        """Residual and Jacobian at `y`."""
        picture = self.picture(y, stage.edges, stage.binning)
        return self.linearize_picture(picture, y, stage)

    def linearize_picture(self, picture: PredictedPicture, y: Vector, stage: Stage) -> Linearization:
        """Residual and Jacobian at `y` from a picture and derivatives that are given."""
        picture = dataclasses.replace(picture, sees_edge=None)  # Not a matter of this program.
        return linearize(picture, *self._compared(y, stage), stage.loss)

    def prepare_linearize(self, y: Vector, stage: Stage) -> None:
        """Compile what `linearize` will run, and run nothing."""
        settings = self.settings(stage.edges, stage.binning)
        self.model.prepare_differentiate(self.traced_at(y), self.traced_scene, self.unknowns.traced_unknowns, settings)
        target = self.binned(stage.binning).target
        jacobian = jnp.zeros((len(self.unknowns.names), *target.shape), target.dtype)
        linearize.prepare(PredictedPicture(target, jacobian), *self._compared(y, stage), stage.loss)

    def _compared(self, y: Vector, stage: Stage):
        """The arguments of `linearize` in order, without the picture and the loss."""
        numbers = (stage.blur / stage.binning, stage.loss_scale, stage.noise)
        at = values_and_slopes(self.array(y), self.unknowns)
        return *at, self.binned(stage.binning), self.prior, *map(self.array, numbers)

    def residual(self, image: Image, binning: int = 1) -> Image:
        """`Observation.residual` in numpy, which compiles nothing for a picture of another size."""
        observation = self.binned(binning)
        target, bias, root = map(np.asarray, (observation.target, observation.bias, observation.root_weight))
        return (image + bias - target) * root


def gaps(scene: Scene) -> Float[np.ndarray, " spheres"]:
    """The distance of each ball's surface from the camera; negative if the camera is in the ball."""
    center, radius, viewpoint = (
        np.asarray(part, np.float64) for part in (scene.spheres.center, scene.spheres.radius, scene.camera.viewpoint)
    )
    return np.linalg.norm(center - viewpoint[:, None], axis=0) - radius


@dataclasses.dataclass(frozen=True)
class FitState:
    """The state of a fit: a point, the problem there, and whether a solver came to rest.

    Args:
        problem: what is solved: the problem given, with the bias that the edge-aware picture was found to have.
        next_move: how long the step after the last would be in standard errors, where steps ended on their own.
        target_samples: samples a pixel and side of a box-filtered target's regular grid; None where none is known.
        resolution: covariance of unknowns that solver and samples do not tell apart: the outer product of the step that
            was not taken, and of places whose pictures of such samples are the same; None if unknown.
    """

    problem: Problem
    y: Vector
    stage: Stage
    linearization: Linearization
    settled: bool = False
    next_move: float = 0.0
    target_samples: int | None = None
    resolution: Covariance | None = None

    @classmethod
    def at(cls, problem: Problem, y: Vector, stage: Stage) -> "FitState":
        """The state at unknowns to which no solver has come yet."""
        return cls(problem, y, stage, problem.linearize(y, stage))

    @property
    def residual(self) -> Image:
        """The unblurred, weighted residual."""
        return self.problem.residual(np.asarray(self.linearization.image), self.stage.binning)

    @property
    def weighted_target(self) -> Image:
        """The target in the unit of its residual."""
        observation = self.problem.binned(self.stage.binning)
        return np.asarray(observation.target) * np.asarray(observation.root_weight)

    @property
    def rms_residual(self) -> float:
        """Root mean square of the unblurred, weighted residual over the numbers that count."""
        count = max(self.problem.binned(self.stage.binning).count, 1)
        return float(np.linalg.norm(self.residual) / np.sqrt(count))

    @property
    def counts(self) -> Mask:
        """The pixels that count."""
        return np.asarray(self.problem.binned(self.stage.binning).root_weight) > 0

    def under_loss(self, what: Literal["residual", "weight", "score"], scale: float | None = None) -> Image:
        """A function of the loss at each residual, at its own scale or at another one; see `Loss`."""
        residual = jnp.asarray(self.residual)
        at = jnp.asarray(self.stage.loss_scale if scale is None else scale, residual.dtype)
        return np.asarray(evaluate(self.stage.loss, what, residual, at), np.float64)
