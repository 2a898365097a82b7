"""`view`: a page on this machine that shows a scene while its numbers move."""

import numpy as np

from raytrace_jax.cli.console import UsageError
from raytrace_jax.cli.options.explanations import View
from raytrace_jax.cli.preparation import check_single, picture_window, read_picture_scene, warn_of_shared_materials
from raytrace_jax.report.films import screen_transfer
from raytrace_jax.report.live.server import HOST, make_server
from raytrace_jax.report.live.studio import Slider, Studio
from raytrace_jax.scene.parameters import blocks_of, get_parameter, material_of, scalar_names
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.session import jax_session
from raytrace_jax.util.text import parse_number


def run_view(command: View) -> int:
    """Serve the page until it is interrupted; print its address."""
    asked = [parse_slider(text) for text in command.over]
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, command.render)
        sliders = tuple(checked(scene, slider) for slider in asked) or first_glass(scene, settings.model)
        scalar_names(scene, [slider.name for slider in sliders])  # Refuses one that comes twice.
        warn_of_shared_materials(scene, [slider.name for slider in sliders])
        picture_window(scene, settings)
        studio = Studio(scene, settings, sliders, screen_transfer(settings), command.edges)
        with make_server(studio, command.scene.stem, command.port) as server:
            print(f"http://{HOST}:{server.server_port}/", flush=True)
            server.serve_forever()
    return 0


def parse_slider(text: str) -> Slider:
    """Split `vitreous.ior=1:2.4`. Raises UsageError where it is not written so, or the range is empty."""
    name, equals, numbers = (piece.strip() for piece in text.rpartition("="))
    try:
        start, stop = (parse_number(piece.strip()) for piece in numbers.split(":"))
        if not (name and equals):
            raise ValueError
    except ValueError:
        raise UsageError(f"--over {text}: write NAME=START:STOP, as vitreous.ior=1:2.4.") from None
    if not start < stop:
        raise UsageError(f"--over {text}: the range has to go upwards.")
    return Slider(name, start, stop)


def checked(scene: Scene, slider: Slider) -> Slider:
    """A slider of one number, whose value in the scene is within. Raises ParameterError or UsageError."""
    option = f"--over {slider.name}={slider.start:g}:{slider.stop:g}"
    check_single(scene, slider.name, option)
    value = float(get_parameter(scene, slider.name))
    if not slider.start <= value <= slider.stop:
        raise UsageError(f"{option}: the scene has {value:g}, which lies outside.")
    return slider


def first_glass(scene: Scene, model: ModelName) -> tuple[Slider, ...]:
    """Sliders of index and centre of the first ball that lets light through; the centre moves by its radius.

    Raises:
        UsageError: there is none.
    """
    weight = "alpha" if model == "classic" else "transmission"
    for ball in blocks_of(scene, "sphere"):
        material = material_of(scene, ball)
        if float(material.read(scene, weight)) > 0 and np.ndim(material.read(scene, "ior")) == 0:
            radius, center = float(ball.read(scene, "radius")), np.asarray(ball.read(scene, "center"), float)
            ior = float(material.read(scene, "ior"))
            # From vacuum to diamond.
            index = Slider(f"{ball.name}.ior", min(1.0, ior), max(2.4, ior))
            places = zip("xyz", center, strict=True)
            moves = (Slider(f"{ball.name}.center.{axis}", x - radius, x + radius) for axis, x in places)
            return index, *(move.widened() for move in moves)
    raise UsageError("the scene has no glass ball to move; name the numbers that move with --over NAME=START:STOP.")
