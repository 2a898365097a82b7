"""The commands that write, list and translate scene files."""

import sys
from collections.abc import Sequence

from ...errors import RaytraceError
from ...exchange.export import export_scene
from ...exchange.mitsuba.load import import_scene
from ...scene import parameters
from ...scene.bundled import bundled_scenes, scene_path
from ...scene.parameters import Block, material_of
from ...scene.scene import Scene
from ...scene.writer import format_scene, plain_value, save_scene, value_text
from ...util.files import json_text, write_text
from ...util.session import jax_session
from ..console import UsageError, print_table, stderr_console
from ..options.scenes import Export, Format, Import, Info, New, Scenes
from ..preparation import check_file, read_picture_scene, read_scene

IN_LIQUID = """
material liquid {{
    ior {:g}
    transmission 1
}}

# All that lies behind its surface is in the liquid, the board too.
plane surface {{
    material liquid
    normal 0 0 1
    point 0 0 2  # ! on the surface
}}
"""
"""What a scene with a liquid has besides."""


def run_new(command: New) -> None:
    if command.output.exists():
        raise RaytraceError(f"{command.output}: it is there already, and a scene that was measured is not overwritten.")
    text = bundled_scenes()[command.scene].read_text(encoding="utf-8")
    if command.liquid is not None:
        if command.scene != "ball" or not command.liquid >= 1:
            raise UsageError(f"--in {command.liquid}: the index of a liquid, 1 or more, is for the scene of a ball.")
        text += IN_LIQUID.format(command.liquid)
    write_text(command.output, text)
    print(command.output)


def run_format(command: Format) -> None:
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        text = scene_path(command.scene).read_text(encoding="utf-8-sig")
        sys.stdout.write(format_scene(scene, model=command.model, comments=text))


def run_info(command: Info) -> None:
    with jax_session(64):
        scene = read_scene(command.scene, command.assignments, command.model)
        heads = ("kind", "name", "what")
        rows = [(block.keyword, block.name, _what(scene, block)) for block in parameters.blocks(scene)]
        users: dict[str, list[str]] = {used.name: [] for used in parameters.blocks_of(scene, "material")}
        for shape in parameters.shape_blocks(scene):
            users[material_of(scene, shape).name].append(shape.name)
        values = parameters.list_parameters(scene)
        if command.json:
            told = [dict(zip(heads, row, strict=True)) for row in rows]
            sys.stdout.write(json_text({"blocks": told, "parameters": values, "materials": users}))
            return
        print_table("blocks", heads, rows)
        print()
        # Numbers as -D takes them.
        texts = [(name, value_text(value).replace(" ", ",")) for name, value in values.items()]
        print_table("parameters", ("name", "value"), texts)
        print()
        print_table("materials", ("material", "shapes"), [(n, " ".join(shapes) or "-") for n, shapes in users.items()])


def run_scenes(command: Scenes) -> None:
    firsts = {name: path.read_text(encoding="utf-8-sig").split("\n", 1)[0] for name, path in bundled_scenes().items()}
    rows = [(name, firsts[name].lstrip("#/ "), str(path)) for name, path in bundled_scenes().items()]
    print_table("scenes", ("name", "what", "file"), rows)


def _what(scene: Scene, block: Block) -> str:
    """What a block says beside its parameters, as its file has it."""
    others = (one for one in block.type.attributes if one.value_type != "number")
    said = ((one.name, plain_value(scene, block, one)) for one in others)
    return ", ".join(f"{name} {value_text(value)}" for name, value in said if value is not None)


def run_export(command: Export) -> None:
    check_file(command.output)
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command)
        lost = export_scene(scene, command.output, command.to, settings)
    _wrote(command, lost, "not in the file, or otherwise there")


def run_import(command: Import) -> None:
    check_file(command.output)
    with jax_session(64):
        scene, lost = import_scene(command.file)
        save_scene(scene, command.output, model="physical")
    _wrote(command, lost, "not in the scene, or otherwise there")


def _wrote(command: Export | Import, lost: Sequence[str], where: str) -> None:
    """Say on stderr what is lost, a line each, in a sentence that begins with `where`; print the path."""
    if lost:
        count = "1 thing" if len(lost) == 1 else f"{len(lost)} things"
        stderr_console(quiet=command.quiet).print(f"{where}, {count}:", *(f"  {words}" for words in lost), sep="\n")
    print(command.output)
