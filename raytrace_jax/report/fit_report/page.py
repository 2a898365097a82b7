"""The page of a fit's report: one HTML file that needs no other file, no network and no script."""

import re

import numpy as np
from PIL import Image

from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.fit_report.figure import COLOURS, Sheet
from raytrace_jax.report.fit_report.methods import methods_text, references
from raytrace_jax.report.fit_report.pictures import Embedded, Residual, embed, residual_of
from raytrace_jax.report.fit_report.summary import versions
from raytrace_jax.report.fit_report.tables import (
    assumption_rows,
    correlation_rows,
    minima_table,
    parameter_rows,
    provenance_rows,
    setting_rows,
)
from raytrace_jax.report.fit_report.text import in_steps_of_8_bits, number_text
from raytrace_jax.report.panels import SIGNED, as_pixels, signed_pixels
from raytrace_jax.report.templates import page_template


def render_page(result: FitResult, scene_text: str, sheet: Sheet, long: bool = False) -> str:
    """The report of a fit as the text of one HTML file; `long` writes estimates as `with_error` does then."""
    # Lines may break behind a name's dots and underscores, but not before a last letter.
    pieces = re.compile("(?<=[._])(?=..)").split
    template = page_template("raytrace_jax.report.fit_report", "page.html.jinja", {"pieces": pieces})
    panels = {group: [(*said, embed(image, 64)) for *said, image in cut] for group, cut in sheet.cut.items()}
    residual = None if result.pictures.estimate is None else residual_of(result, result.pictures.estimate)
    return template.render(
        **panels,
        result=result,
        long=long,
        status=result.status.replace("_", " "),
        colour=COLOURS[result.status],
        facts=_facts(result),
        pictures=_pictures(result, residual),
        residual_scale=None if residual is None else _residual_scale(residual),
        parameters=parameter_rows(result, long),
        correlations=correlation_rows(result),
        has_systematic=bool(np.any(result.systematic_error > 0)),
        assumptions=assumption_rows(result),
        comparison=minima_table(result),
        settings=setting_rows(result),
        provenance=provenance_rows(result),
        versions=versions(),
        methods=methods_text(result, long),
        references=references(result),
        scene=scene_text,
    )


def _facts(result: FitResult) -> list[tuple[str, str, str]]:
    """Label, number and remark of each number that judges the whole fit."""
    pictures, sure = result.pictures, result.uncertainty
    height, width = pictures.weights.shape
    counted = int(np.count_nonzero(pictures.weights))
    origin = "given" if sure.sigma_given else "estimated from the residual"
    facts = [
        ("rms residual", in_steps_of_8_bits(pictures.rms_residual), "no blur, every pixel that counts"),
        ("typical residual", in_steps_of_8_bits(pictures.typical_residual), _left_out(result)),
        ("noise", in_steps_of_8_bits(sure.sigma), f"standard deviation, {origin}"),
    ]
    if sure.sigma_given:
        facts.append(("reduced chi-square", number_text(sure.reduced_chi_square), "1 is right"))
    facts.append(("condition number", number_text(sure.condition_number), "1 is best; of the scaled Jacobian"))
    steps, starts = len(result.history.steps), len({step.candidate for step in result.history.steps})
    seconds = f"{result.history.steps[-1].seconds:.3g} s" if steps else "no time"
    facts.append(("steps", str(steps), f"{starts} {'start' if starts == 1 else 'starts'}, {seconds}"))
    share = "all count" if counted == width * height else f"{counted:,} count"
    facts.append(("pixels", f"{width} × {height}", share))
    samples = result.target_samples
    if samples is None:
        facts.append(("target's samples", "many", "each pixel is taken for the mean over its area"))
    else:
        facts.append(("target's samples", f"{samples} × {samples}", "a pixel, on a regular grid"))
    return facts


def _left_out(result: FitResult) -> str:
    """What the typical residual does not count."""
    left_out = result.pictures.left_out
    if not left_out:
        return "where the picture depends on a parameter"
    pixels = f"{left_out:,} pixel{'s' if left_out > 1 else ''}"
    return f"by the median; {pixels} at edges and the like left out"


def _pictures(result: FitResult, residual: Residual | None) -> list[tuple[str, Embedded]]:
    """The pictures that there are; a fit that was stopped has not rendered all."""
    images = (("target", result.pictures.target), ("start", result.pictures.start), ("fit", result.pictures.estimate))
    transfer = screen_transfer(result.settings)
    shown = [(name, embed(Image.fromarray(as_pixels(image, transfer)))) for name, image in images if image is not None]
    if residual is None:
        return shown
    return [*shown, ("fit − target", embed(Image.fromarray(signed_pixels(residual.picture, residual.limit))))]


def _residual_scale(residual: Residual) -> dict[str, object]:
    """The colour bar of the residual: its stops, and what its ends say."""
    stops = SIGNED(np.linspace(0, 1, 11), bytes=True)[:, :3]
    limit = number_text(residual.limit)
    return {
        "stops": ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops),
        "ends": (f"≤ −{limit}", f"≥ +{limit}") if residual.extends else (f"−{limit}", f"+{limit}"),
        "excluded": bool(np.ma.count_masked(residual.picture)),
    }
