"""What the judge's numbers are for: that the word for an ending is right, and error bars hold."""

import dataclasses
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np
from bench import CASES, SIGMA, Bench, Case
from replacing import replaced
from scipy.ndimage import gaussian_filter

from raytrace_jax import RenderSettings, load_scene, render, set_parameters
from raytrace_jax.inverse.build_problem import build_problem
from raytrace_jax.inverse.judge.model_check import ModelCheck
from raytrace_jax.inverse.judge.structure import explains
from raytrace_jax.inverse.judge.uncertainty import quantify_uncertainty
from raytrace_jax.inverse.options import FitOptions, Stage
from raytrace_jax.inverse.problem.problem import FitState
from raytrace_jax.inverse.progress import Findings
from raytrace_jax.inverse.solve.solvers import levenberg_marquardt
from raytrace_jax.inverse.status import fit_status
from raytrace_jax.tracer.settings import resolve_settings

STATISTICS = "inverse"
VARIED: list[tuple[str, tuple[Any, ...]]] = [
    ("judge.structure:BLOCK", (2, 3, 6, 8)),
    ("judge.structure:NEGLIGIBLE", (0.005, 0.01, 0.04, 0.08)),
    ("problem.linearize:RANK_TOLERANCE", (1e-11, 1e-7)),
    ("judge.uncertainty:NULL_COMPONENT", (1e-5, 1e-1)),
    ("judge.uncertainty:LEAST_CURVATURE", (0.01, 0.2)),
    ("judge.uncertainty:LARGEST_ERROR", (0.1, 0.25, 1.0)),
]
"""Numbers of `inverse.judge` with values beside their own."""

SMALL: list[tuple[str, tuple[Any, ...]]] = [
    (address, values)
    for address, values in VARIED
    if address.split(":")[1] in ("SQUARE", "RANK_TOLERANCE", "NULL_COMPONENT")
]
"""The numbers of `VARIED` on which `small_endings` may hang."""

SMALL_RADIUS = 0.4
"""Radius of a ball that covers few squares of pixels."""

HEAD = ("scene", "number", "value", "words that change", "error bars / usual ones")


class Ending(NamedTuple):
    """A target, what is free, the word that is right, and what is otherwise in the fit's scene."""

    free: tuple[str, ...]
    target: np.ndarray
    right: str
    changes: Mapping[str, float] = {}


def endings(case: Case, size: tuple[int, int]) -> dict[str, Ending]:
    """Targets that a scene explains, that it does not explain, and that do not determine what is free."""
    bench, ball = Bench(case, size, "point"), case.ball
    clean, scene = bench.clean, bench.truth_scene
    random = np.random.default_rng(5)

    def seen(changes, how=bench.how) -> np.ndarray:
        return np.asarray(render(set_parameters(scene, changes), how).image)

    noises = {f"noise {share:g}/255": clean + random.normal(0, share * SIGMA, clean.shape) for share in (1, 4, 16)}
    smooth = gaussian_filter(random.normal(0, 4 * SIGMA, clean.shape), (0, 1.5, 1.5))
    explained = {
        "no noise": clean,
        "eta physical": seen({}, dataclasses.replace(bench.how, eta="physical")),
        **noises,
        "8 bits": np.round(255 * clean) / 255,
        "smooth noise": clean + smooth,
        "2 % outliers": np.where(random.random(clean.shape[1:]) < 0.02, random.random(clean.shape), clean),
    }
    missed = {
        "another radius": seen({f"{ball}.radius": 1.05 * float(scene[f"{ball}.radius"])}),
        "another alpha": seen({f"{ball}.alpha": 0.55}),
        "no Schlick": seen({}, dataclasses.replace(bench.how, reflectance="none")),
        "a light elsewhere": seen({"topright.location": (3.0, 5.0, 1.0)}),
        "another floor": seen({"gray.ambient": (3.0, 2.0, 2.0)}),
        "upside down": clean[:, ::-1],
    }
    found = {name: Ending(case.free, target, "converged") for name, target in explained.items()}
    found |= {name: Ending(case.free, target, "not_converged") for name, target in missed.items()}
    found["radius free"] = Ending((*case.free, f"{ball}.radius"), noises["noise 1/255"], "converged")
    for word, alpha in (("opaque", 0.0), ("nearly opaque", 0.002)):
        target = seen({f"{ball}.alpha": alpha}) + random.normal(0, 4 * SIGMA, clean.shape)
        found[word] = Ending(case.free, target, "degenerate", {f"{ball}.alpha": alpha})
    return found


def small_endings(case: Case, size: tuple[int, int]) -> dict[str, Ending]:
    """Targets that differ where nothing free is seen, and with a ball that covers few squares of pixels."""
    bench, small = Bench(case, size, "point"), {f"{case.ball}.radius": SMALL_RADIUS}
    random = np.random.default_rng(6)

    def seen(**changes) -> np.ndarray:
        image = np.asarray(render(set_parameters(bench.truth_scene, {**small, **changes}), bench.how).image)
        return image + random.normal(0, SIGMA, image.shape)

    return {
        "a white corner": Ending(case.free, with_corner(bench.clean, 6), "not_converged"),
        "a small white corner": Ending(case.free, with_corner(bench.clean, 12), "not_converged"),
        "small ball": Ending(case.free, seen(), "converged", small),
        "small ball, another floor": Ending(
            case.free, seen(**{"gray.ambient": (3.0, 2.0, 2.0)}), "not_converged", small
        ),
        "small ball, opaque": Ending(case.free, seen(**{f"{case.ball}.alpha": 0.0}), "not_converged", small),
    }


def with_corner(image: np.ndarray, share: int) -> np.ndarray:
    """The picture with a white rectangle, so small a share of its width and height, where no ball is seen."""
    painted = image.copy()
    painted[:, : image.shape[1] // share, : image.shape[2] // share] = 1
    return painted


class Ended(NamedTuple):
    """A solved ending."""

    ending: Ending
    solution: FitState


def solve(case: Case, size: tuple[int, int], ending: Ending) -> Ended:
    """Least squares from the truth: they end near it, or where another target leads."""
    scene = set_parameters(load_scene(case.path), ending.changes)
    settings = resolve_settings(scene, RenderSettings(size=size))
    problem = build_problem(scene, ending.target, ending.free, settings, FitOptions()).problem
    return Ended(ending, levenberg_marquardt(problem, problem.start(), Stage("point")))


def judged(ended: Ended) -> tuple[str, np.ndarray]:
    """The word for an ending, and the error bars."""
    solution = ended.solution
    sure = quantify_uncertainty(solution, None)
    check = ModelCheck.nothing(len(sure.standard_error))
    findings = Findings(solution=dataclasses.replace(solution, settled=True), uncertainty=sure, check=check)
    return fit_status(findings, explains(solution), 0.0, 60)[0], sure.standard_error


def rows(name: str, size: tuple[int, int], endings=endings, varied=VARIED) -> Iterator[list[str]]:
    """The table's rows for one scene."""
    case = CASES[name]
    ended = {word: solve(case, size, ending) for word, ending in endings(case, size).items()}
    usual = {word: judged(one) for word, one in ended.items()}
    for word, (status, error) in usual.items():
        right = "right" if status == ended[word].ending.right else "WRONG"
        yield [name, "usual", word, f"{status}, {right}", f"index {error[0]:.1e}"]
    for address, values in varied:
        for value in values:
            with replaced({f"{STATISTICS}.{address}": value}):
                now = {word: judged(one) for word, one in ended.items()}
            words = [f"{word}: {now[word][0]}" for word in now if now[word][0] != usual[word][0]]
            bars = [
                f"{word} {error[0] / usual[word][1][0]:.2f}"
                for word, (_, error) in now.items()
                if np.isfinite(error[0]) and abs(error[0] / usual[word][1][0] - 1) > 0.01
            ]
            yield [name, f"`{address.split(':')[1]}`", f"{value:g}", "; ".join(words), "; ".join(bars)]


def small_rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """The judge's rows of `small_endings`."""
    yield from rows(name, size, small_endings, SMALL)
