"""The fit: from a target picture to the values of a scene's free parameters, coarse to fine."""

import time
from collections.abc import Callable, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import ParameterError, PictureError
from ..parameters import get_parameter, scalar_names, set_parameters
from ..plan import plan_render
from ..render import enlarge, render, too_many
from ..scene import Scene
from ..settings import RenderSettings
from .levels import LeastSquares, solve_level
from .residual import Linearization, linearize
from .result import FitResult, FitStep, Status
from .transforms import Transform, default_transform
from .uncertainty import covariance, is_explained

DEFAULT_BLUR = (6.0, 3.0, 1.5, 0.0)
"""Standard deviations of the pyramid's levels, in pixels."""

PLAN_SLACK = 1.3
"""Room for the rays that the scene may grow while its parameters move, before the tracer must be compiled anew."""


class Problem:
    """One fit's fixed parts, and its linearisation at any point and blur."""

    def __init__(self, scene: Scene, target: Float[Array, "3 height width"], names: tuple[str, ...], settings):
        self.scene, self.target, self.names, self.settings = scene, target, names, settings
        self.initial = np.array([float(get_parameter(scene, name)) for name in names])
        self.transforms: tuple[Transform, ...] = tuple(map(default_transform, names, self.initial))
        self.plan = plan_render(scene, settings, PLAN_SLACK)

    def unknowns(self) -> Float[Array, " parameters"]:
        """The unknowns at the start."""
        y = [transform.to_unknown(value) for transform, value in zip(self.transforms, self.initial, strict=True)]
        return jnp.asarray(y, self.target.dtype)

    def values(self, y: Float[Array, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """The parameters' values at unknowns `y`."""
        return np.array([float(t.to_value(y[k])) for k, t in enumerate(self.transforms)])

    def scene_at(self, y: Float[Array, " parameters"]) -> Scene:
        """The scene at unknowns `y`."""
        return set_parameters(self.scene, dict(zip(self.names, self.values(y), strict=True)))

    def linearize(self, y: Float[Array, " parameters"], sigma: float) -> Linearization:
        """Residual and Jacobian at `y`; the plan is enlarged as soon as rays would find no room."""
        while True:
            blurred = jnp.asarray(sigma, y.dtype)
            found = linearize(
                y, self.scene, self.target, blurred, self.names, self.transforms, self.settings, self.plan
            )
            if not too_many(self.plan, found.wanted):
                return found
            self.plan = enlarge(self.plan, np.asarray(found.wanted), self.settings)


def fit(
    scene: Scene,
    target: Float[Array, "3 height width"],
    free: Sequence[str],
    settings: RenderSettings = RenderSettings(),
    *,
    blur: Sequence[float] = DEFAULT_BLUR,
    max_steps: int = 60,
    max_seconds: float | None = None,
    on_step: Callable[[FitStep], None] | None = None,
) -> FitResult:
    """Find the values of free parameters with which a scene's picture equals a target, by least squares.

    Levenberg-Marquardt on a pyramid of Gaussian blurs, each level starting where the last one ended; the last level is
    unblurred. Ctrl-C ends the fit with what it has.

    Args:
        scene: the scene; its values are the start, its dtype the precision.
        target: scene-linear RGB, top row first, of the size that `settings` render.
        free: parameters to find, `vitreous.ior` or whole vectors, `vitreous.center`.
        settings: how the target was rendered.
        blur: standard deviations in pixels of the levels, coarse to fine; 0 is appended if it is not the last.
        max_steps: steps of the solver on each level, at most.
        max_seconds: stop (`interrupted`) after this time.
        on_step: called after each step.

    Raises:
        ParameterError: unknown names, none at all, or one twice.
        PictureError: a target of another size, with NaN or infinity, or constant.
    """
    started = time.monotonic()
    names = scalar_names(scene, free)
    if not names:
        raise ParameterError("there is nothing to fit: name at least one free parameter, such as sphere.center")
    target = check_target(target, scene, settings)
    sigmas = [float(sigma) for sigma in blur]
    if not sigmas or sigmas[-1] != 0:
        sigmas.append(0.0)
    problem = Problem(scene, target, names, settings)
    history: list[FitStep] = []

    def record(level: int, sigma: float, step: int, cost: float, accepted: bool, y) -> None:
        seconds = time.monotonic() - started
        history.append(FitStep(level, sigma, step, cost, accepted, problem.values(y), seconds))
        if on_step is not None:
            on_step(history[-1])
        if max_seconds is not None and seconds > max_seconds:
            raise TimeoutError

    y = problem.unknowns()
    reason = settled = None
    progress = LeastSquares(y)
    try:
        for level, sigma in enumerate(sigmas):
            finest = level == len(sigmas) - 1
            settled = solve_level(problem.linearize, progress, level, sigma, finest, max_steps, record)
    except KeyboardInterrupt:
        reason = "interrupted by the user"
    except TimeoutError:
        reason = f"stopped after {max_seconds:g} seconds"
    return conclude(problem, progress.y, reason, bool(settled), tuple(history), max_steps)


def check_target(target, scene: Scene, settings: RenderSettings) -> Float[Array, "3 height width"]:
    """The target in the scene's dtype.

    Raises:
        PictureError: another size than the render, NaN, infinity, or a constant picture.
    """
    _, _, width, height = settings.window(scene.camera.pixeldim)
    picture = np.asarray(target)
    if picture.ndim != 3 or picture.shape[0] != 3:
        raise PictureError(f"the target has shape {picture.shape}; wanted (3, {height}, {width})")
    if picture.shape[1:] != (height, width):
        raise PictureError(
            f"the target is {picture.shape[2]} x {picture.shape[1]} pixels, the scene renders {width} x {height}; "
            "set the size to the target's, or crop"
        )
    bad = int(np.sum(~np.isfinite(picture)))
    if bad:
        raise PictureError(f"the target has {bad} values that are NaN or infinite; a fit needs finite ones")
    if np.all(picture == picture[:, :1, :1]):
        raise PictureError("the target is one constant colour; there is nothing in it to fit")
    return jnp.asarray(picture, scene.camera.viewpoint.dtype)


def conclude(
    problem: Problem, y: Float[Array, " parameters"], reason: str | None, settled: bool, history, max_steps: int
) -> FitResult:
    """Judge the end point and gather the result."""
    at_end = problem.linearize(y, 0.0)
    error, correlation = covariance(at_end, problem.transforms, y, problem.target.size)
    image = np.asarray(render(problem.scene_at(y), problem.settings).image)
    start_image = np.asarray(render(problem.scene, problem.settings).image)
    target = np.asarray(problem.target)
    residual = image - target

    status: Status = "not_converged"
    undetermined = [name for name, e in zip(problem.names, error, strict=True) if not np.isfinite(e)]
    if reason is not None:
        status, message = "interrupted", f"{reason}; the values are those of the last accepted step"
    elif undetermined:
        message = f"the picture does not determine {', '.join(undetermined)}; fix it or free fewer parameters"
    elif not settled:
        message = f"the solver was still moving after {max_steps} steps on a level; allow more steps"
    elif not is_explained(residual):
        message = "the solver came to rest, but the residual shows structure; start nearer, or free what differs"
    else:
        status, message = "converged", "the solver came to rest and the picture is explained"
    return FitResult(
        status=status,
        message=message,
        names=problem.names,
        value=problem.values(y),
        initial=problem.initial,
        standard_error=error,
        correlation=correlation,
        rms_residual=float(np.sqrt(np.mean(residual**2))),
        scene=problem.scene_at(y),
        settings=problem.settings,
        target=target,
        start_image=start_image,
        image=image,
        history=history,
    )
