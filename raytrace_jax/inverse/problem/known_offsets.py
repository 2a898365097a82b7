"""What other renderers are known to do to pictures, by the name that they leave in files: stated uncertainties."""

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np

from raytrace_jax.errors import PictureWarning
from raytrace_jax.inverse.options import FitOptions
from raytrace_jax.inverse.problem.stated import numbers_of
from raytrace_jax.scene.parameters import blocks_of, resolve, scalar_names
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.words import listed

MITSUBA = "Mitsuba version 3"

RAY_EPSILON = 1500 * 2**-24
"""Share of one more than a point's largest coordinate by which Mitsuba 3, in float32, starts rays off a surface
(`SurfaceInteraction::offset_p` and `math::RayEpsilon`)."""


def with_known_offsets(options: FitOptions, scene: Scene, free: Sequence[str], maker: str) -> FitOptions:
    """The options with what is known of the program that made a target, where nothing was said of the same numbers.

    A ray that enters a ball a little inside of it and leaves it a little outside is refracted as by a ball whose radius
    is off by as much: in pictures by Mitsuba an index is off by 1 to 2e-4, and no residual shows it.

    Args:
        options: the user's.
        scene: the scene of the fit.
        free: canonical names of what is free.
        maker: the program's name, as the target's file has it; empty if it has none.

    Warns:
        PictureWarning: something is taken to be uncertain.
    """
    if not maker.startswith(MITSUBA):
        return options
    said = {address for name in options.uncertain for address in numbers_of(scene, name)}
    said |= {resolve(scene, name).address for name in [*free, *scalar_names(scene, options.ties)]}
    offsets: dict[str, float] = {}
    for ball in blocks_of(scene, "sphere"):
        name = f"{ball.name}.radius"
        center, radius = (np.asarray(ball.read(scene, part), np.float64) for part in ("center", "radius"))
        if resolve(scene, name).address not in said:
            offsets[name] = float(f"{RAY_EPSILON * (1 + np.max(np.abs(center)) + radius):.1e}")
    if offsets:
        stated = listed(f"{name}={amount:g}" for name, amount in offsets.items())
        warnings.warn(
            f"the target is by {maker}, which starts rays a little off surfaces: taken to be uncertain are {stated}; "
            "--uncertain states other amounts.",
            PictureWarning,
            stacklevel=2,
        )
    return dataclasses.replace(options, uncertain={**options.uncertain, **offsets})
