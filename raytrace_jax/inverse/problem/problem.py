"""The problem of a fit, a scene with free numbers beside a target, and the state of a fit at one place."""

import dataclasses
import functools
from collections import OrderedDict
from collections.abc import Hashable, Sequence
from typing import Literal

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, Num

from ...scene.response import Frame
from ...scene.scene import Scene, with_texels, without_texels
from ...scene.setting_words import EdgeMode
from ...tracer.geometry.camera import picture_place, pixel_step
from ...tracer.pixels import Pixels
from ...tracer.resolved_settings import ResolvedSettings
from ...util.numerics import on_device
from ..options import Stage
from .linearize import Linearization, evaluate, linearize
from .observation import Observation, nearest_power
from .prediction import CameraModel, ForwardModel, PredictedPicture, forward_model
from .stages import ObservationStage
from .unknowns import (
    Image,
    Prior,
    Unknowns,
    Values,
    Vector,
    moved_scene,
    moved_scenes,
    natural_scale,
    values_and_slopes,
)


@dataclasses.dataclass(frozen=True)
class Raster:
    """The target's pixels, own or larger ones, and where they lie in the whole picture.

    Args:
        shape: (height, width) in these pixels.
        base: settings of the target's own pixels, whose window of the picture is the target.
        binning: how many of the target's pixels one has in each direction.
    """

    scene: Scene
    shape: tuple[int, ...]
    base: ResolvedSettings
    binning: int = 1

    def settings(self, edges: EdgeMode) -> ResolvedSettings:
        """The settings of the whole picture in these pixels."""
        return dataclasses.replace(self.base, edges=edges, binning=self.base.binning * self.binning, crop=None)

    @property
    def frame(self) -> Frame:
        """The target's part of the whole picture.

        A crop begins between larger pixels of the whole picture: they are laid from its corner on.
        """
        own = self.base.frame(self.scene.camera.pixeldim)
        binning = own.binning * self.binning
        return own._replace(left=own.left / self.binning, top=own.top / self.binning, binning=binning)

    def points(
        self, column: Num[np.ndarray, " points"], row: Num[np.ndarray, " points"]
    ) -> Float[np.ndarray, "2 points"]:
        """Places in the whole picture of points of the target."""
        frame = self.frame
        return np.stack(picture_place(self.scene.camera, self.settings("point"), column + frame.left, row + frame.top))

    @property
    def places(self) -> tuple[Int[np.ndarray, " pixels"], Int[np.ndarray, " pixels"]]:
        """Columns and rows of all pixels in their order."""
        height, width = self.shape
        row, column = np.divmod(np.arange(width * height), width)
        return column, row

    @property
    def pixels(self) -> Pixels:
        """All pixels."""
        return Pixels(self.points(*self.places), pixel_step(self.scene.camera, self.settings("point")))


@dataclasses.dataclass(frozen=True)
class Problem:
    """A scene, a target, and what is free between them.

    Args:
        stages: how a picture of the scene became the target's numbers.
        unit: the light that a weighted residual of 1 is at a weight of 1.
    """

    scene: Scene
    observation: Observation
    unknowns: Unknowns
    prior: Prior
    base: ResolvedSettings
    stages: tuple[ObservationStage, ...] = ()
    unit: float = 1.0
    # What was traced last; a copy with another observation has the same pictures.
    _pictures: OrderedDict[Hashable, PredictedPicture] = dataclasses.field(repr=False, default_factory=OrderedDict)
    # Not an argument, so that a copy with another observation does not keep the old one's.
    _binned: dict[int, Observation] = dataclasses.field(init=False, repr=False, default_factory=dict)

    def in_own_unit(self, unit: float | None = None) -> "Problem":
        """The same problem, whose residuals have no unit: about 1 where the picture is black and the target is not.

        So no tolerance knows the unit of light or of weights. Powers of two change no digit.

        Args:
            unit: that of another picture's problem, whose residuals are compared with these.
        """
        root = np.asarray(self.observation.root_weight, np.float64)
        if unit is None:
            unit = self.observation.light_unit * nearest_power(np.sqrt(np.mean(root[root > 0] ** 2)))
        observation = dataclasses.replace(self.observation, root_weight=self.array(root / unit))
        return dataclasses.replace(self, observation=observation, unit=self.unit * unit)

    @functools.cached_property
    def model(self) -> ForwardModel:
        """The programs that compute the scene's radiance."""
        return forward_model(self.scene)

    @functools.cached_property
    def camera(self) -> CameraModel:
        """The camera's response to the scene's radiance."""
        return CameraModel(self.scene, self.unknowns, np.asarray(self.prior.precision) > 0)

    def binned(self, binning: int) -> Observation:
        """The target in larger pixels."""
        if binning not in self._binned:
            self._binned[binning] = self.observation.binned(binning) if binning > 1 else self.observation
        return self._binned[binning]

    def raster(self, binning: int = 1) -> Raster:
        """The target's own pixels, or larger ones."""
        return Raster(self.scene, self.binned(binning).target.shape[1:], self.base, binning)

    def array(self, values: ArrayLike | Sequence[float]) -> Array:
        """Unknowns, values, or pictures in the fit's dtype, as an argument of its programs.

        They go by way of the host: an array on several devices is another kind of argument, and would compile anew.
        """
        return on_device(values, self.observation.target.dtype)

    def y_of(self, values: Values) -> Vector:
        """The unknowns that give these values."""
        return self.array(self.unknowns.unknowns(values))

    def start(self) -> Vector:
        """The unknowns at the start."""
        return self.y_of(self.unknowns.initial(self.scene))

    def values(self, y: Vector) -> Values:
        """The parameters' values at unknowns `y`."""
        return np.asarray(values_and_slopes(self.array(y), self.unknowns)[0], np.float64)

    def slopes(self, y: Vector) -> Values:
        """The derivative of each parameter's value by its unknown at `y`."""
        return np.asarray(values_and_slopes(self.array(y), self.unknowns)[1], np.float64)

    @functools.cached_property
    def scale(self) -> Values:
        """The natural scales of the parameters: how large a large change of each is."""
        light, model = self.observation.light_unit, self.base.model
        return np.array([natural_scale(self.scene, name, model, light) for name in self.unknowns.names])

    def distance(self, one: Values, other: Values) -> float:
        """The largest difference of any value, in natural scales."""
        return float(np.max(np.abs(one - other) / self.scale))

    def scene_at(self, y: Vector) -> Scene:
        """The scene at unknowns `y`."""
        moved = moved_scene(without_texels(self.scene), self.array(self.values(y)), self.unknowns)
        return with_texels(moved, self.scene)

    def scenes_with(self, values: Float[np.ndarray, "scenes parameters"]) -> Scene:
        """Scenes without film that have these values of the other free parameters, stacked as by `map_scenes`."""
        rows = self.array(values[:, list(self.unknowns.traced)])
        plain = dataclasses.replace(without_texels(self.scene), film=None)
        return with_texels(moved_scenes(plain, rows, self.unknowns.traced_unknowns), self.scene)

    def picture(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture at `y` and its derivatives."""
        y = self.array(y)
        return self.camera.picture(self.radiance(y, edges, binning), y, self.raster(binning).frame)

    def radiance(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture before the film, and its derivatives by the unknowns that are not the film's.

        The last few pictures are remembered: one point is looked at with several blurs, losses, targets and films.
        """
        y, scene, unknowns, settings = self._traced(y, edges, binning)
        place = np.asarray(y).tobytes(), edges, binning
        if place in self._pictures:
            self._pictures.move_to_end(place)
            return self._pictures[place]

        raster = self.raster(binning)
        found = self.model.differentiate(y, scene, raster.pixels, unknowns, settings)
        image, jacobian = found.color.reshape(3, *raster.shape), found.jacobian.reshape(-1, 3, *raster.shape)
        sees_edge = found.sees_edge.reshape(raster.shape) if edges == "aware" else None
        picture = PredictedPicture(self.array(image), self.array(jacobian), sees_edge)
        self._pictures[place] = picture
        # Three are kept: after a rejected step the solver goes on from where the step began.
        while len(self._pictures) > 3:
            self._pictures.popitem(last=False)
        return picture

    def _traced(self, y: Vector, edges: EdgeMode, binning: int):
        """What is traced: the unknowns that are not the film's, the scene without film, and how."""
        scene = dataclasses.replace(self.scene, film=None)
        traced = self.array(np.asarray(y)[list(self.unknowns.traced)])
        return traced, scene, self.unknowns.traced_unknowns, self.raster(binning).settings(edges)

    def linearize(self, y: Vector, stage: Stage, picture: PredictedPicture | None = None) -> Linearization:
        """Residual and Jacobian at `y`, of a picture and derivatives that are given or else traced."""
        if picture is None:
            picture = self.picture(y, stage.edges, stage.binning)
        picture = dataclasses.replace(picture, sees_edge=None)  # Not a matter of this program.
        return linearize(picture, *self._compared(y, stage), stage.loss)

    def _compared(self, y: Vector, stage: Stage):
        """The arguments of `linearize` in order, without the picture and the loss."""
        numbers = (stage.blur / stage.binning, stage.loss_scale, stage.noise)
        at = values_and_slopes(self.array(y), self.unknowns)
        return *at, self.binned(stage.binning), self.prior, *map(self.array, numbers)


@dataclasses.dataclass(frozen=True)
class FitState:
    """The state of a fit: a point, the problem there, and whether a solver came to rest.

    Args:
        problem: what is solved: the problem given, with the bias that the edge-aware picture was found to have.
        next_step: the step that the solver did not take, of the unknowns, where steps ended on their own.
        next_move: its length in standard errors.
    """

    problem: Problem
    y: Vector
    stage: Stage
    linearization: Linearization
    settled: bool = False
    next_step: Values | None = None
    next_move: float = 0.0

    @classmethod
    def at(cls, problem: Problem, y: Vector, stage: Stage) -> "FitState":
        """The state at unknowns to which no solver has come yet."""
        return cls(problem, y, stage, problem.linearize(y, stage))

    @property
    def observation(self) -> Observation:
        """The target in the stage's pixels."""
        return self.problem.binned(self.stage.binning)

    @property
    def residual(self) -> Image:
        """The unblurred, weighted residual."""
        return self.observation.residual(np.asarray(self.linearization.image))

    @property
    def weighted_target(self) -> Image:
        """The target in the unit of its residual."""
        return np.asarray(self.observation.target) * np.asarray(self.observation.root_weight)

    @property
    def rms_residual(self) -> float:
        """Root mean square of the unblurred, weighted residual over the numbers that count."""
        return float(np.linalg.norm(self.residual) / np.sqrt(max(self.observation.count, 1)))

    def under_loss(
        self,
        what: Literal["residual", "weight", "score"],
        scale: float | None = None,
        residual: Image | None = None,
    ) -> Image:
        """A function of the loss at each residual, its own or another one, and at its own scale or another; `Loss`."""
        residual = np.asarray(self.residual if residual is None else residual, self.problem.observation.target.dtype)
        at = np.asarray(self.stage.loss_scale if scale is None else scale, residual.dtype)
        return np.asarray(evaluate(self.stage.loss, what, residual, at), np.float64)
