"""`format` and `info`: what is in a scene file."""

import sys

import numpy as np

from raytrace_jax.cli.console import print_table
from raytrace_jax.cli.options.explanations import Format, Info
from raytrace_jax.cli.preparation import read_scene
from raytrace_jax.scene.blocks import shape_blocks
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.scene.parameters import list_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import format_number


def run_format(command: Format) -> int:
    """Print a scene's canonical text."""
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        sys.stdout.write(format_scene(scene, model=command.model))
    return 0


def run_info(command: Info) -> int:
    """Print a scene's blocks, its parameters with their values, and which shapes have which material."""
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        parameters = [(name, _numbers(value)) for name, value in list_parameters(scene).items()]
        print_table("blocks", ("kind", "name", "what"), _blocks(scene, command.model))
        print()
        print_table("parameters", ("name", "value"), parameters)
        print()
        print_table("materials", ("material", "shapes"), _users(scene))
    return 0


def _numbers(value: object) -> str:
    """Numbers as -D takes them."""
    return ",".join(format_number(number) for number in np.atleast_1d(np.asarray(value)))


def _blocks(scene: Scene, model: ModelName) -> list[tuple[str, str, str]]:
    width, height = scene.camera.pixeldim
    rows = [("camera", scene.camera.name, f"{width} x {height} pixels")]
    rows += [("light", name, "point light") for name in scene.lights.names]
    shines_through = scene.materials.alpha if model == "classic" else scene.materials.transmission
    for name, weight in zip(scene.materials.names, np.asarray(shines_through), strict=True):
        rows.append(("material", name, "transparent" if weight > 0 else "opaque"))
    for block in shape_blocks(scene):
        rows.append((block.keyword, block.name, f"of {scene.materials.names[block.refers_to(scene, 'material')]}"))
    return rows


def _users(scene: Scene) -> list[tuple[str, str]]:
    shapes = [(block.name, block.refers_to(scene, "material")) for block in shape_blocks(scene)]
    return [
        (material, " ".join(shape for shape, used in shapes if used == column) or "-")
        for column, material in enumerate(scene.materials.names)
    ]
