"""The problem of a fit, a scene with free numbers beside a target, and the state of a fit at one place."""

import dataclasses
import functools
from collections import OrderedDict
from collections.abc import Hashable, Sequence

import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Num

from ...images.jpeg import JpegStorage
from ...scene.response import Frame
from ...scene.scene import Scene, with_texels, without_texels
from ...scene.setting_words import EdgeMode
from ...tracer.geometry.camera import picture_place, pixel_step
from ...tracer.pixels import Pixels
from ...tracer.settings import ResolvedSettings
from ...util.numerics import on_device, on_host
from ..options import Stage
from .linearize import Linearization, LossPart, evaluate, linearize
from .observation import Observation, nearest_power
from .prediction import CameraModel, ForwardModel, PredictedPicture, forward_model
from .unknowns import (
    Covariance,
    Image,
    Images,
    PixelIndices,
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
class Problem:
    """A scene, the target to compare it with, and the numbers that are free; with `others`, of several views.

    Of several views, cameras with a target each, a problem is the first one and has the others. What is said of pixels
    is said of one view; unknowns, and sums of squares, are those of all.

    The target is `t = Q(C(D(S(L)))) + e`: its pixels sample the scene's radiance L (S), the camera responds (D), a file
    is compressed (C) and rounds to steps (Q), and there is noise (e).

    Args:
        scene: what the view's camera sees of `whole`: the scene without its other views.
        unknowns, local: the numbers that are free, by names of `whole`; and as this view knows them.
        others: the other views; the prior counts in the first one alone.
        zoom: the width of the target as a share of the widest view's; stages are those of the widest.
        samples: S: each pixel is the mean of a regular grid of so many samples a side; None for the mean over its area,
            or for samples that are not known.
        storage: C, if the target was a JPEG.
        unit: the light that a weighted residual of 1 is at a weight of 1.
    """

    scene: Scene
    observation: Observation
    unknowns: Unknowns
    prior: Prior
    base: ResolvedSettings
    whole: Scene
    local: Unknowns
    others: tuple["Problem", ...] = ()
    zoom: float = 1.0
    samples: int | None = None
    storage: JpegStorage | None = None
    unit: float = 1.0
    # What was traced last; a copy with another observation has the same pictures.
    _pictures: OrderedDict[Hashable, PredictedPicture] = dataclasses.field(repr=False, default_factory=OrderedDict)
    # Not an argument, so that a copy with another observation does not keep the old one's.
    _binned: dict[int, Observation] = dataclasses.field(init=False, repr=False, default_factory=dict)

    @functools.cached_property
    def views(self) -> tuple["Problem", ...]:
        """Each view as a problem of its own."""
        return (dataclasses.replace(self, others=()), *self.others) if self.others else (self,)

    def of_views(self, views: Sequence["Problem"]) -> "Problem":
        """The problem of other versions of its views, in their order."""
        return dataclasses.replace(views[0], others=tuple(views[1:]))

    def in_own_unit(self, unit: float | None = None) -> "Problem":
        """The same problem, whose residuals have no unit: about 1 where the picture is black and the target is not.

        So no tolerance knows the unit of light or of weights. Powers of two change no digit.

        Args:
            unit: that of another picture's problem, whose residuals are compared with these.
        """
        root = on_host(self.observation.root_weight)
        if unit is None:
            unit = self.observation.light_unit * nearest_power(np.sqrt(np.mean(root[root > 0] ** 2)))
        observation = dataclasses.replace(self.observation, root_weight=self.array(root / unit))
        others = tuple(each.in_own_unit(unit) for each in self.others)
        return dataclasses.replace(self, observation=observation, unit=self.unit * unit, others=others)

    def zoomed(self, stage: Stage) -> Stage:
        """The stage of this view: blur and binning are in proportion to its width."""
        return dataclasses.replace(stage, blur=stage.blur * self.zoom, binning=self.zoomed_binning(stage.binning))

    def zoomed_binning(self, binning: int) -> int:
        """The binning of this view with which its pixels are as many as the widest view's with that binning."""
        return max(1, round(binning * self.zoom))

    @property
    def extent(self) -> int:
        """Side in pixels of the blocks within which residuals may go together, whatever the model.

        A sensor's mosaic, or a picture that was resampled, lets four pixels go together; a JPEG its blocks.
        """
        return 4 if self.storage is None else max(4, self.storage.unit)

    @property
    def dtype(self) -> np.dtype:
        """The precision of the fit."""
        return self.observation.target.dtype

    @functools.cached_property
    def model(self) -> ForwardModel:
        """The programs that compute the scene's radiance."""
        return forward_model(self.scene)

    @functools.cached_property
    def camera(self) -> CameraModel:
        """The camera's response to the scene's radiance."""
        return CameraModel(self.scene, self.local, np.asarray(self.prior.precision) > 0)

    def binned(self, binning: int) -> Observation:
        """The target in larger pixels."""
        if binning not in self._binned:
            self._binned[binning] = self.observation.binned(binning) if binning > 1 else self.observation
        return self._binned[binning]

    def settings(self, edges: EdgeMode, binning: int = 1) -> ResolvedSettings:
        """The settings of the whole picture, in the target's pixels or larger ones."""
        return dataclasses.replace(self.base, edges=edges, binning=self.base.binning * binning, crop=None)

    def frame(self, binning: int = 1) -> Frame:
        """The target's part of the whole picture.

        A crop begins between larger pixels of the whole picture: they are laid from its corner on.
        """
        window = self.base.frame(self.scene.camera.pixeldim)
        return window._replace(left=window.left / binning, top=window.top / binning, binning=window.binning * binning)

    def points(
        self, column: Num[np.ndarray, " points"], row: Num[np.ndarray, " points"], binning: int = 1
    ) -> Float[np.ndarray, "2 points"]:
        """Places in the whole picture of points of the target."""
        frame = self.frame(binning)
        place = column + frame.left, row + frame.top
        return np.stack(picture_place(self.scene.camera, self.settings("point", binning), *place))

    def places(self, binning: int = 1) -> tuple[PixelIndices, PixelIndices]:
        """Columns and rows of all pixels in their order."""
        height, width = self.binned(binning).target.shape[1:]
        row, column = np.divmod(np.arange(width * height), width)
        return column, row

    def pixels(self, binning: int = 1) -> Pixels:
        """All pixels."""
        step = pixel_step(self.scene.camera, self.settings("point", binning))
        return Pixels(self.points(*self.places(binning), binning), step)

    def array(self, values: ArrayLike | Sequence[float]) -> Array:
        """Unknowns, values, or pictures in the fit's dtype, as an argument of its programs.

        They go by way of the host: an array on several devices is another kind of argument, and would compile anew.
        """
        return on_device(values, self.dtype)

    def y_of(self, values: Values) -> Vector:
        """The unknowns that give these values."""
        return self.array(self.unknowns.unknowns(values))

    def start(self) -> Vector:
        """The unknowns at the start."""
        return self.y_of(self.initial)

    @functools.cached_property
    def initial(self) -> Values:
        """The values at the start."""
        return self.unknowns.initial(self.whole)

    def values(self, y: Vector) -> Values:
        """The parameters' values at unknowns `y`."""
        return on_host(values_and_slopes(self.array(y), self.unknowns)[0])

    def slopes(self, y: Vector) -> Values:
        """The derivative of each parameter's value by its unknown at `y`."""
        return on_host(values_and_slopes(self.array(y), self.unknowns)[1])

    def apply_response(self, radiance: Image, y: Vector) -> Image:
        """The picture that the camera at `y` makes of radiance."""
        return self.camera.image(radiance, self.values(y), self.frame())

    def response_reach(self, y: Vector) -> float:
        """The distance in pixels from which the light of a pixel may come; 0 if the camera mixes none."""
        return self.camera.reach(self.values(y))

    @functools.cached_property
    def scale(self) -> Values:
        """The natural scales of the parameters: how large a large change of each is."""
        light, model = self.observation.light_unit, self.base.model
        return np.array([natural_scale(self.whole, name, model, light) for name in self.unknowns.names])

    def distance(self, one: Values, other: Values) -> float:
        """The largest difference of any value, in natural scales."""
        return float(np.max(np.abs(one - other) / self.scale))

    def scene_at(self, y: Vector) -> Scene:
        """What the view's camera sees at unknowns `y`."""
        moved = moved_scene(without_texels(self.scene), self.array(self.values(y)), self.local)
        return with_texels(moved, self.scene)

    def whole_at(self, y: Vector) -> Scene:
        """The scene with all of its views at unknowns `y`."""
        moved = moved_scene(without_texels(self.whole), self.array(self.values(y)), self.unknowns)
        return with_texels(moved, self.whole)

    def scenes_with(self, values: Float[np.ndarray, "scenes parameters"]) -> Scene:
        """Scenes without film that have these values of the other free parameters, stacked as by `map_scenes`."""
        rows = self.array(values[:, self.local.traced])
        plain = dataclasses.replace(without_texels(self.scene), film=None)
        return with_texels(moved_scenes(plain, rows, self.local.traced_unknowns), self.scene)

    def picture(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture at `y` and its derivatives."""
        y = self.array(y)
        return self.camera.picture(self.radiance(y, edges, binning), y, self.frame(binning))

    def radiance(self, y: Vector, edges: EdgeMode, binning: int = 1) -> PredictedPicture:
        """The picture before the film, and its derivatives by the unknowns that are not the film's.

        The last few pictures are remembered: one point is looked at with several blurs, losses, targets and films.
        """
        # What is traced: the unknowns that are not the response's, of the scene without one.
        scene = dataclasses.replace(self.scene, film=None)
        y = self.array(np.asarray(y)[self.local.traced])
        place = np.asarray(y).tobytes(), edges, binning
        if place in self._pictures:
            self._pictures.move_to_end(place)
            return self._pictures[place]

        settings, shape = self.settings(edges, binning), self.binned(binning).target.shape
        pixels = self.model.differentiate(y, scene, self.pixels(binning), self.local.traced_unknowns, settings)
        image, jacobian = pixels.color.reshape(shape), pixels.jacobian.reshape(-1, *shape)
        sees_edge = np.asarray(pixels.sees_edge).reshape(shape[1:]) if edges == "aware" else None
        picture = PredictedPicture(self.array(image), self.array(jacobian), sees_edge)
        self._pictures[place] = picture
        # Three are kept: after a rejected step the solver goes on from where the step began.
        while len(self._pictures) > 3:
            self._pictures.popitem(last=False)
        return picture

    def linearize(self, y: Vector, stage: Stage, picture: PredictedPicture | None = None) -> Linearization:
        """Residual and Jacobian at `y`, of a picture and derivatives that are given or else traced."""
        if picture is None:
            picture = self.picture(y, stage.edges, stage.binning)
        picture = dataclasses.replace(picture, sees_edge=None)  # Not a matter of this program.
        at = values_and_slopes(self.array(y), self.unknowns)
        numbers = map(self.array, (stage.blur / stage.binning, stage.loss_scale, stage.noise))
        return linearize(picture, *at, self.binned(stage.binning), self.prior, *numbers, stage.loss)


@dataclasses.dataclass(frozen=True)
class FitState:
    """The state of a fit: a point, the problem there, and whether a solver came to rest.

    Of several views it is that of the first, and has the states of the others; `joint` is of all.

    Args:
        problem: what is solved: the problem given, with the bias that the edge-aware picture was found to have.
        next_step: the step that the solver did not take, of the unknowns, where steps ended on their own.
        next_move: its length in standard errors.
        confusion: covariance of parameter displacements that the target's samples cannot resolve; None if unknown.
        within: variance of the samples within each pixel, weighted; None where the target's grid is known.
    """

    problem: Problem
    y: Vector
    stage: Stage
    linearization: Linearization
    settled: bool = False
    next_step: Values | None = None
    next_move: float = 0.0
    confusion: Covariance | None = None
    within: Image | None = None
    others: tuple["FitState", ...] = ()

    @classmethod
    def at(cls, problem: Problem, y: Vector, stage: Stage) -> "FitState":
        """The state at unknowns to which no solver has come yet."""
        own = problem.zoomed(stage)
        others = tuple(cls.at(each, y, stage) for each in problem.others)
        return cls(problem, y, own, problem.linearize(y, own), others=others)

    @functools.cached_property
    def views(self) -> tuple["FitState", ...]:
        """The state of each view, as of a problem of its own."""
        if not self.others:
            return (self,)
        return (dataclasses.replace(self, problem=self.problem.views[0], others=()), *self.others)

    def of_views(self, views: Sequence["FitState"], **changes: object) -> "FitState":
        """The state of other versions of its views, in their order, and with other changes."""
        problem = self.problem.of_views([view.problem for view in views])
        return dataclasses.replace(views[0], problem=problem, others=tuple(views[1:]), **changes)

    @functools.cached_property
    def joint(self) -> Linearization:
        """The least-squares problem of all views: their sums, in one triangle; what it has of pixels is the first's."""
        if not self.others:
            return self.linearization
        each, dtype = [view.linearization for view in self.views], self.problem.dtype
        rows = [np.column_stack([np.asarray(one.jacobian), np.asarray(one.residual)]) for one in each]
        triangle = np.asarray(np.linalg.qr(np.concatenate(rows).astype(np.float64), mode="r"))
        triangle *= np.where(np.diagonal(triangle) < 0, -1, 1)[:, None]
        parts = {
            name: on_device(sum(on_host(getattr(one, name)) for one in each), dtype)
            for name in ("squares", "information", "curvature", "pixel_scatter")
        }
        jacobian, residual = (on_device(part, dtype) for part in (triangle[:, :-1], triangle[:, -1]))
        return dataclasses.replace(self.linearization, jacobian=jacobian, residual=residual, **parts)

    @property
    def residuals(self) -> Images:
        """The unblurred, weighted residual of each view."""
        return tuple(view.residual for view in self.views)

    @property
    def typical(self) -> float:
        """The largest of the views' typical residuals."""
        return max(float(view.linearization.typical) for view in self.views)

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
        """Root mean square of the unblurred, weighted residual over the numbers that count in all views."""
        squares = sum(float(np.sum(view.residual**2)) for view in self.views)
        return float(np.sqrt(squares / max(sum(view.observation.count for view in self.views), 1)))

    def under_loss(
        self,
        what: LossPart,
        scale: float | None = None,
        residual: Image | None = None,
    ) -> Image:
        """A function of the loss at each residual, its own or another one, and at its own scale or another; `Loss`."""
        residual = np.asarray(self.residual if residual is None else residual, self.problem.dtype)
        at = np.asarray(self.stage.loss_scale if scale is None else scale, residual.dtype)
        return on_host(evaluate(self.stage.loss, what, residual, at))
