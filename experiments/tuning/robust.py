"""What two numbers are for that hold a fit in its range: curvature of a loss beside outliers, starts on a bound."""

from collections.abc import Iterator
from unittest import mock

import numpy as np
from bench import CASES, Bench
from replacing import replaced

from raytrace_jax import Scene, render, set_parameters
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.progress import Progress
from raytrace_jax.inverse.solve.refine import refine


def refined(bench: Bench, scene: Scene, target: np.ndarray, free: tuple[str, ...]) -> tuple[FitState, int]:
    """The solution that the Cauchy loss leads to, and the number of steps."""
    options = FitOptions(target_sampling="point")
    problem = build_problem(scene, target, free, bench.how, options).problem
    progress = Progress(problem)
    solution = refine(problem, problem.start(), options, progress, progress.of_level(0, 0))
    return solution, len(progress.findings.steps)


CURVATURE_HEAD = ("scene", "target", "least curvature", "error of index / bar without a bound", "bar / that of 0.05")
LEAST_CURVATURES = (-np.inf, 0.01, 0.05, 0.2, 0.5)
OUTLIERS = (0.0, 0.02, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6)


def curvature_rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """Targets of one ray a pixel with noise of 1/255 of which a share are random colours, or that no scene explains."""
    bench, random = Bench(CASES[name], size, "point"), np.random.default_rng(7)
    targets = {
        f"{100 * share:g} % outliers": np.where(
            random.random(bench.clean.shape[1:]) < share, random.random(bench.clean.shape), bench.noisy(0)
        )
        for share in OUTLIERS
    }
    radius = f"{bench.case.ball}.radius"
    for factor in (1.05, 1.2):
        moved = set_parameters(bench.truth_scene, {radius: factor * float(bench.truth_scene[radius])})
        targets[f"radius {factor:g}"] = np.asarray(render(moved, bench.how).image)
    targets["upside down"] = bench.clean[:, ::-1]
    for word, target in targets.items():
        solution, _ = refined(bench, bench.truth_scene, target, bench.case.free)
        lowest, bars, eigvalsh = [], {}, np.linalg.eigvalsh

        def kept(bread, lowest=lowest, eigvalsh=eigvalsh):
            lowest.append(eigvalsh(bread)[0])
            return eigvalsh(bread)

        with mock.patch.object(np.linalg, "eigvalsh", kept):
            for value in LEAST_CURVATURES:
                with replaced({"inverse.judge.uncertainty:LEAST_CURVATURE": value}):
                    bars[value] = quantify_uncertainty(solution, None).standard_error[0]
        error = abs(solution.problem.values(solution.y)[0] - bench.truth[0])
        told = "; ".join(f"{value:g}: {bar / bars[0.05]:.2f}" for value, bar in bars.items())
        yield [name, word, f"{lowest[0]:.3f}", f"{error / bars[-np.inf]:.1f}, {error / bars[0.05]:.1f}", told]


BOUNDS_HEAD = ("scene", "start", "errors of index and alpha", "rms residual", "steps")


def bounds_rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """The last level from a bound of the ball's alpha or index, all else at the truth; targets with noise of 1/255."""
    bench, ball = Bench(CASES[name], size, "point"), CASES[name].ball
    free, target = (f"{ball}.alpha", *bench.case.free), bench.noisy(0)
    alpha, index = (float(bench.truth_scene[one]) for one in free[:2])
    for start in ({f"{ball}.alpha": 0.0}, {f"{ball}.alpha": 1.0}, {f"{ball}.ior": 1.0}):
        scene = set_parameters(bench.truth_scene, start)
        solution, steps = refined(bench, scene, target, free)
        found = solution.problem.values(solution.y)
        rms = solution.rms_residual
        ((where, at),) = start.items()
        told = f"{abs(found[1] - index):.1e} {abs(found[0] - alpha):.1e}", f"{rms:.4f}", str(steps)
        yield [name, f"{where.split('.')[1]} {at:g}", *told]
