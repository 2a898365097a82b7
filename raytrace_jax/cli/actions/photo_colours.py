"""What the colours of photographs say for `photo`: the index at the line d, Abbe's number, and which glass that is."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import RaytraceError
from ...images.jpeg import jpeg_storage
from ...images.pictures import is_jpeg
from ...optics import glass
from ...optics.dispersion import Dispersion
from ...photo.colours import WAVELENGTHS, ColourDifferences, colour_differences, joined
from ...photo.locate import Together
from ...util.digits import with_error
from ...util.text import quoted, value_and_deviation
from ..console import UsageError, print_table
from .glass import print_glasses

MOST_ROWS = 12

Wavelengths = Sequence[tuple[float, float]]
"""Of one light, or of red, green and blue, in nm with their standard deviations."""


def wavelengths_of(text: str | None) -> Wavelengths:
    """What `--wavelengths` says. Raises UsageError."""
    if text is None:
        return WAVELENGTHS
    try:
        each = [value_and_deviation(part) for part in text.split(",")]
        numbers = [(float(value), 0.0 if deviation is None else float(deviation)) for value, deviation in each]
    except ValueError:
        numbers = []
    if len(numbers) not in (1, 3) or not all(300 < value < 1100 and 0 <= spread < 100 for value, spread in numbers):
        raise UsageError(
            f"--wavelengths: {quoted(text)} came; the mean wavelengths of red, green and blue in nanometres are "
            "wanted, as 600+-8,540+-8,460+-8, or that of a lamp of one colour, as 589."
        )
    return numbers


def measure_colours(
    paths: Sequence[Path], images: Sequence[np.ndarray], together: Together
) -> ColourDifferences | None:
    """The differences of the index between colours, from all photographs that show them."""
    each = []
    for path, image, result in zip(paths, images, together.photographs, strict=True):
        if result.located:
            storage = jpeg_storage(path) if is_jpeg(path) else None
            if differences := colour_differences(image, result.located, storage):
                each.append(differences)
    return joined(each) if each else None


def colours_to_dict(differences: ColourDifferences, total: Dispersion, wavelengths: Wavelengths) -> dict[str, Any]:
    """The colours as plain values."""
    return {
        "wavelengths": [{"value": value, "error": error} for value, error in wavelengths],
        "differences": differences.of_index.tolist(),
        "covariance_of_differences": differences.covariance.tolist(),
        "lateral": differences.lateral.tolist(),
        "scatter": differences.scatter,
        "n_d": {"value": total.n_d, "error": float(total.errors[0])},
        "abbe": {"value": total.abbe, "error": float(total.errors[1])},
        "covariance": total.covariance.tolist(),
    }


def print_colours(differences: ColourDifferences, total: Dispersion, is_liquid: bool, long: bool) -> None:
    """Print index and Abbe's number, and the materials of the catalogue that have them, if it is installed."""
    red, _, blue = differences.of_index
    spread = np.sqrt(np.array([-1, 0, 1]) @ differences.covariance @ np.array([-1, 0, 1]))
    apart = with_error(float(blue - red), float(spread), long)
    if not total.is_told:
        print(f"The colours tell no dispersion: the index of blue less that of red is {apart}.")
        return
    rows = [
        ("index at 587.6 nm", with_error(total.n_d, float(total.errors[0]), long)),
        ("Abbe's number", with_error(total.abbe, float(total.errors[1]), long)),
        ("index of blue less that of red", apart),
    ]
    print_table("from the colours", ("number", "estimate"), rows)
    (index_error, abbe_error), (n_d, abbe) = total.errors.tolist(), (total.n_d, total.abbe)
    try:
        found = glass.find(max(n_d, 1.0), index_error, abbe=max(abbe, 1e-3), abbe_error=abbe_error)
    except RaytraceError as missing:
        print(f"Which materials these are: {missing}")
        return
    fitting = [material for material in found if (material.kind == "liquid") == is_liquid]
    if fitting:
        print_glasses(fitting[:MOST_ROWS], f"nearest {min(MOST_ROWS, len(fitting))} of {len(fitting)} materials")
    else:
        print("The catalogue has no material within three errors of both.")
