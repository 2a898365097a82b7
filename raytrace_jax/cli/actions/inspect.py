"""`format` and `info`: what is in a scene file."""

import sys
from pathlib import Path

import numpy as np

from raytrace_jax.cli.console import print_table
from raytrace_jax.cli.options.explanations import Format, Info, New, Scenes
from raytrace_jax.cli.preparation import read_scene
from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.bundled import bundled_scenes, scene_path
from raytrace_jax.scene.parameters import (
    Block,
    blocks,
    blocks_of,
    list_parameters,
    material_of,
    scene_model,
    shape_blocks,
)
from raytrace_jax.scene.response import FILM, FILM_EFFECTS
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.writer import format_scene
from raytrace_jax.util.files import write_text
from raytrace_jax.util.json_text import json_text
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import format_number


def run_new(command: New) -> int:
    """Write the template of a scene and print its path."""
    if command.output.exists():
        raise RaytraceError(f"{command.output}: it is there already, and a scene that was measured is not overwritten.")
    write_text(command.output, bundled_scenes()[command.scene].read_text(encoding="utf-8"))
    print(command.output)
    return 0


def run_format(command: Format) -> int:
    """Print a scene's canonical text."""
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        text = scene_path(command.scene).read_text(encoding="utf-8-sig")
        sys.stdout.write(format_scene(scene, model=command.model, comments=text))
    return 0


def run_info(command: Info) -> int:
    """Print a scene's blocks, its parameters with their values, and which shapes have which material."""
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        heads, rows = ("kind", "name", "what"), _blocks(scene, command.model or scene_model(scene))
        if command.json:
            found = {
                "blocks": [dict(zip(heads, row, strict=True)) for row in rows],
                "parameters": list_parameters(scene),
            }
            sys.stdout.write(json_text(found | {"materials": {name: users.split() for name, users in _users(scene)}}))
            return 0
        parameters = [(name, _numbers(value)) for name, value in list_parameters(scene).items()]
        print_table("blocks", heads, rows)
        print()
        print_table("parameters", ("name", "value"), parameters)
        print()
        print_table("materials", ("material", "shapes"), [(name, users or "-") for name, users in _users(scene)])
    return 0


def run_scenes(command: Scenes) -> int:
    """Print the scenes that come with the package, each with the first comment of its file."""
    print_table("scenes", ("name", "what", "file"), [(n, _heading(p), str(p)) for n, p in bundled_scenes().items()])
    return 0


def _heading(path: Path) -> str:
    """What a scene's file says first, if that is a comment."""
    first = path.read_text(encoding="utf-8-sig").lstrip().split("\n", 1)[0]
    return first.lstrip("#/ ") if first.startswith(("#", "//")) else ""


def _numbers(value: object) -> str:
    """Numbers as -D takes them."""
    return ",".join(format_number(number) for number in np.atleast_1d(np.asarray(value)))


def _blocks(scene: Scene, model: ModelName) -> list[tuple[str, str, str]]:
    """Each block with its keyword, its name, and what it is."""
    return [(block.keyword, block.name, _what(scene, block, model)) for block in blocks(scene)]


def _what(scene: Scene, block: Block, model: ModelName) -> str:
    """What a block is, in a few words."""
    if block.type.is_shape:
        return f"of {material_of(scene, block).name}"
    if block.keyword == "camera":
        width, height = scene.camera.pixeldim
        return f"{width} x {height} pixels"
    if block.keyword == "light":
        return "point light"
    if block.keyword == "material":
        weight = block.read(scene, "alpha" if model == "classic" else "transmission")
        kind = "transparent" if weight > 0 else "opaque"
        texture = block.refers_to(scene, "texture")
        return f"{kind}, texture {texture.name}" if texture else kind
    if block.keyword == "texture":
        file = block.read(scene, "file") if block.type.find("file") else ""
        return f"image {file}" if file else next(a.choices[0] for a in block.type.attributes if not a.is_stored)
    if block.keyword == "background":
        texture = block.refers_to(scene, "texture")
        return f"texture {texture.name}" if texture else "one colour"
    if block.keyword == FILM:
        effects = [(e, block.read(scene, e.name)) for e in FILM_EFFECTS]
        said = [f"{e.name} {_numbers(value)}" for e, value in effects if np.any(np.asarray(value) != e.neutral)]
        return ", ".join(said) or "does nothing"
    said = [f"{a.name} {block.read(scene, a.name)}" for a in block.type.attributes]
    return ", ".join(words for words in said if not words.endswith(" None"))


def _users(scene: Scene) -> list[tuple[str, str]]:
    """Each material, and the names of the shapes that have it."""
    shapes = [(block.name, material_of(scene, block)) for block in shape_blocks(scene)]
    return [
        (material.name, " ".join(shape for shape, used in shapes if used == material))
        for material in blocks_of(scene, "material")
    ]
