"""`render`: from a scene file to picture files."""

import contextlib
import time
from collections.abc import Iterator

import numpy as np

from raytrace_jax.cli.commands.render import Render
from raytrace_jax.cli.console import stderr_console
from raytrace_jax.cli.errors import UsageError
from raytrace_jax.cli.output import check_picture_path
from raytrace_jax.cli.scene import read_scene
from raytrace_jax.images.png import write_png
from raytrace_jax.report.films import write_film
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.util.session import jax_session


def run_render(command: Render) -> int:
    """Render the scene, write the picture, print the paths of the files written."""
    aov = tuple(dict.fromkeys(name for names in command.aov for name in names))
    settings = command.render.settings(aov, command.edges, command.binning)
    png_only = command.output.suffix.lower() == ".png"
    png_path = command.output if png_only else command.output.with_suffix(".png")
    if png_only and not command.png:
        raise UsageError(f"{command.output}: --no-png leaves nothing to write; name an .exr file.")
    if png_only and (aov or command.half):
        raise UsageError(f"{command.output}: a PNG file has no room for --aov or --half; name an .exr file.")
    check_picture_path(command.output)
    if command.png:
        check_picture_path(png_path)

    with jax_session(command.render.precision):
        scene = read_scene(command.scene, command.assignments, command.render.model)
        _, _, width, height = picture_window(scene, settings)
        with _progress(f"rendering {width} x {height} pixels", command.quiet):
            film = render(scene, settings)
            image = np.asarray(film.image)
        if not png_only:
            write_film(command.output, film, scene, settings, half=command.half)
            print(command.output)
        if command.png:
            write_png(png_path, image, transfer=command.png_transfer)
            print(png_path)
    return 0


def picture_window(scene: Scene, settings: RenderSettings) -> tuple[int, int, int, int]:
    """The window that will be rendered, (x, y, width, height). Raises UsageError if --crop lies outside."""
    try:
        return settings.window(scene.camera.pixeldim)
    except ValueError as reason:
        raise UsageError(f"--{reason}.") from None


@contextlib.contextmanager
def _progress(what: str, quiet: bool) -> Iterator[None]:
    console = stderr_console()
    console.quiet = quiet
    start = time.perf_counter()
    if console.is_terminal:
        with console.status(f"{what} ..."):
            yield
    else:
        yield
    console.print(f"{what} took {time.perf_counter() - start:.1f} s")
