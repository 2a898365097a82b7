"""A paragraph for the methods section of a paper on what a fit did, with its references."""

from pathlib import Path

import numpy as np

from ..._version import __version__
from ...inverse.result import FitResult
from ...util.text import listed
from ..panels import page_template
from .curves import winning_steps
from .summary import facts, level_labels, number_text, place_words, typeset

WORKS = {
    "program": "The raytrace_jax developers, raytrace_jax: a differentiable Whitted ray tracer in JAX, "
    f"version {__version__}.",
    "whitted": "T. Whitted, “An improved illumination model for shaded display”, Communications of the ACM 23, 1980.",
    "jax": "J. Bradbury et al., “JAX: composable transformations of Python+NumPy programs”, 2018.",
    "schlick": "C. Schlick, “An Inexpensive BRDF Model for Physically-based Rendering”, Computer Graphics Forum 13, "
    "1994: the reflectance.",
    "optimistix": "J. Rader, T. Lyons, P. Kidger, “Optimistix: modular optimisation in JAX and Equinox”, "
    "arXiv:2402.09983, 2024: the Levenberg–Marquardt solver.",
    "sandwich": "H. White, “A heteroskedasticity-consistent covariance matrix estimator and a direct test for "
    "heteroskedasticity”, Econometrica 48, 1980: the covariance.",
    "vuong": "Q. H. Vuong, “Likelihood ratio tests for model selection and non-nested hypotheses”, Econometrica 57, "
    "1989: the evidence.",
}


def references(result: FitResult) -> dict[str, str]:
    """The works that a fit rests on, in the order of their numbers; the program itself comes first."""
    settings = result.settings
    has_schlick = settings.model == "additive" or (settings.model == "classic" and settings.reflectance == "schlick")
    is_used = {"schlick": has_schlick, "vuong": bool(result.runner_ups)}
    return {name: work for name, work in WORKS.items() if is_used.get(name, True)}


def methods_text(result: FitResult, long: bool = False) -> str:
    """A paragraph on what was fitted and how, to paste into a paper, and the numbered references below it."""
    works, told, sure, check = references(result), result.provenance, result.uncertainty, result.check
    views, samples = result.views, [view.target_samples for view in result.views.values()]
    numbers = {name: f"[{k}]" for k, name in enumerate(works, start=1)}
    stated = [f"{a.name} ({number_text(a.uncertainty, 2)})" for a in check.assumptions if a.uncertainty]
    systematic = [f"the stated uncertainty of {listed(stated)}"] if stated else []
    systematic += ["the model errors that the residual shows"] if np.any(np.diagonal(check.structure) > 0) else []
    apart = zip(result.labels, sure.resolution.tolist(), strict=True)
    paragraph = page_template("report/fit_report/methods.txt.jinja", {"typeset": typeset}).render(
        result=result,
        long=long,
        version=__version__,
        works=works,
        cite=numbers.get,
        listed=listed,
        target=f"{Path(told['target']).name} " if "target" in told else "",
        place=place_words(result),
        sizes={camera: facts(view)["pixels"][0] for camera, view in views.items()},
        samples_of=list(dict.fromkeys(samples)),
        counted=f"{sum(np.count_nonzero(view.counts) for view in views.values()):,}",
        priors=[f"{name} ({number_text(mean, 6)} ± {number_text(sd, 2)})" for name, mean, sd in result.priors],
        levels=list(level_labels(winning_steps(result)).values()),
        facts=facts(result),
        apart=[f"{name} ({number_text(distance, 2)})" for name, distance in apart if distance],
        systematic=systematic if np.any(result.systematic_error > 0) else [],
    )
    cited = (f"{numbers[name]} {work}" for name, work in works.items())
    return "\n".join([" ".join(paragraph.split()), "", *cited, ""])
