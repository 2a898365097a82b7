"""The options of `format` and `info`."""

from dataclasses import dataclass

from raytrace_jax.cli.commands.shared import Assignments, SceneFile
from raytrace_jax.scene.schema import ModelName


@dataclass(frozen=True)
class Format:
    """Write a scene file in canonical form, with the same numbers.

    Example: raytrace-jax format vitreous.txt -D vitreous.radius=2 > smaller.txt
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""
    model: ModelName = "classic"
    """Whose defaults hold for what the file leaves out."""


@dataclass(frozen=True)
class Info:
    """List the blocks of a scene and its parameters, by the names that -D and --free take.

    Example: raytrace-jax info vitreous.txt
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1."""
    model: ModelName = "classic"
    """Whose defaults hold for what the file leaves out."""
