"""The commands on scene files write, list and translate them."""

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from raytrace_jax.cli.console import print_table, stderr_console
from raytrace_jax.cli.options.scenes import Export, Format, Import, Info, New, Scenes
from raytrace_jax.cli.preparation import read_picture_scene, read_scene
from raytrace_jax.errors import RaytraceError
from raytrace_jax.exchange.export import export_scene
from raytrace_jax.exchange.mitsuba.load import import_scene
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
from raytrace_jax.scene.writer import format_scene, save_scene
from raytrace_jax.util.digits import format_number
from raytrace_jax.util.files import json_text, write_text
from raytrace_jax.util.session import jax_session


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
        heads = ("kind", "name", "what")
        model = command.model or scene_model(scene)
        rows = [(block.keyword, block.name, _what(scene, block, model)) for block in blocks(scene)]
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
    """The first comment of a scene's file, if it begins with one."""
    first = path.read_text(encoding="utf-8-sig").lstrip().split("\n", 1)[0]
    return first.lstrip("#/ ") if first.startswith(("#", "//")) else ""


def _numbers(value: object) -> str:
    """Numbers as -D takes them."""
    return ",".join(format_number(number) for number in np.atleast_1d(np.asarray(value)))


def _what(scene: Scene, block: Block, model: ModelName) -> str:
    """A block in a few words."""
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


def run_export(command: Export) -> int:
    """Write the file, say what is lost, and print the path."""
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, command.render)
        lost = export_scene(scene, command.output, command.to, settings)
    _tell(lost, "not in the file, or otherwise there", command.quiet)
    print(command.output)
    return 0


def run_import(command: Import) -> int:
    """Read the file, say what is lost, write the scene and print its path."""
    with jax_session(64):
        scene, lost = import_scene(command.file)
        save_scene(scene, command.output, model="physical")
    _tell(lost, "not in the scene, or otherwise there", command.quiet)
    print(command.output)
    return 0


def _tell(lost: Sequence[str], where: str, quiet: bool) -> None:
    """Say on stderr how much is lost, and what, a line each; `where` begins the sentence."""
    console = stderr_console(quiet=quiet)
    if lost:
        count = "1 thing" if len(lost) == 1 else f"{len(lost)} things"
        console.print(f"{where}, {count}:", *(f"  {words}" for words in lost), sep="\n", markup=False, highlight=False)
