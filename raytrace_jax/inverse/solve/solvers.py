"""The two solvers of a picture, Levenberg-Marquardt and Gauss-Newton steps, as two methods of one loop."""

import dataclasses
import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, cast

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float, Int

from ...errors import RaytraceWarning
from ...scene.scene import Scene
from ...util.numerics import TINY, on_device, on_host, root_diagonal, solve_normal
from ..options import Stage
from ..problem.linearize import RANK_TOLERANCE, Linearization, gauss_newton_step
from ..problem.problem import FitState, Problem
from ..problem.unknowns import Unknowns, Values, Vector
from ..progress import Record


def minimise(
    method: "LevenbergMarquardt | GaussNewton", start: FitState, look: Callable[[Vector], FitState], record: Record
) -> FitState:
    """Step from `start` until the method ends, or has taken its `max_steps`; the best place that was seen.

    A method has the contract of optimistix: `init` makes its memory; `step` judges the place that was seen, the start
    at first, and chooses the next, which `look` sees; `terminate` says whether the solve is at rest, None while it goes
    on. A start that is not finite ends the solve, for no step from there is known.
    """
    if not start.joint.is_finite:
        record(start.joint.cost, False, start.y)
        return start
    best, to = start, start.y
    memory: Any = method.init(start)
    for number in range(method.max_steps + 1):
        seen = look(to) if number else start
        best, to, memory = method.step(best, seen, memory)
        settled = method.terminate(best, memory)
        if number or not start.settled:  # The end of another solve is recorded.
            record(best.joint.cost, best.linearization is seen.linearization, best.y)
        if settled is not None:
            return dataclasses.replace(best, settled=settled)
    return best


class TrustState(NamedTuple):
    """Optimistix' solver, its state, whether it is done, and rejected steps in a row."""

    solver: optx.LevenbergMarquardt
    state: Any
    done: bool = False
    rejected: int = 0


@dataclasses.dataclass(frozen=True)
class LevenbergMarquardt:
    """Steps that lower the sum of squares. What is not finite is never accepted: the solver shortens its step.

    Three tests end it, since none sees all ends: of a picture that fits to rounding the linear model promises to take
    away all of the cost, and one that jumps lets no step lower the cost, whatever is promised.

    Args:
        relative: change of unknowns and cost in proportion to themselves (float32 stops where it resolves no more).
        decrease: fraction of the cost that the linear model still takes away: the estimate's squared error in units of
            its error bar, up to the number of residuals (the relative offset of Bates and Watts 1981).
        rejected: rejected steps in a row: no shorter step helps either.
    """

    max_steps: int = 60
    # A solve that ends on the answer, so that targets without noise are met.
    relative: float = 1e-9
    decrease: float = 1e-10
    rejected: int = 3

    def init(self, start: FitState) -> TrustState:
        limit = on_device(max(self.relative, tolerance(start.y.dtype)), start.y.dtype)
        # `limit` is an array, not the float that the annotation says: a new tolerance must not compile anew.
        solver = optx.LevenbergMarquardt(rtol=cast(float, limit), atol=cast(float, limit))
        return TrustState(solver, init(solver, start.y, linear_model(start)))

    def step(self, best: FitState, seen: FitState, memory: TrustState) -> tuple[FitState, Vector, TrustState]:
        y, state, done = advance(memory.solver, best.y, linear_model(seen), memory.state)
        accepted = seen.joint.is_finite and np.array_equal(y, seen.y)
        best, rejected = (seen, 0) if accepted else (best, memory.rejected + 1)
        # Have it try a point that is possible.
        to = shorten_step(best.problem, best.y, state.y_eval)
        state = eqx.tree_at(lambda state: state.y_eval, state, to)
        return best, to, TrustState(memory.solver, state, bool(done), rejected)

    def terminate(self, best: FitState, memory: TrustState) -> bool | None:
        free = project_gradient(best)
        decrease = predicted_decrease(free) / max(np.sum(on_host(free.residual) ** 2), TINY)
        ends = memory.done or memory.rejected >= self.rejected or decrease < self.decrease
        return True if ends else None


def levenberg_marquardt(
    problem: Problem,
    y: Vector,
    stage: Stage,
    record: Record = lambda *step: None,
    method: LevenbergMarquardt = LevenbergMarquardt(),
    held: Sequence[int] = (),
) -> FitState:
    """Minimise the sum of squares from `y`; the unknowns at the places `held` stay."""

    def look(y: Vector) -> FitState:
        state = FitState.at(problem, y, stage)
        if not held:
            return state
        # A solver that sees no derivative along an unknown leaves it.
        moves = ~np.isin(np.arange(len(problem.unknowns.names)), held)
        still = [
            dataclasses.replace(each, jacobian=on_device(np.where(moves, np.asarray(each.jacobian), 0)))
            for each in (view.linearization for view in state.views)
        ]
        views = zip(state.views, still, strict=True)
        return state.of_views([dataclasses.replace(view, linearization=each) for view, each in views])

    return minimise(method, look(problem.array(np.clip(np.asarray(y), *problem.unknowns.reach))), look, record)


def linear_model(state: FitState) -> tuple[Vector, jax.Array, jax.Array]:
    """The unknowns, the rotated residual and its derivative, by way of the host: they may lie on several devices.

    Levenberg-Marquardt asks for value and derivative at one point a step. Another program computes these few numbers
    beforehand. So the solver's own step is tiny, compiles in no time, and knows nothing of pictures.
    """
    free = project_gradient(state)
    return state.y, on_device(free.residual), on_device(free.jacobian)


def linear_residual(y: Vector, model):
    origin, residual, jacobian = model
    return residual + jacobian @ (y - origin), None


@eqx.filter_jit
def init(solver, y, model):
    residual = jax.eval_shape(lambda: model[1])
    return solver.init(linear_residual, y, model, {"jac": "fwd"}, residual, None, frozenset())


@eqx.filter_jit
def advance(solver, y, model, state):
    y, state, _ = solver.step(linear_residual, y, model, {"jac": "fwd"}, state, frozenset())
    done, _ = solver.terminate(linear_residual, y, model, {"jac": "fwd"}, state, frozenset())
    return y, state, done


class StepState(NamedTuple):
    """What Gauss-Newton knows of its steps.

    Args:
        predicted_decrease: what the step from the best place predicts to take off the sum of squares.
        stalled: steps in a row whose end predicts more than half of that.
        sigmas, length: length of the next step in standard errors, 0 if it is one of rounding, and in natural scales.
    """

    predicted_decrease: float = np.inf
    stalled: int = 0
    sigmas: float = 0.0
    length: float = 0.0


@dataclasses.dataclass(frozen=True)
class GaussNewton:
    """Steps that do not ask for a lower cost; the best place is that from which the next step would be shortest.

    A picture of points or of samples jumps where an edge crosses one, so that its cost holds up a solver that asks it
    to fall. A step is the estimate's distance from the answer as the derivative sees it, and its measure is what it
    predicts to take off the sum of squares. What is left, the step that was not taken, is part of the answer's error.
    A place that is not finite is not taken: the steps end before it, with a warning, and not at rest.

    Args:
        move: a step of so few standard errors is none.
        error: the unknowns' total standard errors: a step of so few of these is none, either.
        trust: radius in natural scales within which the linear model holds: a longer step is not taken, and the place
            is none of rest. From near the answer half and double do the same.
    """

    max_steps: int = 19
    move: float = 0.1
    error: Values | None = None
    trust: float = 0.1

    def init(self, start: FitState) -> StepState:
        return StepState()

    def step(self, best: FitState, seen: FitState, memory: StepState) -> tuple[FitState, Vector, StepState]:
        problem = seen.problem
        if not seen.joint.is_finite:
            words = "a picture or a derivative has values that are not finite: the last steps of the fit end before it."
            warnings.warn(words, RaytraceWarning, stacklevel=2)
            return dataclasses.replace(best, settled=False, next_move=0.0), best.y, StepState()
        free = project_gradient(seen)
        decrease, least = predicted_decrease(free), memory.predicted_decrease
        step, here = step_to_minimum(seen, free), np.asarray(seen.y)
        to = shorten_step(problem, seen.y, here + step)
        rounding = tolerance(here.dtype) * np.maximum(np.abs(here), 1)
        sigmas = 0.0 if np.all(np.abs(np.asarray(to) - here) <= rounding) else step_in_errors(free)
        if self.error is not None:
            sigmas = min(sigmas, float(np.max(np.abs(step) / np.maximum(self.error, TINY))))
        length = problem.distance(problem.values(to), problem.values(seen.y))
        if decrease < least:
            best = dataclasses.replace(seen, settled=length < self.trust, next_step=step, next_move=sigmas)
        stalled = 0 if decrease < 0.5 * least else memory.stalled + 1
        return best, to, StepState(min(decrease, least), stalled, sigmas, length)

    def terminate(self, best: FitState, memory: StepState) -> bool | None:
        # Single pixels that jump make steps go to and fro by about a standard error: two that stall are the end.
        ends = memory.sigmas < self.move or memory.stalled == 2 or memory.length >= self.trust
        return best.settled if ends else None


def tolerance(dtype) -> float:
    """The relative change below which a number counts as unchanged: four roundings."""
    return 4 * float(jnp.finfo(dtype).eps)


def predicted_decrease(linearization: Linearization) -> float:
    """What the linear problem takes off the sum of squares: `|P r|^2`, P projecting on the Jacobian's span."""
    triangle = on_host(linearization.jacobian)
    residual = on_host(linearization.residual)
    moves = np.any(triangle != 0, axis=0)
    # The triangle's own rows span it unless columns were set to 0; the last row holds what no parameter explains.
    spanned = residual[:-1] if moves.all() else np.linalg.qr(triangle[:, moves])[0].T @ residual
    return float(np.sum(spanned**2))


def step_to_minimum(state: FitState, free: Linearization) -> Values:
    """The step to the minimum of the loss near a point, where residuals are linear in the unknowns.

    Least squares with the loss's weights take the weights for fixed and come up short, since a residual that grows
    counts less: each such step leaves `1 - E rho'' / E w` of the error, two fifths beside Gaussian noise, and more
    where most residuals are roundings. Weights cost little beside a picture. So they follow the step, until it ends
    (iteratively reweighted least squares: Holland and Welsch 1977). The loss falls with each.

    Args:
        free: the state's linearisation without the columns of the unknowns that stay.
    """
    step, problem, stage = gauss_newton_step(free), state.problem, state.stage
    if stage.loss == "l2" or not step.any():
        return step
    moves = np.any(np.asarray(free.jacobian) != 0, axis=0)
    columns = [(view, on_host(view.linearization.pixel_jacobian) * moves[:, None, None, None]) for view in state.views]
    mean, precision = map(on_host, (problem.prior.mean, problem.prior.precision))
    pull = stage.noise * precision * (problem.values(state.y) - mean)
    slope = stage.noise * precision * problem.slopes(state.y) * moves
    for _ in range(30):
        normal, score = np.diag(slope**2), slope * (pull + slope * step)
        for view, column in columns:
            left = view.residual + np.tensordot(step, column, 1)
            weighted = (column * view.under_loss("weight", residual=left)).reshape(len(moves), -1)
            normal, score = normal + weighted @ column.reshape(len(moves), -1).T, score + weighted @ left.reshape(-1)
        further = -solve_normal(normal, score)
        step = step + further
        if further @ normal @ further < 1e-6 * (step @ normal @ step):
            break
    return step


def step_in_errors(linearization: Linearization) -> float:
    """The length of the next step in standard errors.

    That is the score `g = J^T W r` over its own scatter, `(g^T P^-1 g / p)^(1/2)`, where `P` is the sum over residuals
    of each one's `g g^T` (the score test of White 1982). It is 1 on average where residuals pull at random, whatever
    their sizes. Beside error bars from all residuals together the pull of the few at edges would seem far too large.
    """
    triangle, residual = map(on_host, (linearization.jacobian, linearization.residual))
    score = triangle.T @ residual
    scatter = on_host(linearization.pixel_scatter)
    length = root_diagonal(scatter)
    moves = np.any(triangle != 0, axis=0) & (length > 0)
    if not moves.any():
        return 0.0
    # With each parameter in units of its own scatter `P` is a correlation matrix. Its inverse is bounded along
    # directions that no residual sees.
    unit, scatter = score[moves] / length[moves], scatter[np.ix_(moves, moves)]
    scatter = scatter / np.outer(length[moves], length[moves])
    strengths, directions = np.linalg.eigh(scatter)
    strengths_used = np.maximum(strengths, RANK_TOLERANCE)
    return float(np.sqrt(np.mean((directions.T @ unit) ** 2 / strengths_used)))


def shorten_step(problem: Problem, origin: Vector, tried) -> Vector:
    """The end of a step, moved into the reach of the unknowns and halved until no ball has swallowed the camera."""
    place, start = np.clip(np.asarray(tried), *problem.unknowns.reach), np.asarray(origin)
    # Ten halvings leave a thousandth of a step: one that still leads into the impossible is given up.
    for _ in range(10):
        if is_possible(problem, problem.array(place)):
            return problem.array(place)
        place = (place + start) / 2
    return problem.array(start)


def is_possible(problem: Problem, y: Vector) -> bool:
    """Whether no camera is in a ball in which it was not at the start."""
    return all(bool(np.all(gaps(view.scene_at(y))[gaps(view.scene) > 0] > 0)) for view in problem.views)


def gaps(scene: Scene) -> Float[np.ndarray, " spheres"]:
    """The distance of each ball's surface from the camera; negative if the camera is in the ball."""
    parts = scene.spheres.center, scene.spheres.radius, scene.camera.viewpoint
    center, radius, viewpoint = map(on_host, parts)
    return np.linalg.norm(center - viewpoint[:, None], axis=0) - radius


def at_bounds(y: Vector, unknowns: Unknowns) -> Int[np.ndarray, " parameters"]:
    """The end of its reach that each unknown is at: -1 is the lower, 1 the upper, 0 neither."""
    lower, upper = unknowns.reach
    # The ends are rounded to the unknowns' dtype, as where they were clipped.
    place = np.asarray(y)
    return np.where(place <= lower.astype(place.dtype), -1, np.where(place >= upper.astype(place.dtype), 1, 0))


def bounds_reached(y: Vector, unknowns: Unknowns) -> tuple[tuple[str, float], ...]:
    """The name of each parameter that is at a bound, with the bound."""
    rows = zip(unknowns.names, unknowns.transforms, at_bounds(y, unknowns), strict=True)
    return tuple((name, bounded.lower if side < 0 else bounded.upper) for name, bounded, side in rows if side)


def project_gradient(state: FitState) -> Linearization:
    """A state's linearisation that holds the unknowns at a bound where the cost falls beyond it (projected gradient).

    Their columns of the Jacobian are 0, so that no step moves them.
    """
    side, linearization = at_bounds(state.y, state.problem.unknowns), state.joint
    if not side.any():
        return linearization
    triangle = np.asarray(linearization.jacobian)
    downhill = -triangle.T @ np.asarray(linearization.residual)
    return dataclasses.replace(linearization, jacobian=on_device(np.where(side * downhill > 0, 0, triangle)))
