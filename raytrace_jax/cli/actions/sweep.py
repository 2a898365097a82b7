"""`sweep`: from a scene file and a range of values to an animation."""

import dataclasses

from PIL import Image

from raytrace_jax.cli.console import UsageError, stderr_console
from raytrace_jax.cli.options.pictures import Sweep
from raytrace_jax.cli.preparation import (
    check_picture_path,
    check_single,
    picture_window,
    read_picture_scene,
    warn_of_shared_materials,
)
from raytrace_jax.cli.progress import Timer
from raytrace_jax.images.animation import MOST_GIF_FPS, SUFFIXES, label_frames, require_ffmpeg, write_animation
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.panels import as_pixels
from raytrace_jax.scene.parameters import parse_assignment, scalar_names, set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.rendering import render
from raytrace_jax.util.ranges import evenly_spaced
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import parse_number

MOST_FRAMES = 10_000


def run_sweep(command: Sweep) -> int:
    """Render a frame for each value, write the animation, print its path."""
    asked = dataclasses.replace(command.render, edges=command.edges)
    name, values = parse_range(command.over)
    _check(command)
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, asked)
        _check_name(command, scene, name)
        warn_of_shared_materials(scene, [name])
        picture_window(scene, settings)
        scenes = [set_parameters(scene, {name: value}) for value in values]
        frames, transfer = [], command.transfer or screen_transfer(settings)
        with Timer("rendering", stderr_console(quiet=command.quiet)) as timer:
            for moved in scenes:
                frames.append(Image.fromarray(as_pixels(render(moved, settings).image, transfer)))
        timer.took(f"rendering {len(frames)} frames")
    if command.label:
        frames = label_frames(frames, name, [f"{value:.{decimals(values)}f}" for value in values])
    back = frames[-2:0:-1] if command.bounce else []
    write_animation(command.output, [*frames, *back], command.fps)
    print(command.output)
    return 0


def parse_range(text: str) -> tuple[str, list[float]]:
    """Split `vitreous.ior=1.0:2.4:60` into the name and its values, both ends included.

    Raises:
        UsageError: it is not written so, or the count is not a whole number from 2 to `MOST_FRAMES`.
    """
    name, equals, numbers = (piece.strip() for piece in text.rpartition("="))
    pieces = numbers.split(":")
    try:
        if not (name and equals and len(pieces) == 3 and pieces[2].strip().isdecimal()):
            raise ValueError
        start, stop = (parse_number(piece.strip()) for piece in pieces[:2])
    except ValueError:
        raise UsageError(f"--over {text}: write NAME=START:STOP:COUNT, as vitreous.ior=1.0:2.4:60.") from None
    count = int(pieces[2])
    if not 2 <= count <= MOST_FRAMES:
        raise UsageError(f"--over {text}: there are {count} frames; there can be 2 to {MOST_FRAMES}.")
    return name, evenly_spaced(start, stop, count)


def decimals(values: list[float]) -> int:
    """The fewest decimals that write each value of a range to a hundredth of their step."""
    near = abs(values[1] - values[0]) / 100
    return next((n for n in range(9) if all(abs(round(value, n) - value) <= near for value in values)), 9)


def _check(command: Sweep) -> None:
    """Refuse, before the work, what cannot be written."""
    path = command.output
    check_picture_path(path, SUFFIXES, "an animation")
    suffix = path.suffix.lower()
    most = MOST_GIF_FPS if suffix == ".gif" else 60
    if not 1 <= command.fps <= most:
        raise UsageError(f"--fps is {command.fps}; for a {suffix} file it can be 1 to {most}.")
    if suffix == ".mp4":
        require_ffmpeg(path)


def _check_name(command: Sweep, scene: Scene, name: str) -> None:
    """Refuse a vector, and a number that -D sets too."""
    check_single(scene, name, f"--over {command.over}")
    scalar_names(scene, [*(parse_assignment(text)[0] for text in command.assignments), name])
