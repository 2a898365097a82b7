"""The target of a fit: a picture whose file may not say how its colours were stored."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from raytrace_jax.cli.console import print_warning
from raytrace_jax.cli.options.fits import Fit
from raytrace_jax.images.options import Transfer
from raytrace_jax.images.pictures import read_picture, states_colours
from raytrace_jax.images.png import DECODERS, ENCODERS
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.pose import pose
from raytrace_jax.inverse.solve.pixel_samples import supersampled
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.beside import run_beside
from raytrace_jax.util.numerics import TINY

CLEARLY = 0.7
"""The course's transfer holds unless another one's stored numbers are off by less than this share of its."""


def read_target(
    command: Fit,
    scene: Scene,
    free: Sequence[str],
    settings: ResolvedSettings,
    options: FitOptions,
    weights: Float[np.ndarray, "3 height width"] | None,
) -> Float[np.ndarray, "3 height width"]:
    """Read the target, "3 height width", and say on stderr how it was read if neither file nor user says it.

    Args:
        command: has the file, the layer and the transfer.
        scene, free, settings, options, weights: what the picture at the start is made from.

    Raises:
        PictureError: the target cannot be read, or is none for this scene.
    """
    if command.transfer is not None or states_colours(command.target):
        return read_picture(command.target, transfer=command.transfer, layer=command.layer)
    target = read_picture(command.target, transfer="course", layer=command.layer)
    problem = pose(scene, target, free, settings, options, weights).problem
    # Beside, as a fit is: Ctrl-C need not wait for what is compiled here.
    image = run_beside(lambda: supersampled(problem, problem.start(), settings.samples), lambda: None, lambda: None)
    counts = np.asarray(problem.observation.root_weight) > 0
    off = stored_differences(image[:, counts], target[:, counts], options.fit_exposure)
    nearest = min(off, key=lambda transfer: off[transfer])
    if off[nearest] >= CLEARLY * off["course"]:
        return target
    others = ", ".join(f"--transfer {name}: {value:.2g}" for name, value in off.items() if name != nearest)
    print_warning(
        f"{command.target} does not say how its colours were stored: read with --transfer {nearest}, whose numbers are "
        f"nearer to the picture at the start (off by {off[nearest]:.2g}; with {others}); --transfer decides."
    )
    return read_picture(command.target, transfer=nearest)


def stored_differences(
    image: Float[np.ndarray, "3 pixels"], target: Float[np.ndarray, "3 pixels"], fit_exposure: bool
) -> dict[Transfer, float]:
    """By transfer the mean difference of the numbers that a picture would be stored as, and those of the target.

    Args:
        image: scene-linear.
        target: as the course's transfer reads it, which hardly changes the numbers: others are undone.
        fit_exposure: whether the picture may be brighter or darker.
    """
    stored = ENCODERS["course"](target, bits=16)
    found: dict[Transfer, float] = {}
    for name, decode in DECODERS.items():
        linear = decode(stored)
        scale = float(np.sum(image * linear) / max(np.sum(image**2), TINY)) if fit_exposure else 1.0
        off = ENCODERS[name](scale * image, bits=16).astype(float) - stored
        found[name] = float(np.mean(np.abs(off))) / (2**16 - 1)
    return found
