"""What no free number changes, as the board beside a ball: whether the target shows it where the scene says."""

import warnings

import numpy as np
from scipy import ndimage

from ...errors import PictureError, RaytraceWarning
from ...scene.parameters import list_parameters
from ...scene.setting_words import EdgeMode
from ...util.text import listed
from ..problem.problem import Problem
from ..problem.unknowns import Image, Mask

REFUSED, DOUBTED = 0.3, 0.8
"""Correlations below which a target is refused, and its fit warns. Of a board in squares of .6, 160 x 120, an angle of
view of 33 for 32 degrees leaves .75, 34 .43, 35 .21 and 40 nothing; a right scene has .9 or more, under uneven light
too. Whatever the free numbers are, a fit with .3 leaves more than the fifth of the contrast that is near a target."""


def still_correlation(problem: Problem, edges: EdgeMode, binning: int) -> float | None:
    """The correlation of target and start where no free number of the scene changes the picture.

    Gains and offsets of the channels do not change it. None where the camera is free, where that is less than a tenth
    of the picture, or either of the two has no contrast there.
    """
    if any(name.startswith(f"{problem.scene.camera.name}.") for name in problem.unknowns.names):
        return None
    radiance, observation = problem.radiance(problem.start(), edges, binning), problem.binned(binning)
    # A flat square has no derivative, though its edges move; and a ball begins a part of its radius away.
    moving = np.any(np.asarray(radiance.jacobian) != 0, axis=(0, 1))
    near = np.asarray(ndimage.binary_dilation(moving, iterations=max(1, len(moving) // 8)), bool)
    still = observation.counts & ~near
    if np.mean(still) < 0.1:
        return None
    image, target = (centred(np.asarray(picture), still) for picture in (radiance.image, observation.target))
    if image is None or target is None:
        return None
    return float(np.vdot(image, target) / (np.linalg.norm(image) * np.linalg.norm(target)))


def centred(picture: Image, where: Mask):
    """The colours there less the mean of each channel, "3 pixels"; None if they vary by less than a tenth of it."""
    colours = picture[:, where].astype(np.float64)
    varied = colours - colours.mean(axis=1, keepdims=True)
    return varied if np.std(varied) > 0.1 * np.mean(np.abs(colours)) else None


def compare_still(problem: Problem, edges: EdgeMode, binning: int) -> str:
    """Words on what lies elsewhere than the scene says and no free number changes, for the end of a fit; often empty.

    Raises:
        PictureError: it is beyond doubt.

    Warns:
        RaytraceWarning: it is likely.
    """
    correlation = still_correlation(problem, edges, binning)
    if correlation is None or correlation >= DOUBTED:
        return ""
    name = problem.scene.camera.name
    numbers = [each for each in list_parameters(problem.scene) if each.startswith(f"{name}.")]
    numbers.sort(key=lambda each: each != f"{name}.fov")
    found = (
        "what no free number changes, as a board beside a ball, is not in the target where the scene says: the "
        f"correlation with the picture at the start is {correlation:.2f} there, and about 1 of a scene that is right"
    )
    causes = f"look first at the camera's numbers, {listed(numbers)}, then at the places of board and texture"
    mend = f"Render the scene and {causes}. Correct them, or free what is nearly right, as --free {numbers[0]}"
    if correlation < REFUSED:
        raise PictureError(f"{found}. {mend}; --mask leaves out what the scene lacks.")
    warnings.warn(f"{found}. {mend}.", RaytraceWarning, stacklevel=2)
    return f". The board or the like does not lie where the scene says: {causes}"
