"""Numbers and names as a reader of the report meets them."""

import math
import re
from collections.abc import Iterable, Sequence
from string import ascii_lowercase

from matplotlib.axes import Axes
from matplotlib.font_manager import FontProperties, findfont, get_font

from raytrace_jax.inverse.result import FitResult, FitStep
from raytrace_jax.util.text import value_and_error, with_error

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(number: str) -> str:
    """Write a formatted number with true signs − and ±, and its power of ten, if it has one, as `10⁻⁵`."""
    raised = re.sub(r"e([+-]?[0-9]+)", lambda found: f" × {power_of_ten(int(found[1]))}", number)
    return raised.replace("+-", "±").replace("-", "−")


def power_of_ten(exponent: int) -> str:
    """Write a power of ten with a raised exponent."""
    return f"10{str(exponent).translate(_RAISED)}"


def number_text(value: float, digits: int = 3) -> str:
    """Write a number to some significant digits; infinity and NaN in words."""
    if math.isnan(value):
        return "unknown"
    if math.isinf(value):
        return "infinite"
    # Without a power of ten where that would only say "thousand".
    plain = 0.001 <= abs(value) < 10**5
    rounded = float(f"{value:.{digits - 1}e}")
    return typeset(f"{rounded:.{max(digits, 5)}g}" if plain else f"{value:.{digits}g}")


def in_steps_of_8_bits(colour: float) -> str:
    """Write a difference of colours as `2.43/255`, or `unknown` where it is NaN."""
    text = number_text(255 * colour)
    return text if math.isnan(colour) else f"{text}/255"


def error_text(error: float) -> str:
    """Write an error alone, to two digits; `not determined` where it is infinite and `unknown` where it is NaN."""
    if not math.isfinite(error):
        return "unknown" if math.isnan(error) else "not determined"
    return typeset(value_and_error(0.0, error)[1])


def estimate_line(value: float, error: float, long: bool = False) -> str:
    """Write an estimate with its error on one line, as `with_error` does, with a printer's signs."""
    return typeset(with_error(value, error, long))


def estimate_lines(result: FitResult, long: bool = False) -> list[str]:
    """Every estimate of a fit with its total error, as `estimate_line`."""
    pairs = zip(result.value, result.total_error, strict=True)
    return [estimate_line(float(value), float(error), long) for value, error in pairs]


def correlation_text(correlation: float) -> str:
    """Write a correlation to two decimals, without a minus sign before zero."""
    return typeset(f"{round(correlation, 2) + 0.0:.2f}")


def drawable(name: str, longest: int) -> str:
    """Shorten a name in its middle, and replace what the figures' font has no sign for (a warning otherwise)."""
    font = get_font(findfont(FontProperties()))
    shown = "".join(sign if font.get_char_index(ord(sign)) else "?" for sign in name)
    return shown if len(shown) <= longest else f"{shown[: longest // 2]}…{shown[-longest // 2 :]}"


def level_labels(history: Sequence[FitStep]) -> dict[int, str]:
    """What tells each level of a history apart from the others: its blur, and its number where that is not enough."""
    blurs = {step.level: step.blur for step in history}
    labels = {level: f"blur {blur:g} px" if blur else "no blur" for level, blur in sorted(blurs.items())}
    shared = [label for label in labels.values() if list(labels.values()).count(label) > 1]
    return {level: f"{label}, level {level + 1}" if label in shared else label for level, label in labels.items()}


def letter_panels(axes: Iterable[Axes]) -> None:
    """Put (a), (b), (c) and so on before the titles of the panels that have one and are seen."""
    titled = [ax for ax in axes if ax.get_visible() and ax.get_title()]
    for number, ax in enumerate(titled):
        before, last = divmod(number, len(ascii_lowercase))
        letters = (ascii_lowercase[before - 1] if before else "") + ascii_lowercase[last]
        ax.title.set_text(f"({letters}) {ax.get_title()}")
