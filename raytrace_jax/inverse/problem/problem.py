"""One fit's fixed parts, and its linearisation at any point."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.inverse.options import LossName
from raytrace_jax.inverse.problem.natural_scale import natural_scale
from raytrace_jax.inverse.problem.observation import Observation, Prior
from raytrace_jax.inverse.problem.residual import Linearization, linearize
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.plan import Plan, plan_render
from raytrace_jax.tracer.plan_cache import run_with_room
from raytrace_jax.tracer.settings import RenderSettings

PLAN_SLACK = 1.3
"""Room for the rays that the scene may grow while its parameters move, before the tracer must be compiled anew."""

_plans: dict = {}
"""The plan that served last for each kind of problem: another fit of its kind compiles nothing."""


@dataclasses.dataclass(frozen=True)
class Measure:
    """How picture and target are compared.

    Args:
        edges: how the picture is sampled, `point` or `aware`.
        sigma: standard deviation of the blur in pixels of the target.
        binning: how many pixels are averaged to one in each direction, in picture and target.
        loss: name of the loss.
        loss_scale: its scale; infinity with `l2`.
        noise: standard deviation of the residuals beside which priors count.
    """

    edges: str
    sigma: float = 0.0
    binning: int = 1
    loss: LossName = "l2"
    loss_scale: float = np.inf
    noise: float = 0.0


@dataclasses.dataclass(frozen=True)
class Problem:
    """A scene, a target, and what is free between them.

    Args:
        scene: gives the start and all that is not free; its dtype is that of the fit.
        observation: the target and its weights.
        unknowns: what is free.
        prior: what is known of it before.
        base: settings of the target's picture.
    """

    scene: Scene
    observation: Observation
    unknowns: Unknowns
    prior: Prior
    base: RenderSettings
    # Not an argument, so that a copy with another observation does not keep the old one's.
    _binned: dict[int, Observation] = dataclasses.field(init=False, repr=False, default_factory=dict)

    def settings(self, edges: str, binning: int = 1) -> RenderSettings:
        """The render settings of one way to compare."""
        return dataclasses.replace(self.base, edges=edges, binning=self.base.binning * binning)

    def binned(self, binning: int) -> Observation:
        """The target in larger pixels."""
        if binning not in self._binned:
            self._binned[binning] = self.observation.binned(binning) if binning > 1 else self.observation
        return self._binned[binning]

    def start(self) -> Float[Array, " parameters"]:
        """The unknowns at the start."""
        return self.array(self.unknowns.unknowns(self.unknowns.initial(self.scene)))

    def array(self, y) -> Float[Array, "*any parameters"]:
        """Unknowns, or values, in the fit's dtype, as an argument of its programs.

        By way of the host: an array that lies on several devices is another kind of argument, and compiles anew.
        """
        return jnp.asarray(np.asarray(y), self.observation.target.dtype)

    def values(self, y: Float[Array, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """The parameters' values at unknowns `y`."""
        return np.asarray(self.unknowns.values(self.array(y)), np.float64)

    def slopes(self, y: Float[Array, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """The derivative of each parameter's value by its unknown at `y`."""
        return np.array([float(jax.grad(t.to_value)(y[k])) for k, t in enumerate(self.unknowns.transforms)])

    def scale(self) -> Float[np.ndarray, " parameters"]:
        """The natural scales of the parameters: how large a large change of each is."""
        return np.array([natural_scale(self.scene, name, self.base.model) for name in self.unknowns.names])

    def scene_at(self, y: Float[Array, " parameters"]) -> Scene:
        """The scene at unknowns `y`."""
        return self.unknowns.scene(self.scene, self.values(y))

    def plan(self, settings: RenderSettings, y: Float[Array, " parameters"], slack: float = PLAN_SLACK) -> Plan:
        """The plan that served last for such a picture, or one for the scene at `y`, with room."""
        return _plans.get(self._kind(settings)) or plan_render(self.scene_at(y), settings, slack)

    def keep_plan(self, settings: RenderSettings, plan: Plan) -> None:
        """Keep a plan that served."""
        _plans[self._kind(settings)] = plan

    def _kind(self, settings: RenderSettings):
        return settings, jax.tree.structure(self.scene), self.scene.camera.viewpoint.dtype, jax.device_count()

    def linearize(self, y: Float[Array, " parameters"], measure: Measure) -> Linearization:
        """Residual and Jacobian at `y`; the tracer's plan is enlarged as soon as rays would find no room."""
        settings, y = self.settings(measure.edges, measure.binning), self.array(y)
        observation = self.binned(measure.binning)
        numbers = (measure.sigma / measure.binning, measure.loss_scale, measure.noise)
        sigma, loss_scale, noise = (jnp.asarray(x, y.dtype) for x in numbers)

        def program(plan):
            found = linearize(
                y,
                self.scene,
                observation,
                self.prior,
                sigma,
                loss_scale,
                noise,
                self.unknowns,
                settings,
                plan,
                measure.loss,
            )
            return found, found.wanted

        found, plan = run_with_room(program, self.plan(settings, y), settings)
        self.keep_plan(settings, plan)
        return found


def weighted_residual(problem: Problem, found: Linearization, binning: int = 1) -> Float[Array, "3 height width"]:
    """The unblurred, weighted residual of a linearisation."""
    observation = problem.binned(binning)
    return (found.image - observation.target) * observation.root_weight


def rms_residual(problem: Problem, found: Linearization, binning: int = 1) -> float:
    """Root mean square of the unblurred, weighted residual over the numbers that count."""
    count = max(problem.binned(binning).count, 1)
    return float(jnp.linalg.norm(weighted_residual(problem, found, binning)) / np.sqrt(count))
