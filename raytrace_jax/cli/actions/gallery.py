"""`gallery`: from a scene to the pictures of the source documents, and a sheet of them."""

import dataclasses

from raytrace_jax.cli.console import UsageError, stderr_console
from raytrace_jax.cli.options.pictures import Gallery
from raytrace_jax.cli.preparation import (
    check_folder,
    picture_window,
    read_picture_scene,
    read_scene,
    warn_of_shared_materials,
)
from raytrace_jax.cli.progress import Timer
from raytrace_jax.images.png import write_png
from raytrace_jax.report.films import how_made, screen_transfer, write_derivatives
from raytrace_jax.report.gallery import GALLERIES, Variant, draw_gallery, render_gallery
from raytrace_jax.scene.bundled import bundled_scenes
from raytrace_jax.scene.parameters import scalar_names
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.session import jax_session


def run_gallery(command: Gallery) -> int:
    """Render and write every picture of the set and their sheet; print the paths."""
    # Which scenes are shown, and that the options do not contradict the set.
    gallery = GALLERIES[command.set]
    _check_switches(command)
    options = dataclasses.replace(command.render, model=gallery.model)
    wrt = command.wrt
    if command.scene and not gallery.scene:
        raise UsageError(f"the pictures of --set {command.set} have scenes of their own: leave {command.scene} out.")
    first = gallery.variants[0].text or command.scene or bundled_scenes()[gallery.scene]
    check_folder(command.output)

    # Each picture is written as soon as it is rendered; the sheet needs them all.
    titles, pictures, written = [], [], []
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(first, command.assignments, options)
        said = scene.settings and scene.settings.model
        if said not in (None, gallery.model):
            raise UsageError(
                f"{first} is for the {said} model, and the gallery {command.set} shows what the {gallery.model} model "
                "does: `render` makes a picture of it."
            )
        transfer = command.png_transfer or screen_transfer(settings)

        def scene_of(variant: Variant) -> Scene:
            return read_scene(variant.text, command.assignments, gallery.model) if variant.text else scene

        picture_window(scene, settings)
        scalar_names(scene, wrt)
        warn_of_shared_materials(scene, wrt)
        with Timer("rendering", stderr_console(quiet=command.quiet)) as timer:
            for variant, varied, how, found in render_gallery(scene_of, gallery, settings, wrt):
                exr_path, png_path = (command.output / f"{variant.name}.{suffix}" for suffix in ("exr", "png"))
                write_derivatives(exr_path, found, varied, how)
                write_png(png_path, found.image, transfer=transfer, metadata=how_made(varied, how))
                written += [exr_path, png_path]
                titles.append(variant.title)
                pictures.append(found)
                timer.took(f"picture {len(pictures)}/{len(gallery.variants)}, {variant.name.replace('_', ' ')},")
    sheet = command.output / "gallery.png"
    with atomic_write(sheet) as temporary:
        draw_gallery(titles, pictures, gallery.columns, transfer).savefig(temporary)
    print(*written, sheet, sep="\n")
    return 0


def _check_switches(command: Gallery) -> None:
    """Refuse options that the pictures themselves switch. Raises UsageError."""
    chosen, usual = command.render, type(command.render)()
    for name in ("model", "reflectance", "total_internal_reflection", "second_root", "reflection"):
        if getattr(chosen, name) != getattr(usual, name):
            option = name.replace("_", "-")
            raise UsageError(f"--{option} is what the pictures of a gallery differ in; `render` takes it for one.")
