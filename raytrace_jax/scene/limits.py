"""What values an attribute may have, and several attributes of a block together; each in words as well."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from raytrace_jax.scene.distortion import visible_share
from raytrace_jax.scene.setting_words import MAX_BOUNCES, MAX_PICTURE_SIDE, MAX_SAMPLES


class Limit(NamedTuple):
    """A condition on an attribute's values, and its words for people: `<attribute> must be <wanted>`."""

    holds: Callable[[np.ndarray], bool]
    wanted: str


class Check(NamedTuple):
    """A condition on several attributes of a block.

    `complaint` takes their values in this order and says what is wrong with them, as a sentence without its end; None
    if nothing is.
    """

    attributes: tuple[str, ...]
    complaint: Callable[..., str | None]


def _direction(a: np.ndarray) -> np.ndarray:
    """The unit vector along `a` in float64; zero stays zero, and squares neither overflow nor vanish."""
    scaled = np.asarray(a, np.float64) / (np.max(np.abs(a)) or 1.0)
    return scaled / (np.linalg.norm(scaled) or 1.0)


def _not_orthogonal(right: np.ndarray, up: np.ndarray) -> str | None:
    cosine = float(np.clip(_direction(right) @ _direction(up), -1, 1))
    # Right angles to 1e-4: people write four or five digits.
    if abs(cosine) <= 1e-4:
        return None
    return f"right and up must be orthogonal, but the angle between them is {np.degrees(np.arccos(cosine)):.6g} degrees"


def _looks_nowhere(viewpoint: np.ndarray, lookat: np.ndarray) -> str | None:
    if np.any(viewpoint != lookat):
        return None
    return "lookat must be another point than viewpoint, or the camera looks nowhere"


def _not_upright(viewpoint: np.ndarray, lookat: np.ndarray, up: np.ndarray) -> str | None:
    # Halved, the difference of two large numbers cannot overflow.
    view = _direction(np.asarray(lookat, np.float64) / 2 - np.asarray(viewpoint, np.float64) / 2)
    # Parallel to 1e-6: float32 resolves no more.
    if np.linalg.norm(np.cross(view, _direction(up))) >= 1e-6:
        return None
    return "up must not be parallel to the view from viewpoint to lookat, or nothing is upright"


def _folds_over(pixeldim: np.ndarray, fov: np.ndarray, center: np.ndarray, distortion: np.ndarray) -> str | None:
    with np.errstate(over="ignore", divide="ignore", invalid="ignore"):
        # From the principal point to the corners of the picture, which are half a pixel beyond their pixels' centres.
        corners = np.maximum(center.astype(np.float64) + 0.5, pixeldim - 0.5 - center)
        focal_length = pixeldim[0] / (2 * np.tan(np.radians(fov.astype(np.float64)) / 2))
        share = visible_share(distortion, np.hypot(*corners) / focal_length)
    if not share <= 1:
        return None
    return (
        "distortion must not fold the picture over, but it does at "
        f"{100 * share:.4g} % of the way from center to the farthest corner"
    )


POSITIVE = Limit(lambda values: bool(np.all(values > 0)), "greater than 0")
NOT_NEGATIVE = Limit(lambda values: bool(np.all(values >= 0)), "0 or greater")
UNIT_INTERVAL = Limit(lambda values: bool(np.all((values >= 0) & (values <= 1))), "from 0 to 1")
NOT_ALL_ZERO = Limit(lambda values: bool(np.any(values != 0)), "a vector other than 0 0 0")
ANGLE_OF_VIEW = Limit(
    lambda values: bool(np.all((values > 0) & (values < 180))), "greater than 0 and less than 180 degrees"
)
BELOW_ONE = Limit(lambda values: bool(np.all((values >= 0) & (values < 1))), "0 or greater and less than 1")
BOUNCES = Limit(lambda values: bool(np.all((values >= 0) & (values <= MAX_BOUNCES))), f"from 0 to {MAX_BOUNCES}")
SAMPLES = Limit(lambda values: bool(np.all((values >= 1) & (values <= MAX_SAMPLES))), f"from 1 to {MAX_SAMPLES}")
LOST_LIGHT = Limit(lambda values: bool(np.all((values >= -1) & (values < 1))), "-1 or greater and less than 1")
SLIGHT_DISTORTION = Limit(lambda values: bool(np.all(np.abs(values) <= 0.3)), "from -0.3 to 0.3")
PICTURE_SIDES = Limit(
    lambda values: bool(np.all((values >= 1) & (values <= MAX_PICTURE_SIDE))),
    f"from 1 to {MAX_PICTURE_SIDE} a side",
)

ORTHOGONAL_SIDES = Check(("right", "up"), _not_orthogonal)
LOOKS_SOMEWHERE = Check(("viewpoint", "lookat"), _looks_nowhere)
UPRIGHT = Check(("viewpoint", "lookat", "up"), _not_upright)
UNFOLDED = Check(("pixeldim", "fov", "center", "distortion"), _folds_over)
