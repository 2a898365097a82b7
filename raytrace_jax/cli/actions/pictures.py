"""The commands `grad`, `gallery` and `sweep`: sheets, galleries and animations of scenes."""

import sys
from typing import Any

import numpy as np
from PIL import Image

from ...images import animation, masks
from ...images.png import write_png
from ...report.derivatives import DerivativeCheck, check_derivative, draw_gradients
from ...report.differences import Differences, steady_differences
from ...report.films import how_made, screen_transfer, write_derivatives
from ...report.gallery import GALLERIES, Variant, draw_gallery, render_gallery
from ...report.panels import as_pixels, save_figure
from ...scene.bundled import bundled_scenes
from ...scene.parameters import parse_assignment, scalar_names, set_parameters
from ...scene.scene import Scene
from ...tracer.rendering import PictureDerivatives, picture_derivatives, render
from ...util.digits import evenly_spaced
from ...util.files import json_text
from ...util.text import parse_number
from ..console import UsageError, print_table, print_warning, stderr_console
from ..options import RenderOptions, split_assignment
from ..options.scenes import Gallery, Grad, Sweep
from ..preparation import (
    check_file,
    check_folder,
    check_picture_path,
    check_single,
    read_picture_scene,
    read_scene,
    warn_of_shared_materials,
)
from ..progress import Timer

SECONDS = 4.0
"""How long an animation is where nobody says how fast it is: as long as one looks at it."""


def run_grad(command: Grad) -> int:
    """Differentiate the picture, write its layers and their sheet, print the paths and, if asked, the check.

    1 if a pixel of the picture or of a derivative is not finite.
    """
    wrt, png_path, console = command.wrt, command.output.with_suffix(".png"), stderr_console(command.quiet)
    if not wrt:
        raise UsageError("--wrt NAME ... is missing: with respect to which parameters?")
    check_picture_path(command.output, (".exr",), "an OpenEXR file")
    check_file(png_path)
    scene, settings = read_picture_scene(command, edges=command.edges)
    origin = settings.window(scene.camera.pixeldim)[:2]
    scalar_names(scene, wrt)  # Refuses unknown names before the differences.
    warn_of_shared_materials(scene, wrt)
    differences = None
    if command.check:
        # First of all, because it refuses steps that a parameter cannot take.
        with Timer("finite differences", console) as timer:
            differences = steady_differences(scene, wrt, settings, command.check_step, command.check_samples)
            timer.took("finite differences")
    with Timer("derivatives", console) as timer:
        found = picture_derivatives(scene, wrt, settings)
        timer.took("derivatives")
    image, values = np.asarray(found.image), np.asarray(found.values)
    bad = masks.bad_pixels(image, values)
    if bad.any():
        print_warning(f"{masks.mask_in_words(bad, origin)}, in the picture or a derivative. They are 0 in the files.")
        found = found._replace(image=masks.blackened(image), values=masks.blackened(values))
    write_derivatives(command.output, found, scene, settings, differences)

    # The sheet shows what the layers hold; the words say how far differences agree with them.
    checks, numbers = [], []
    look: dict[str, Any] = {"origin": origin, "transfer": screen_transfer(settings)}
    if differences is not None:
        both = zip(np.asarray(found.values), differences.values, differences.spreads, strict=True)
        checks = [check_derivative(derivative, difference, spread, origin) for derivative, difference, spread in both]
        words = [f"{check.verdict}, step {step:.3g}" for check, step in zip(checks, differences.steps, strict=True)]
        look |= {"differences": differences.values, "verdicts": words}
        look["caption"] = f"finite differences of\n{differences.samples} × {differences.samples} point samples a pixel"
        numbers = check_numbers(found, differences, checks)
    save_figure(png_path, draw_gradients(found, **look))
    if command.json:
        told: dict[str, object] = {"output": command.output, "png": png_path, "parameters": found.names}
        if numbers:
            told["checks"] = [{"words": check.words, **row} for check, row in zip(checks, numbers, strict=True)]
        sys.stdout.write(json_text(told))
    else:
        print(command.output, png_path, sep="\n")
        if numbers:
            rows = [(name, *(f"{n:.4g}" for n in row.values())) for name, row in zip(found.names, numbers, strict=True)]
            print_table("derivatives against finite differences", ("parameter", *numbers[0]), rows)
            print(*(f"{name}: {check.words}" for name, check in zip(found.names, checks, strict=True)), sep="\n")
    return 1 if bad.any() else 0


def check_numbers(
    found: PictureDerivatives, differences: Differences, checks: list[DerivativeCheck]
) -> list[dict[str, float]]:
    """Numbers that compare each derivative with its finite difference; sums are over all pixels."""
    sums = (np.asarray(values).sum(axis=(1, 2, 3), dtype=np.float64) for values in (found.values, differences.values))
    return [
        {"relative L2 error": check.error, "correlation": check.correlation, "difference by two steps": check.spread}
        | {"sum of derivative": float(derivative), "sum of difference": float(difference), "step": float(step)}
        for check, derivative, difference, step in zip(checks, *sums, differences.steps, strict=True)
    ]


def run_gallery(command: Gallery) -> None:
    gallery, wrt = GALLERIES[command.set], command.wrt
    for name in ("model", "reflectance", "total_internal_reflection", "second_root", "reflection"):
        if getattr(command.render, name) != getattr(RenderOptions(), name):
            option = name.replace("_", "-")
            raise UsageError(f"--{option} is what the pictures of a gallery differ in; `render` takes it for one.")
    if command.scene and not gallery.scene:
        raise UsageError(f"the pictures of --set {command.set} have scenes of their own: leave {command.scene} out.")
    first = gallery.variants[0].text or command.scene or bundled_scenes()[gallery.scene]
    check_folder(command.output)

    # Each picture is written as soon as it is rendered; the sheet needs them all.
    titles, pictures, written = [], [], []
    scene, settings = read_picture_scene(command, first, model=gallery.model)
    said = scene.settings and scene.settings.model
    if said not in (None, gallery.model):
        raise UsageError(
            f"{first} is for the {said} model, and the gallery {command.set} shows what the {gallery.model} model "
            "does: `render` makes a picture of it."
        )
    scalar_names(scene, wrt)
    warn_of_shared_materials(scene, wrt)
    transfer = command.png_transfer or screen_transfer(settings)

    def scene_of(variant: Variant) -> Scene:
        return read_scene(variant.text, command.assignments, gallery.model) if variant.text else scene

    with Timer("rendering", stderr_console(command.quiet)) as timer:
        for variant, varied, how, found in render_gallery(scene_of, gallery, settings, wrt):
            exr_path, png_path = (command.output / f"{variant.name}.{suffix}" for suffix in ("exr", "png"))
            write_derivatives(exr_path, found, varied, how)
            write_png(png_path, found.image, transfer=transfer, metadata=how_made(varied, how))
            written += [exr_path, png_path]
            titles.append(variant.title)
            pictures.append(found)
            timer.took(f"picture {len(pictures)}/{len(gallery.variants)}, {variant.name.replace('_', ' ')},")
    sheet = command.output / "gallery.png"
    save_figure(sheet, draw_gallery(titles, pictures, gallery.columns, transfer))
    print(*written, sheet, sep="\n")


def run_sweep(command: Sweep) -> None:
    name, values = parse_range(command.over)
    path, suffix = command.output, command.output.suffix.lower()
    check_picture_path(path, animation.SUFFIXES, "an animation")
    most = animation.MOST_GIF_FPS if suffix == ".gif" else 60
    if command.fps is not None and not 1 <= command.fps <= most:
        raise UsageError(f"--fps is {command.fps}; for a {suffix} file it can be 1 to {most}.")
    if suffix == ".mp4":
        animation.require_ffmpeg(path)
    scene, settings = read_picture_scene(command, edges=command.edges)
    check_single(scene, name, f"--over {command.over}")
    scalar_names(scene, [*(parse_assignment(text)[0] for text in command.assignments), name])  # -D sets none of it.
    warn_of_shared_materials(scene, [name])
    scenes = [set_parameters(scene, {name: value}) for value in values]
    transfer = command.transfer or screen_transfer(settings)
    with Timer("rendering", stderr_console(command.quiet)) as timer:
        frames = [Image.fromarray(as_pixels(render(moved, settings).image, transfer)) for moved in scenes]
    timer.took(f"rendering {len(frames)} frames")
    if command.label:
        frames = animation.label_frames(frames, name, [f"{value:.{decimals(values)}f}" for value in values])
    shown = frames + frames[-2:0:-1] if command.bounce else frames
    animation.write_animation(command.output, shown, command.fps or min(20, max(1, round(len(shown) / SECONDS))))
    print(command.output)


def parse_range(text: str) -> tuple[str, list[float]]:
    """Split `vitreous.ior=1.0:2.4:60` into the name and its values, both ends included, or raise UsageError."""

    def read(numbers: str) -> tuple[float, float, int]:
        start, stop, count = (piece.strip() for piece in numbers.split(":"))
        if not count.isdecimal():
            raise ValueError
        return parse_number(start), parse_number(stop), int(count)

    form = "NAME=START:STOP:COUNT, as vitreous.ior=1.0:2.4:60"
    name, (start, stop, count) = split_assignment("over", text, form, read)
    if not 2 <= count <= 10_000:
        raise UsageError(f"--over {text}: there are {count} frames; there can be 2 to 10000.")
    return name, evenly_spaced(start, stop, count)


def decimals(values: list[float]) -> int:
    """The fewest decimals that write each value of a range to a hundredth of their step."""
    near = abs(values[1] - values[0]) / 100
    return next((n for n in range(9) if all(abs(round(value, n) - value) <= near for value in values)), 9)
