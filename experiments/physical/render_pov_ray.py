"""Renders the scenes of `tests/pictured_scenes.py` by POV-Ray 3.7, one ray at each pixel's centre.

Needs the program `povray` (Debian package `povray`). From the repository's root:
python experiments/physical/render_pov_ray.py
"""

import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tests"))
import pictured_scenes  # noqa: E402
from physical_scenes import Plane, Sphere  # noqa: E402

TINY = 1e-3
"""POV-Ray's light falls off as 2 / (1 + (d / fade_distance)^2): an inverse square far beyond a tiny fade distance."""


def angle(values):
    return "<" + ",".join(repr(float(value)) for value in values) + ">"


def pov_text(scene):
    camera, (width, height) = scene.camera, scene.camera.pixeldim
    forward = unit(np.subtract(camera.lookat, camera.viewpoint))
    right = unit(np.cross(forward, camera.up))
    up = np.cross(right, forward)
    across = 2 * np.tan(np.radians(camera.fov) / 2)
    lines = [
        "#version 3.7; global_settings { assumed_gamma 1 max_trace_level 13 adc_bailout 1e-6 ambient_light 0 }",
        f"background {{ rgb {angle(scene.radiance)} }}",
        f"camera {{ perspective location {angle(camera.viewpoint)} direction {angle(forward)}"
        f" right {angle(right * across)} up {angle(up * across * height / width)} }}",
    ]
    for light in scene.lights:
        colour = np.divide(light.emissivity, np.pi * 2 * TINY**2)
        lines.append(
            f"light_source {{ {angle(light.location)} rgb {angle(colour)} fade_distance {TINY} fade_power 2 }}"
        )
    return "\n".join(lines + [shape_text(shape) for shape in scene.shapes])


def shape_text(shape):
    if isinstance(shape, Sphere):
        return f"sphere {{ {angle(shape.center)}, {shape.radius} {material_text(shape.material)} }}"
    if isinstance(shape, Plane):
        n = unit(np.array(shape.normal))
        right = unit(np.cross([0, 1, 0], n))
        origin, body = shape.point, "plane { z, 0"
    else:
        right, n = unit(np.array(shape.right)), unit(np.cross(shape.right, shape.up))
        a, b = np.linalg.norm(shape.right), np.linalg.norm(shape.up)
        corners = ",".join(angle(corner) for corner in ((-a, -b), (a, -b), (a, b), (-a, b), (-a, -b)))
        origin, body = shape.center, f"polygon {{ 5, {corners}"
    frame = ",".join(angle(row)[1:-1] for row in (right, np.cross(n, right), n, origin))
    return f"{body} {material_text(shape.material)} matrix <{frame}> }}"


def material_text(material):
    if material.transmission:
        finish = "finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy }"
        # With this power POV-Ray's light falls off as exp(-(1 - colour) * length / distance).
        colour = angle(1 - np.array(material.absorption, float))
        fade = f"fade_distance 1 fade_power 1001 fade_color rgb {colour}" if any(material.absorption) else ""
        return f"pigment {{ rgbt 1 }} {finish} interior {{ ior {material.ior} {fade} }}"
    matt = any(material.diffuse)
    colours = np.array(material.diffuse if matt else material.emission, float)
    texture = material.texture
    if texture is None:
        pigment = f"rgb {angle(colours)}"
    else:
        first, second = (f"rgb {angle(colours * colour)}" for colour in (texture.color1, texture.color2))
        shift = angle([*texture.offset, -texture.square / 2])
        pigment = f"checker {first} {second} scale {texture.square} translate {shift}"
    light = "diffuse 1 emission 0" if matt else "diffuse 0 emission 1"
    return f"pigment {{ {pigment} }} finish {{ ambient 0 {light} reflection {{ {material.reflectivity} }} }}"


def unit(v):
    return v / np.linalg.norm(v)


def render(scene):
    """(height, width, 3): what POV-Ray writes as 16 bits a number, linear, from 0 to 1."""
    width, height = scene.camera.pixeldim
    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder) / "scene.pov", Path(folder) / "scene.ppm"
        source.write_text(pov_text(scene))
        command = f"povray +I{source} +O{target} +W{width} +H{height} +FP16 File_Gamma=1.0 -A -D -GA"
        subprocess.run(command.split(), check=True, capture_output=True)
        data = target.read_bytes()[-6 * width * height :]
    return (np.frombuffer(data, ">u2").reshape(height, width, 3) / 65535).astype(np.float32)


def one_channel(scene, c, indices):
    """The scene with the indices that its glass has in one channel."""
    shapes = [
        replace(shape, material=replace(shape.material, ior=float(indices[k][c]), abbe=None)) if k in indices else shape
        for k, shape in enumerate(scene.shapes)
    ]
    return replace(scene, shapes=shapes)


def write(picture, path):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": np.ascontiguousarray(picture)}).write(str(path))


if __name__ == "__main__":
    folder = ROOT / "tests" / "physical_pictures"
    write(render(pictured_scenes.lights()), folder / "pov_lights.exr")
    scene = pictured_scenes.dispersion()
    # n = A + B / lambda^2 at 610, 550 and 465 nm through n_d = 1.7174 with V = 29.5, by hand.
    flint = [1.7174 + 0.7174 / 29.5 * (l**-2 - 587.56**-2) / (486.13**-2 - 656.27**-2) for l in (610, 550, 465)]  # noqa: E741
    indices = {1: flint, 2: scene.shapes[2].material.ior}
    pictures = [render(one_channel(scene, c, indices))[..., c] for c in range(3)]
    write(np.stack(pictures, axis=-1), folder / "pov_dispersion.exr")
