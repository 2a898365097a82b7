"""What a fit did, as a paragraph for the methods section of a paper, with its references."""

from pathlib import Path

import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.fit_report.text import estimate_lines, in_steps_of_8_bits, level_labels, number_text
from raytrace_jax.report.fit_report.traces import winning_steps
from raytrace_jax.util.words import listed

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

LOSSES = {"l2": "the sum of squared", "cauchy": "Cauchy's loss of the"}
A_LOSS = "a loss of the"
"""What a fit minimised that was stopped before it chose."""


def references(result: FitResult) -> list[str]:
    """The works that a fit rests on, in the order of their numbers; the program itself comes first."""
    settings = result.settings
    has_schlick = settings.model == "additive" or (settings.model == "classic" and settings.reflectance == "schlick")
    needed = {
        PROGRAM: True,
        WHITTED: True,
        JAX: True,
        SCHLICK: has_schlick,
        OPTIMISTIX: True,
        SANDWICH: True,
        VUONG: bool(result.history.runner_ups),
    }
    return [work for work, is_needed in needed.items() if is_needed]


def methods_text(result: FitResult, long: bool = False) -> str:
    """A paragraph on what was fitted and how, to paste into a paper, and the numbered references below it."""
    works = references(result)

    def cited(*wanted: str) -> str:
        return f"[{', '.join(str(works.index(work) + 1) for work in wanted)}]"

    sentences = [_fitted(result, cited(PROGRAM), cited(WHITTED), cited(JAX)), _rendered(result)]
    if SCHLICK in works:
        sentences.append(f"Glass reflects by Schlick's approximation {cited(SCHLICK)}.")
    sentences.append(_minimised(result, cited(OPTIMISTIX)))
    sentences.append(_errors(result, "" if SANDWICH not in works else cited(SANDWICH)))
    if VUONG in works:
        count = len(result.history.runner_ups)
        others = f"{count} other {'minimum' if count == 1 else 'minima'}"
        sentences.append(f"Vuong's test {cited(VUONG)} compared the estimate with {others}.")
    sentences.append(_estimates(result, long))
    return "\n\n".join([" ".join(sentences), "\n".join(f"[{k + 1}] {work}" for k, work in enumerate(works))]) + "\n"


def _fitted(result: FitResult, program: str, whitted: str, jax: str) -> str:
    height, width = result.pictures.weights.shape
    target = Path(result.provenance["target"]).name if "target" in result.provenance else ""
    digest = result.provenance.get("target_sha256", "")
    crop = result.settings.crop
    told = f"{width} × {height} pixels" + (f" from column {crop[0]}, row {crop[1]} on" if crop else "")
    told += f", SHA-256 {digest}" if digest else ""
    return (
        f"{listed(result.labels)} {'were' if len(result.names) > 1 else 'was'} fitted to the picture {target} ({told}) "
        f"with raytrace_jax {__version__} {program}, a differentiable Whitted ray tracer {whitted} in JAX {jax}."
    ).replace("  ", " ")


def _rendered(result: FitResult) -> str:
    samples = result.target_samples
    pixel = "one sample" if samples == 1 else f"the mean of {samples} × {samples} samples on a regular grid"
    pixel = "the mean over its area" if samples is None else pixel
    return (
        f"The scene was rendered with the shading model “{result.settings.model}”; each pixel of the target was taken "
        f"for {pixel}."
    )


def _minimised(result: FitResult, solver: str) -> str:
    counted = int(np.count_nonzero(result.pictures.weights))
    steps = result.history.steps
    priors = [f"{name} ({number_text(mean, 6)} ± {number_text(sd, 2)})" for name, mean, sd in result.priors]
    known = f", with normal priors on {listed(priors)}," if priors else ""
    levels, starts = list(level_labels(winning_steps(result)).values()), len({step.candidate for step in steps})
    way = f", from coarse to fine ({'; '.join(levels)})" if len(levels) > 1 else ""
    return (
        f"The fit minimised {LOSSES.get(result.loss, A_LOSS)} differences between picture and target over "
        f"{counted:,} pixels{known} by the Levenberg–Marquardt method {solver}{way}, "
        f"from {starts} {'start' if starts == 1 else 'starts'}."
    )


def _errors(result: FitResult, sandwich: str) -> str:
    """How the errors were made: of noise, and of what else was stated or seen."""
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
            ", and so is, in quadrature, how far those values lie apart whose pictures, in the target's samples or as "
            f"it was stored, are the same: {listed(apart)}"
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


def _estimates(result: FitResult, long: bool) -> str:
    found = [f"{name} = {line}" for name, line in zip(result.labels, estimate_lines(result, long), strict=True)]
    form = "values ± one standard deviation" if long else "one standard deviation in the last digits in parentheses"
    return f"The estimates, {form}, are {'; '.join(found)}. The fit ended as “{result.status.replace('_', ' ')}”."
