"""The page of a fit's report: one HTML file that needs no other file, no network and no script."""

import re

import numpy as np
from PIL import Image

from raytrace_jax.inverse.judge.assumptions import WHAT_IF
from raytrace_jax.inverse.judge.structure import EVIDENCE
from raytrace_jax.inverse.result import FitResult
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.fit_report import summary
from raytrace_jax.report.fit_report.figure import COLOURS, Embedded, ResidualMap, Sheet, embed, residual_of
from raytrace_jax.report.fit_report.methods import methods_text, references
from raytrace_jax.report.fit_report.summary import in_steps_of_8_bits, number_text, typeset
from raytrace_jax.report.panels import SIGNED, as_pixels, page_template, signed_pixels

PROVENANCE = ("target", "target_size", "target_bytes", "target_sha256", "command", "date", "seconds", "stages")
"""The page tells these of a fit's origin, in this order."""

POSITIVE, NEGATIVE = "178, 24, 43", "33, 102, 172"


def parameter_rows(result: FitResult, long: bool = False) -> list[dict[str, str]]:
    """Every parameter's start, estimate, error and its parts, Cramér-Rao bound, prior and main dependence."""
    priors = {name: f"{number_text(mean)} ± {number_text(spread, 2)}" for name, mean, spread in result.given.priors}
    dependences = {}
    for name, found in result.depends_on.items():
        change, shift = (number_text(value, 2).lstrip("+") for value in (found.change, abs(found.shift)))
        dependences[name] = f"{found.on}: +{change} moves it by {'+' if found.shift > 0 else '−'}{shift}"
    return [
        {
            "name": row.label,
            "start": typeset(f"{row.initial:.8g}"),
            # That an error is not determined or unknown stands in its own column.
            "value": typeset(row.text(long)).partition(",")[0],
            "error": summary.error_text(row.total_error),
            "of_noise": summary.error_text(row.standard_error),
            "systematic": summary.error_text(row.systematic_error),
            "bound": summary.error_text(row.cramer_rao),
            "prior": priors.get(row.name, "–"),
            "depends_on": dependences.get(row.name, "–"),
        }
        for row in result.rows
    ]


def correlation_rows(result: FitResult) -> list[tuple[str, list[tuple[str, str]]]]:
    """The lower triangle of the correlation matrix: for each parameter, texts and background colours."""
    determined = np.isfinite(result.standard_error)

    def cell(i: int, j: int) -> tuple[str, str]:
        r = float(result.uncertainty.correlation[i, j])
        if i == j or not (np.isfinite(r) and determined[i] and determined[j]):
            return "1" if i == j else "–", "transparent"
        return summary.correlation_text(r), f"rgba({POSITIVE if r > 0 else NEGATIVE}, {0.45 * min(abs(r), 1):.2f})"

    return [(name, [cell(i, j) for j in range(i + 1)]) for i, name in enumerate(result.labels)]


def assumption_rows(result: FitResult) -> list[tuple[str, list[str]]]:
    """The numbers that the answer rests on most, and how far each estimate moves if one is a tenth of a percent off.

    The columns are the number in the scene, how well it is known if that was stated, and the estimates.
    """
    rows = []
    for assumption in result.check.assumptions[:10]:
        shifts = assumption.sensitivity * assumption.size * WHAT_IF
        stated = number_text(assumption.uncertainty, 2) if assumption.uncertainty else "–"
        value = typeset(f"{assumption.value:.8g}")
        rows.append((assumption.name, [value, stated, *(number_text(float(shift), 2) for shift in shifts)]))
    return rows


def minima_table(result: FitResult) -> dict[str, object]:
    """The estimate beside the best of the other minima: their starts, texts by label, and how many are left out."""
    others = result.history.runner_ups[:5]
    labels = summary.level_labels(result.history.steps)
    rows = [
        (name, [number_text(float(v), 6) for v in (result.value[k], *(other.value[k] for other in others))])
        for k, name in enumerate(result.labels)
    ]
    residuals = [255 * rms for rms in (result.pictures.rms_residual, *(other.rms_residual for other in others))]
    rows.append(("rms residual [1/255]", [number_text(rms) for rms in residuals]))
    rows.append(("judged with", ["no blur", *(labels.get(m.level, f"level {m.level + 1}") for m in others)]))
    rows.append(("evidence", ["–", *(number_text(other.evidence) for other in others)]))
    words = ["worse" if other.evidence >= EVIDENCE else "cannot be told apart" for other in others]
    told = [word if other.explained else "does not explain it" for word, other in zip(words, others, strict=True)]
    rows.append(("verdict", ["estimate", *told]))
    candidates = [result.history.candidate, *(other.candidate for other in others)]
    return {"candidates": candidates, "rows": rows, "left_out": len(result.history.runner_ups) - len(others)}


def provenance_rows(result: FitResult) -> list[tuple[str, str]]:
    """The origin of a fit: its target, command, date and time."""
    labels = {"target_size": "its size [pixels]", "target_bytes": "its file [bytes]", "target_sha256": "SHA-256 of it"}
    labels |= {"seconds": "time to the last step [s]", "stages": "time by stage"}
    known = summary.provenance_of(result)
    width, height = known["target_size"]
    stages = "; ".join(f"{stage}: {seconds:.3g} s" for stage, seconds in known["stages"].items())
    part = f" from column {crop[0]}, row {crop[1]} on" if (crop := result.settings.crop) else ""
    known |= {"target_size": f"{width} × {height}{part}", "stages": stages or "none"}
    order = [name for name in PROVENANCE if name in known] + [name for name in known if name not in PROVENANCE]
    return [(labels.get(name, name.replace("_", " ")), known[name]) for name in order]


def _setting(value: object) -> str:
    """A setting in a user's words."""
    if isinstance(value, bool):
        return "on" if value else "off"
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    return "not set" if value is None else str(value)


def render_page(result: FitResult, scene_text: str, sheet: Sheet, long: bool = False) -> str:
    """The report of a fit as the text of one HTML file; `long` writes estimates as `with_error` does then."""
    # Lines may break behind a name's dots and underscores, but not before a last letter.
    pieces = re.compile("(?<=[._])(?=..)").split
    template = page_template("raytrace_jax.report.fit_report", "page.html.jinja", {"pieces": pieces})
    panels = {group: [(*said, embed(image, 64)) for *said, image in cut] for group, cut in sheet.cut.items()}
    residual = None if result.pictures.estimate is None else residual_of(result, result.pictures.estimate)
    used = summary.used_settings(result.settings)
    settings = [(name.replace("_", " "), _setting(value)) for name, value in used.items()]
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
        settings=[("loss", result.given.loss), *settings],
        provenance=provenance_rows(result),
        versions=summary.versions(),
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
    typical = "where the picture depends on a parameter"
    if left_out := pictures.left_out:
        typical = f"by the median; {left_out:,} pixel{'s' * (left_out > 1)} at edges and the like left out"
    facts = [
        ("rms residual", in_steps_of_8_bits(pictures.rms_residual), "no blur, every pixel that counts"),
        ("typical residual", in_steps_of_8_bits(pictures.typical_residual), typical),
        ("noise", in_steps_of_8_bits(sure.sigma), f"standard deviation, {origin}"),
    ]
    if sure.sigma_given:
        facts.append(("reduced chi-square", number_text(sure.reduced_chi_square), "1 is right"))
    facts.append(("condition number", number_text(sure.condition_number), "1 is best; of the scaled Jacobian"))
    steps, starts = len(result.history.steps), len({step.candidate for step in result.history.steps})
    seconds = f"{result.history.steps[-1].seconds:.3g} s" if steps else "no time"
    facts.append(("steps", str(steps), f"{starts} {'start' if starts == 1 else 'starts'}, {seconds}"))
    facts.append(("pixels", f"{width} × {height}", "all count" if counted == width * height else f"{counted:,} count"))
    if (samples := result.target_samples) is None:
        return [*facts, ("target's samples", "many", "each pixel is taken for the mean over its area")]
    return [*facts, ("target's samples", f"{samples} × {samples}", "a pixel, on a regular grid")]


def _pictures(result: FitResult, residual: ResidualMap | None) -> list[tuple[str, Embedded]]:
    """The pictures that there are; a fit that was stopped has not rendered all."""
    images = (("target", result.pictures.target), ("start", result.pictures.start), ("fit", result.pictures.estimate))
    transfer = screen_transfer(result.settings)
    shown = [(name, embed(Image.fromarray(as_pixels(image, transfer)))) for name, image in images if image is not None]
    if residual is None:
        return shown
    return [*shown, ("fit − target", embed(Image.fromarray(signed_pixels(residual.picture, residual.limit))))]


def _residual_scale(residual: ResidualMap) -> dict[str, object]:
    """The colour bar of the residual: its stops, and what its ends say."""
    stops = SIGNED(np.linspace(0, 1, 11), bytes=True)[:, :3]
    limit = number_text(residual.limit)
    return {
        "stops": ", ".join(f"rgb({r}, {g}, {b})" for r, g, b in stops),
        "ends": (f"≤ −{limit}", f"≥ +{limit}") if residual.extends else (f"−{limit}", f"+{limit}"),
        "excluded": bool(np.ma.count_masked(residual.picture)),
    }
