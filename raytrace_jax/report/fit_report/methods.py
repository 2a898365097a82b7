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
    works, views, sure, check = references(result), result.views.values(), result.uncertainty, result.check
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
        target=_target_words(result),
        samples_of=list(dict.fromkeys(view.target_samples for view in views)),
        counted=f"{sum(np.count_nonzero(view.counts) for view in views):,}",
        priors=[f"{name} ({number_text(mean, 6)} ± {number_text(sd, 2)})" for name, mean, sd in result.priors],
        levels=list(level_labels(winning_steps(result)).values()),
        facts=facts(result),
        apart=[f"{name} ({number_text(distance, 2)})" for name, distance in apart if distance],
        systematic=systematic if np.any(result.systematic_error > 0) else [],
    )
    cited = (f"{numbers[name]} {work}" for name, work in works.items())
    return "\n".join([" ".join(paragraph.split()), "", *cited, ""])


def _target_words(result: FitResult) -> str:
    """The picture that was fitted, or those of all views: files, sizes and their hash."""
    views, paths = result.views, result.provenance.get("target", "")
    sizes = {camera: f"{facts(view)['pixels'][0]} pixels{place_words(view)}" for camera, view in views.items()}
    hashed = [f"SHA-256 {result.provenance['target_sha256']}"] if "target_sha256" in result.provenance else []
    if len(views) == 1:
        return f"the picture {Path(paths).name} ({', '.join([*sizes.values(), *hashed])})"
    names = [f"{Path(path).name}, " for path in paths.split(", ")]
    # A path with a comma in it is not told from two.
    names = names if paths and len(names) == len(views) else [""] * len(views)
    each = [f"{camera}: {name}{size}" for name, (camera, size) in zip(names, sizes.items(), strict=True)]
    return f"the pictures of {len(views)} views ({'; '.join([*each, *hashed])})"
