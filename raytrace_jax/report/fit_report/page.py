"""The page of a fit's report: one HTML file that needs no other file, no network and no script."""

import math
import re

import numpy as np
from PIL import Image

from ...inverse.judge.assumptions import WHAT_IF
from ...inverse.judge.structure import EVIDENCE
from ...inverse.result import FitResult, Minimum
from ..films import screen_transfer
from ..panels import SIGNED, as_pixels, page_template, signed_pixels
from . import summary
from .curves import corner_columns
from .figure import COLOURS, Sheet, embed, residual_of
from .methods import methods_text
from .summary import facts, number_text, typeset


def provenance_rows(result: FitResult) -> list[tuple[str, str]]:
    """The origin of a fit: its target, command, date and time."""
    labels = {"target": "target", "target_size": "its size [pixels]", "target_bytes": "its file [bytes]"}
    labels |= {"target_sha256": "SHA-256 of it", "command": "command", "date": "date"}
    labels |= {"seconds": "time to the last step [s]", "stages": "time by stage"}
    known = summary.provenance_of(result)
    stages = "; ".join(f"{stage}: {seconds:.3g} s" for stage, seconds in known["stages"].items())
    size = facts(result)["pixels"][0] + summary.place_words(result)
    known |= {"target_size": size, "stages": stages or "none"}
    labels |= {name: name.replace("_", " ") for name in known if name not in labels}
    return [(label, known[name]) for name, label in labels.items() if name in known]


def setting_text(value: object) -> str:
    """A setting in a user's words."""
    if isinstance(value, tuple):
        return ", ".join(map(str, value)) or "none"
    if isinstance(value, bool):
        return "on" if value else "off"
    return "not set" if value is None else str(value)


def render_page(result: FitResult, scene_text: str, sheet: Sheet, long: bool = False) -> str:
    """The report of a fit as the text of one HTML file; `long` writes estimates as `with_error` does then."""
    filters = {"number": number_text, "error": summary.error_text, "typeset": typeset}
    filters["correlation"] = summary.correlation_text
    # Lines may break behind a name's dots and underscores, but not before a last letter.
    filters["pieces"] = re.compile("(?<=[._])(?=..)").split
    template = page_template("raytrace_jax.report.fit_report", "page.html.jinja", filters)
    pictures, transfer, known = result.pictures, screen_transfer(result.settings), np.isfinite(result.standard_error)
    shown = {"target": pictures.target, "start": pictures.start, "fit": pictures.estimate}
    images = {name: as_pixels(image, transfer) for name, image in shown.items() if image is not None}
    # A fit that was stopped has not rendered all.
    residual = None if pictures.estimate is None else residual_of(result, pictures.estimate)
    if residual is not None:
        images["fit − target"] = signed_pixels(residual.picture, residual.limit)
    estimate = Minimum(result.history.candidate, result.value, pictures.rms_residual, 0, True, math.nan)
    used = {"loss": result.given.loss} | summary.used_settings(result.settings)
    return template.render(
        {group: [(*said, embed(image, 64)) for *said, image in cut] for group, cut in sheet.cut.items()},
        result=result,
        corner=[result.labels[k] for k in corner_columns(result)],
        long=long,
        status=result.status.replace("_", " "),
        colour=COLOURS[result.status],
        facts=facts(result),
        pictures=[(name, embed(Image.fromarray(pixels))) for name, pixels in images.items()],
        residual=residual,
        stops=[f"rgb({r}, {g}, {b})" for r, g, b, _ in SIGNED(np.linspace(0, 1, 11), bytes=True)],
        priors={name: f"{number_text(mean)} ± {number_text(spread, 2)}" for name, mean, spread in result.given.priors},
        correlation=np.where(known & known[:, None], result.uncertainty.correlation, np.nan).tolist(),
        has_systematic=bool(np.any(result.systematic_error > 0)),
        assumptions=result.check.assumptions[:10],
        what_if=WHAT_IF,
        minima=[estimate, *result.history.runner_ups[:5]],
        levels=summary.level_labels(result.history.steps),
        convincing=EVIDENCE,
        settings=[(name.replace("_", " "), setting_text(value)) for name, value in used.items()],
        provenance=provenance_rows(result),
        versions=summary.versions(),
        methods=methods_text(result, long),
        scene=scene_text,
    )
