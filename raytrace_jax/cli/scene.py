"""Reading the scene of a command: the file, then the -D assignments."""

from collections.abc import Sequence
from pathlib import Path

from raytrace_jax.cli.console import print_warning
from raytrace_jax.errors import ParameterError
from raytrace_jax.scene.modelfile import load_scene
from raytrace_jax.scene.parameters import parse_assignment, set_parameters, shared_with
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import ModelName
from raytrace_jax.util.text import listed


def read_scene(path: Path, assignments: Sequence[str], model: ModelName) -> Scene:
    """Load a scene and set the parameters of `name=value` texts, saying on stderr what else they change.

    What the file leaves out has the model's defaults.

    Raises:
        ModelFileError: the file cannot be read.
        ParameterError: an assignment is malformed, unknown or out of range, or a name comes twice.
    """
    scene = load_scene(path, model=model)
    values = {}
    for name, numbers in map(parse_assignment, assignments):
        if name in values:
            raise ParameterError(f"-D {name} is given twice.")
        values[name] = numbers
    warn_of_shared_materials(scene, tuple(values))
    return set_parameters(scene, values)


def warn_of_shared_materials(scene: Scene, names: Sequence[str]) -> None:
    """Say on stderr which other shapes change too when shapes' names reach a material that they share."""
    for name in names:
        others = shared_with(scene, name)
        if others:
            verb = "has" if len(others) == 1 else "have"
            print_warning(f"{name} belongs to a material, which {listed(others)} {verb} too and which changes for all.")
