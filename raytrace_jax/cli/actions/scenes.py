"""The commands that render scenes, and write, list and translate their files; they start without what draws figures."""

import dataclasses
import sys
from collections.abc import Sequence
from pathlib import Path

import jax.numpy as jnp
import numpy as np

from ...errors import RaytraceError
from ...exchange.export import export_scene
from ...exchange.mitsuba.load import import_scene
from ...images.masks import bad_pixels, blackened, mask_in_words
from ...images.png import write_png
from ...report.films import how_made, screen_transfer, view_paths, write_film
from ...scene import parameters
from ...scene.bundled import bundled_scenes, scene_path
from ...scene.parameters import Block, material_of
from ...scene.scene import Scene
from ...scene.writer import format_scene, plain_value, save_scene, value_text
from ...tracer.rendering import render
from ...tracer.settings import ResolvedSettings
from ...util.files import json_text, write_text
from ...util.text import listed
from ..console import UsageError, print_table, print_warning, stderr_console
from ..options.scenes import Export, Format, Import, Info, New, Render, Scenes
from ..preparation import check_file, check_picture_path, read_picture_scene, read_scene
from ..progress import Timer

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


def run_render(command: Render) -> int:
    """Render the scene by its cameras, print the paths of the files written; 1 if a pixel is not finite."""
    _check_paths(command, command.output)
    png_only = _is_png(command.output)
    if png_only and not command.png:
        raise UsageError(f"{command.output}: --no-png leaves nothing to write; name an .exr file.")
    if png_only and (command.render.aov or command.half):
        raise UsageError(f"{command.output}: a PNG file has no room for --aov or --half; name an .exr file.")
    aov = tuple(dict.fromkeys(command.render.aov))
    scene, settings = read_picture_scene(command, all_cameras=command.camera is None, aov=aov)
    if command.camera is not None or not scene.further_views:
        outputs = {scene.camera.name: command.output}
    else:
        outputs = view_paths(command.output, scene)
        told = f"a picture of each, {listed(path.name for path in outputs.values())}; --camera NAME renders one"
        stderr_console(command.quiet).print(f"cameras {listed(outputs)}: {told}")
        for path in outputs.values():
            _check_paths(command, path)
    return max([_render_view(command, scene.seen_by(name), settings, path) for name, path in outputs.items()])


def _is_png(path: Path) -> bool:
    return path.suffix.lower() == ".png"


def _check_paths(command: Render, path: Path) -> None:
    check_picture_path(path)
    if command.png and not _is_png(path):
        check_picture_path(path.with_suffix(".png"))


def _render_view(command: Render, scene: Scene, settings: ResolvedSettings, output: Path) -> int:
    """Render what one camera of a scene shows into a file, as `run_render`."""
    png_path = output if _is_png(output) else output.with_suffix(".png")
    *origin, width, height = settings.window(scene.camera.pixeldim)
    work = f"rendering {width} x {height} pixels"
    with Timer(work, stderr_console(command.quiet)) as timer:
        film = render(scene, settings)
        image = np.asarray(film.image)
    timer.took(work)
    bad = bad_pixels(image, *map(np.asarray, film.aov.values()))
    if bad.any():
        print_warning(f"{mask_in_words(bad, origin)}. They are black in the files.")
        image = blackened(image)
        aov = {name: jnp.asarray(blackened(np.asarray(values))) for name, values in film.aov.items()}
        film = dataclasses.replace(film, image=jnp.asarray(image), aov=aov)
    if not _is_png(output):
        write_film(output, film, scene, settings, half=command.half)
        print(output)
    if command.png:
        transfer = command.png_transfer or screen_transfer(settings)
        write_png(png_path, image, transfer=transfer, metadata=how_made(scene, settings))
        print(png_path)
    return 1 if bad.any() else 0


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
    scene = read_scene(command.scene, command.assignments, command.model)
    text = scene_path(command.scene).read_text(encoding="utf-8-sig")
    sys.stdout.write(format_scene(scene, model=command.model, comments=text))


def run_info(command: Info) -> None:
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
    rows = [
        (name, path.read_text(encoding="utf-8-sig").split("\n", 1)[0].lstrip("#/ "), str(path))
        for name, path in bundled_scenes().items()
    ]
    print_table("scenes", ("name", "what", "file"), rows)


def _what(scene: Scene, block: Block) -> str:
    """What a block says beside its parameters, as its file has it."""
    words = [attribute for attribute in block.type.attributes if attribute.value_type != "number"]
    values = {attribute.name: plain_value(scene, block, attribute) for attribute in words}
    return ", ".join(f"{name} {value_text(value)}" for name, value in values.items() if value is not None)


def run_export(command: Export) -> None:
    check_file(command.output)
    scene, settings = read_picture_scene(command)
    _wrote(command, export_scene(scene, command.output, command.to, settings), "not in the file, or otherwise there")


def run_import(command: Import) -> None:
    check_file(command.output)
    scene, lost = import_scene(command.file)
    save_scene(scene, command.output, model="physical")
    _wrote(command, lost, "not in the scene, or otherwise there")


def _wrote(command: Export | Import, lost: Sequence[str], where: str) -> None:
    """Say on stderr what is lost, a line each, in a sentence that begins with `where`; print the path."""
    if lost:
        count = "1 thing" if len(lost) == 1 else f"{len(lost)} things"
        stderr_console(command.quiet).print(f"{where}, {count}:", *(f"  {words}" for words in lost), sep="\n")
    print(command.output)
