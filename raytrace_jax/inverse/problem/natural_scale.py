"""How large a parameter's large changes are, and in what unit it is counted, by its nature and the scene's size."""

import numpy as np
from jaxtyping import Array

from raytrace_jax.scene.addresses import resolve
from raytrace_jax.scene.extent import world_length
from raytrace_jax.scene.nature import Nature
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName

UNITS_OF_A_WORLD = 10
"""How many units of length a scene measures: that of the course's scenes is their world unit."""

LEAST_SCALE = 0.1
"""The natural scale, in units, of a number that is 0 and so has no size of its own."""


def natural_unit(scene: Scene, nature: Nature, model: ModelName = "classic") -> float:
    """What a number of about 1 means for a parameter of this nature: a scene of another size has the scaled one."""
    return (float(world_length(scene)) / UNITS_OF_A_WORLD) ** nature.dimension_in(model)


def natural_scale(scene: Scene, name: str, model: ModelName = "classic") -> float:
    """How large a change of a parameter is a large one: the step of a search, the measure of an error.

    An index counts from 1, a position in radii of its sphere, anything else by its own size, as its `Nature` says.
    """
    address, block, attribute, _ = resolve(scene, name)
    value, nature = float(address.read(scene)), attribute.nature
    unit = natural_unit(scene, nature, model)
    if nature.scale == "index":
        return max(abs(value - 1), LEAST_SCALE)
    if nature.scale == "block":
        return max(_length(block.read(scene, side)) for side in nature.sized_by)
    if nature.scale == "vector":
        return max(_length(address.entry.read(scene)), unit)
    return max(abs(value), LEAST_SCALE * unit)


def _length(value: Array) -> float:
    """The length of a vector, the magnitude of a number."""
    return float(np.linalg.norm(value)) if value.ndim else abs(float(value))
