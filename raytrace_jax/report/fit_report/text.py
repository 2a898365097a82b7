"""Numbers and names as a reader of the report meets them."""

import math
from collections.abc import Sequence

from matplotlib.font_manager import FontProperties, findfont, get_font

from raytrace_jax.inverse.result import FitStep
from raytrace_jax.util.text import value_and_error

_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def typeset(number: str) -> str:
    """Write a formatted number with a true minus sign, and its power of ten, if it has one, as `10⁻⁵`."""
    mantissa, _, exponent = number.partition("e")
    if exponent:
        mantissa += f" × {power_of_ten(int(exponent))}"
    return mantissa.replace("-", "−")


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


def estimate_text(value: float, error: float) -> tuple[str, str]:
    """Write an estimate and its standard error, both to the digits that mean something and in few characters.

    The error is `not determined` where it is infinite and `unknown` where it is NaN.
    """
    value_text, error_text = value_and_error(value, error)
    # More than 11 characters are more than a column or a panel is wide.
    if len(value_text) > 11:
        value_text, error_text = f"{value:.8g}", f"{error:.1g}"
    if not math.isfinite(error):
        error_text = "unknown" if math.isnan(error) else "not determined"
    return typeset(value_text), typeset(error_text) if math.isfinite(error) else error_text


def estimate_line(value: float, error: float) -> str:
    """Write an estimate and its standard error on one line."""
    value_text, error_text = estimate_text(value, error)
    return f"{value_text} ± {error_text}" if math.isfinite(error) else f"{value_text}, {error_text}"


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
