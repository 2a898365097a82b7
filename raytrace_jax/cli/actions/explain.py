"""The commands `rays`, `view` and `teach`, which show what happens to light."""

import math
import sys

import numpy as np

from ...report.films import screen_transfer
from ...report.lessons.pictures import LESSONS, WORK, index_page
from ...report.live import HOST, Slider, Studio, make_server, saved_page
from ...report.panels import save_figure
from ...report.rays import draw_tree, least_drawn
from ...scene.parameters import get_parameter, material_of, scalar_names, shape_blocks
from ...scene.scene import Scene
from ...scene.setting_words import ModelName
from ...tracer.ray_tree import RayNode, trace_tree
from ...util.files import json_text, write_text
from ...util.text import parse_number
from ..console import UsageError, blamed_on, print_table, stderr_console
from ..options import split_assignment
from ..options.scenes import Rays, Teach, View
from ..preparation import check_folder, check_picture_path, check_single, read_picture_scene, warn_of_shared_materials
from ..progress import Timer


def run_rays(command: Rays) -> None:
    check_picture_path(command.output, (".svg", ".png"))
    # A tree is that of one ray, whatever the scene's file says; more samples that were asked for are refused.
    samples = command.render.samples or 1
    scene, settings = read_picture_scene(command, edges="point", samples=samples)
    with blamed_on():
        tree = trace_tree(scene, command.pixel, settings)
    column, row = tree.pixel
    rays, color = _count(len(tree.nodes)), _color(tree.nodes[0])
    title = f"pixel {column} {row} of {command.scene.name}: {rays}, colour {color}"
    least = least_drawn(settings) if command.least_drawn is None else command.least_drawn
    figure = draw_tree(tree, scene, title, settings, least)

    # The file is written before anything is said on stdout.
    # Without a date in it the same rays make the same file.
    metadata = {"Date": None} if command.output.suffix.lower() == ".svg" else None
    save_figure(command.output, figure, bbox_inches="tight", metadata=metadata)
    if command.json:
        told = {"pixel": tree.pixel, "rays": [node._asdict() for node in tree.nodes], "dropped": tree.dropped}
        sys.stdout.write(json_text({"output": command.output, **told}))
    else:
        print(command.output)
        # Lengths are in world units, weights those of the largest channel.
        rows = [_cells(node) for node in tree.nodes]
        left_out = () if any(node.medium for node in tree.nodes) else ("medium", "absorbed")
        headers = tuple(name for name in rows[0] if name not in left_out)
        print_table("rays: angles in degrees", headers, [tuple(row[name] for name in headers) for row in rows])

    # What the drawing or the tree leaves out is said on stderr.
    console, drawn = stderr_console(command.quiet), sum(node.weight >= least for node in tree.nodes)
    if drawn < len(tree.nodes):
        console.print(f"{drawn} of {rays} are drawn, which count {least:g} or more; --least-drawn 0 draws all")
    if tree.dropped:
        limit = f"--max-bounces {settings.max_bounces}"
        console.print(f"{_count(tree.dropped)} beyond {limit}, not traced and taken as black")


def _cells(node: RayNode) -> dict[str, str]:
    """The line of a ray in the table: texts by their headers."""
    parent = "-" if node.parent is None else str(node.parent)
    cells = {"ray": str(node.number), "from": parent, "kind": node.kind, "hits": node.shape or "nothing"}
    cells |= dict.fromkeys(("distance", "path", "incident", "refracted", "reflect", "transmit"), "-")
    if node.shape is not None:
        refracted = "total" if node.total else "-" if node.theta_t is None else f"{math.degrees(node.theta_t):.2f}"
        cells |= {"distance": f"{node.distance:.4f}", "path": f"{node.path_length:.4f}"}
        cells |= {"incident": f"{math.degrees(node.theta_i):.2f}", "refracted": refracted}
    weights = {"reflect": node.reflect, "transmit": node.transmit, "absorbed": node.absorbed}
    cells |= {"medium": node.medium or "-"}
    cells |= {name: f"{weight:.4f}" if weight else "-" for name, weight in weights.items()}
    return cells | {"color": _color(node)}


def _color(node: RayNode) -> str:
    return " ".join(f"{value:.4f}" for value in node.color)


def _count(rays: int) -> str:
    return "1 ray" if rays == 1 else f"{rays} rays"


def run_view(command: View) -> None:
    if command.save:
        check_picture_path(command.save, (".html",), "a page")
    asked = [parse_slider(text) for text in command.over]
    scene, settings = read_picture_scene(command)
    for slider in asked:
        option = f"--over {slider.name}={slider.start:g}:{slider.stop:g}"
        check_single(scene, slider.name, option)
        value = float(get_parameter(scene, slider.name))
        if not slider.start <= value <= slider.stop:
            raise UsageError(f"{option}: the scene has {value:g}, which lies outside.")
    sliders = tuple(asked) or first_glass(scene, settings.model)[: 1 if command.save else None]
    if command.save and len(sliders) > 2:
        raise UsageError("--save takes one or two numbers: name no more by --over.")
    if command.steps and not command.save:
        raise UsageError("--steps is for --save: the sliders of a served page move freely.")
    scalar_names(scene, [slider.name for slider in sliders])  # Refuses one that comes twice.
    warn_of_shared_materials(scene, [slider.name for slider in sliders])
    studio = Studio(scene, settings, sliders, screen_transfer(settings), command.edges)
    if command.save:
        with Timer("rendering the page", stderr_console(command.quiet)) as timer:
            page = saved_page(studio, command.scene.stem, command.steps or (15 if len(sliders) == 1 else 7))
        timer.took("rendering the page")
        write_text(command.save, page)
        print(command.save)
        return
    with make_server(studio, command.scene.stem, command.port) as server:
        print(f"http://{HOST}:{server.server_port}/", flush=True)
        server.serve_forever()


def parse_slider(text: str) -> Slider:
    """Split `vitreous.ior=1:2.4`. Raises UsageError where it is not written so, or the range is empty."""

    def read(numbers: str) -> tuple[float, float]:
        start, stop = (parse_number(piece.strip()) for piece in numbers.split(":"))
        return start, stop

    name, (start, stop) = split_assignment("over", text, "NAME=START:STOP, as vitreous.ior=1:2.4", read)
    if not start < stop:
        raise UsageError(f"--over {text}: the range has to go upwards.")
    return Slider(name, start, stop)


def first_glass(scene: Scene, model: ModelName) -> tuple[Slider, ...]:
    """Sliders of index and place of the first body that lets light through; the place moves by the body's size.

    A prism has sliders of its angle, and of what turns it about its edge.
    """
    weight = "alpha" if model == "classic" else "transmission"
    for body in shape_blocks(scene):
        material = material_of(scene, body)
        places = [one for one in body.type.continuous if one.quantity.role == "position"]
        if places and float(material.read(scene, weight)) > 0 and np.ndim(material.read(scene, "ior")) == 0:
            (place,), ior = places, float(material.read(scene, "ior"))
            # From vacuum to diamond.
            index = Slider(f"{body.name}.ior", min(1.0, ior), max(2.4, ior))
            size = max(float(np.linalg.norm(body.read(scene, name))) for name in place.quantity.sized_by)
            values = np.asarray(body.read(scene, place.name), float)
            ways = [(f"{place.name}.{axis}", x - size, x + size) for axis, x in zip("xyz", values, strict=True)]
            if body.keyword == "prism":
                apex, down, edge = (np.asarray(body.read(scene, name), float) for name in ("apex", "down", "axis"))
                ways.append(("apex", min(20.0, float(apex)), max(90.0, float(apex))))
                length = np.linalg.norm(down)
                # One number of `down` alone keeps it at right angles to an edge that has no part that way.
                across = np.array(list("xyz"))[np.abs(edge) < 1e-6 * np.linalg.norm(edge)]
                ways += [(f"down.{axis}", -length, length) for axis in across]
            return index, *(Slider(f"{body.name}.{name}", low, high).widened() for name, low, high in ways)
    raise UsageError("the scene has no glass body to move; name the numbers that move with --over NAME=START:STOP.")


def run_teach(command: Teach) -> None:
    drawn = {name: draw for name, draw in LESSONS.items() if name in (command.only or LESSONS)}
    check_folder(command.output)
    console = stderr_console(command.quiet)
    for number, (name, draw) in enumerate(drawn.items(), start=1):
        paths = [command.output / f"{name}.{suffix}" for suffix in ("png", *command.also)]
        which = f"figure {number}/{len(drawn)}, {name}"
        with Timer(f"{which}: {WORK[name]}" if name in WORK else which, console) as timer:
            figure = draw()
            for path in paths:
                save_figure(path, figure)
            timer.took(f"{which},")
        # A display on stderr would catch what is printed on stdout.
        print(*paths, sep="\n", flush=True)
    page = command.output / "index.md"
    write_text(page, index_page(tuple(drawn)))
    print(page)
