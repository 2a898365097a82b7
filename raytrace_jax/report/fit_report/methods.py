"""A paragraph for the methods section of a paper on what a fit did, with its references."""

import itertools
from pathlib import Path

import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.fit_report.curves import winning_steps
from raytrace_jax.report.fit_report.summary import in_steps_of_8_bits, level_labels, number_text, typeset
from raytrace_jax.util.text import listed

PROGRAM = (
    f"The raytrace_jax developers, raytrace_jax: a differentiable Whitted ray tracer in JAX, version {__version__}."
)
WHITTED = "T. Whitted, “An improved illumination model for shaded display”, Communications of the ACM 23, 1980."
JAX = "J. Bradbury et al., “JAX: composable transformations of Python+NumPy programs”, 2018."
OPTIMISTIX = (
    "J. Rader, T. Lyons, P. Kidger, “Optimistix: modular optimisation in JAX and Equinox”, arXiv:2402.09983, 2024: "
    "the Levenberg–Marquardt solver."
)
SANDWICH = (
    "H. White, “A heteroskedasticity-consistent covariance matrix estimator and a direct test for heteroskedasticity”, "
    "Econometrica 48, 1980: the covariance."
)
SCHLICK = (
    "C. Schlick, “An Inexpensive BRDF Model for Physically-based Rendering”, Computer Graphics Forum 13, 1994: the "
    "reflectance."
)
VUONG = (
    "Q. H. Vuong, “Likelihood ratio tests for model selection and non-nested hypotheses”, Econometrica 57, 1989: the "
    "evidence."
)


def references(result: FitResult) -> list[str]:
    """The works that a fit rests on, in the order of their numbers; the program itself comes first."""
    settings = result.settings
    has_schlick = settings.model == "additive" or (settings.model == "classic" and settings.reflectance == "schlick")
    others = [SCHLICK] * has_schlick, [OPTIMISTIX, SANDWICH], [VUONG] * bool(result.history.runner_ups)
    return [PROGRAM, WHITTED, JAX, *itertools.chain(*others)]


def methods_text(result: FitResult, long: bool = False) -> str:
    """A paragraph on what was fitted and how, to paste into a paper, and the numbered references below it."""
    works, history = references(result), result.history

    def cited(work: str) -> str:
        return f"[{works.index(work) + 1}]"

    # The target, the program and how it rendered.
    height, width = result.pictures.weights.shape
    target = f"{Path(result.provenance['target']).name} " if "target" in result.provenance else ""
    told, crop = f"{width} × {height} pixels", result.settings.crop
    told += f" from column {crop[0]}, row {crop[1]} on" if crop else ""
    told += f", SHA-256 {digest}" if (digest := result.provenance.get("target_sha256", "")) else ""
    samples = result.target_samples
    pixel = "one sample" if samples == 1 else f"the mean of {samples} × {samples} samples on a regular grid"
    sentences = [
        f"{listed(result.labels)} {'were' if len(result.names) > 1 else 'was'} fitted to the picture {target}({told}) "
        f"with raytrace_jax {__version__} {cited(PROGRAM)}, a differentiable Whitted ray tracer {cited(WHITTED)} in "
        f"JAX {cited(JAX)}.",
        f"The scene was rendered with the shading model “{result.settings.model}”; each pixel of the target was taken "
        f"for {'the mean over its area' if samples is None else pixel}.",
    ]
    if SCHLICK in works:
        sentences.append(f"Glass reflects by Schlick's approximation {cited(SCHLICK)}.")

    # The search, and its outcome.
    counted, starts = int(np.count_nonzero(result.pictures.weights)), len({step.candidate for step in history.steps})
    priors = [f"{name} ({number_text(mean, 6)} ± {number_text(sd, 2)})" for name, mean, sd in result.given.priors]
    known = f", with normal priors on {listed(priors)}," if priors else ""
    levels = list(level_labels(winning_steps(result)).values())
    way = f", from coarse to fine ({'; '.join(levels)})" if len(levels) > 1 else ""
    # A fit that was stopped before it chose a loss minimised one of them.
    loss = {"l2": "the sum of squared", "cauchy": "Cauchy's loss of the"}.get(result.given.loss, "a loss of the")
    sentences += [
        f"The fit minimised {loss} differences between picture and target over {counted:,} pixels{known} by the "
        f"Levenberg–Marquardt method {cited(OPTIMISTIX)}{way}, from {starts} {'start' if starts == 1 else 'starts'}.",
        _errors(result, cited(SANDWICH)),
    ]
    if VUONG in works:
        count = len(history.runner_ups)
        others = f"{count} other {'minimum' if count == 1 else 'minima'}"
        sentences.append(f"Vuong's test {cited(VUONG)} compared the estimate with {others}.")
    found = [f"{row.label} = {typeset(row.text(long))}" for row in result.rows]
    form = "values ± one standard deviation" if long else "one standard deviation in the last digits in parentheses"
    sentences.append(f"The estimates, {form}, are {'; '.join(found)}.")
    sentences.append(f"The fit ended as “{result.status.replace('_', ' ')}”.")
    return "\n\n".join([" ".join(sentences), "\n".join(f"[{k + 1}] {work}" for k, work in enumerate(works))]) + "\n"


def _errors(result: FitResult, sandwich: str) -> str:
    """The origin of the errors: noise, and all else that was stated or seen."""
    sure = result.uncertainty
    origin = "given" if sure.sigma_given else "estimated from the residual"
    noise = (
        f"Standard errors come from the sandwich estimate of the covariance {sandwich}, with noise of standard "
        f"deviation {in_steps_of_8_bits(sure.sigma)} ({origin}), which may go together in neighbouring pixels and "
        "channels, and from the rounding of stored numbers, which equal colours share; what residuals of high leverage "
        "hide of it is added"
    )
    rows = zip(result.labels, sure.resolution, strict=True)
    apart = [f"{name} ({number_text(float(distance), 2)})" for name, distance in rows if distance]
    if apart:
        noise += (
            ", and so are, in quadrature, the step that the solver did not take and how far those values lie apart "
            f"whose pictures in the target's samples are the same: {listed(apart)}"
        )
    stated = [f"{a.name} ({number_text(a.uncertainty, 2)})" for a in result.check.assumptions if a.uncertainty]
    if not np.any(result.systematic_error > 0):
        return f"{noise}. All other numbers of the scene count as exact."
    shows = np.any(np.diagonal(result.check.structure) > 0)
    added = " and ".join(
        [f"the stated uncertainty of {listed(stated)}"] * bool(stated)
        + ["the model errors that the residual shows"] * bool(shows)
    )
    return f"{noise}. The total error adds {added}, in quadrature. All other numbers of the scene count as exact."
