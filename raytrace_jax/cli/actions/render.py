"""The command `render`: a picture file of a scene; it starts without what draws figures."""

import dataclasses

import jax.numpy as jnp
import numpy as np

from ...images.masks import bad_pixels, blackened, mask_in_words
from ...images.png import write_png
from ...report.films import how_made, screen_transfer, write_film
from ...tracer.rendering import render
from ...util.session import jax_session
from ..console import UsageError, print_warning, stderr_console
from ..options.scenes import Render
from ..preparation import check_picture_path, read_picture_scene
from ..progress import Timer


def run_render(command: Render) -> int:
    """Render the scene, write the picture, print the paths of the files written; 1 if a pixel is not finite."""
    check_picture_path(command.output)
    png_only = command.output.suffix.lower() == ".png"
    png_path = command.output if png_only else command.output.with_suffix(".png")
    if png_only and not command.png:
        raise UsageError(f"{command.output}: --no-png leaves nothing to write; name an .exr file.")
    if png_only and (command.render.aov or command.half):
        raise UsageError(f"{command.output}: a PNG file has no room for --aov or --half; name an .exr file.")
    if command.png:
        check_picture_path(png_path)

    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command, aov=tuple(dict.fromkeys(command.render.aov)))
        *origin, width, height = settings.window(scene.camera.pixeldim)
        work = f"rendering {width} x {height} pixels"
        with Timer(work, stderr_console(quiet=command.quiet)) as timer:
            film = render(scene, settings)
            image = np.asarray(film.image)
        timer.took(work)
        bad = bad_pixels(image, *map(np.asarray, film.aov.values()))
        if bad.any():
            print_warning(f"{mask_in_words(bad, origin)}. They are black in the files.")
            image = blackened(image)
            aov = {name: jnp.asarray(blackened(np.asarray(values))) for name, values in film.aov.items()}
            film = dataclasses.replace(film, image=jnp.asarray(image), aov=aov)
        if not png_only:
            write_film(command.output, film, scene, settings, half=command.half)
            print(command.output)
        if command.png:
            transfer = command.png_transfer or screen_transfer(settings)
            write_png(png_path, image, transfer=transfer, metadata=how_made(scene, settings))
            print(png_path)
    return 1 if bad.any() else 0
