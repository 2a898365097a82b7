"""A scene in the language of POV-Ray 3.7."""

import itertools
from collections.abc import Collection, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.linalg import norm

from ..tracer.geometry.shapes import Shapes
from .described import Described, Shape, Texture, touch, unit

Files = dict[str, np.ndarray]


def pov_text(scene: Described, name: str) -> tuple[str, Files, list[str]]:
    """The text of a scene for POV-Ray, the pictures of its textures by file, and what is lost, a few words each.

    The names of the textures' files begin like that of its own file, `name`; pictures are "3 height width".
    """
    files: Files = {}
    stem, settings, (width, height) = Path(name).stem, scene.settings, scene.view.size
    # POV-Ray's light falls off as 2 / (1 + (d / fade)^2): an inverse square far beyond a tiny fade distance.
    fade, shapes = 1e-3, _with_holes(scene)
    body = [
        "#version 3.7;",
        f"global_settings {{ assumed_gamma 1 ambient_light 0 max_trace_level {settings.max_bounces + 1} "
        f"adc_bailout {settings.least_weight!r} }}",
        _background(scene, stem, files),
        f"camera {{ perspective location {pov_vector(scene.view.eye)} direction {pov_vector(scene.view.middle)} "
        f"right {pov_vector(scene.view.across)} up {pov_vector(scene.view.upwards)} }}",
        *(
            f"light_source {{ {pov_vector(location)} rgb {pov_vector(intensity / (2 * np.pi * fade**2))} "
            f"fade_distance {fade} fade_power 2 }}"
            for _, location, intensity in scene.lights
        ),
        *(_shape(shape, holes, stem, files) for shape, *holes in shapes.values()),
    ]
    lost = [*scene.lost, *_lost(scene, shapes)]
    lost += [
        f"{file}: POV-Ray reads it as 16-bit floats"
        for file, texels in files.items()
        if not np.array_equal(texels, texels.astype(np.float16))
    ]
    head = [
        "// Written by raytrace_jax. One ray at each pixel's centre, linear, 16 bits:",
        f"// povray +I{name} +O{stem}.png +W{width} +H{height} +FN16 File_Gamma=1.0 -A -D",
        "// N x N samples a pixel: +W and +H so many times as large, and the mean of each N x N pixels.",
        *(f"// Not as it was: {words}." for words in lost),
    ]
    return "\n".join([*head, *body]) + "\n", files, lost


def _with_holes(scene: Described) -> dict[str, list[Shape]]:
    """The shapes by name, each with the solids of vacuum that are in it and in no other one: they are cut out of it.

    Of a solid within another one POV-Ray lacks the partial reflection where rays leave it (`ComputeRelativeIOR`).
    """
    found = {shape.name: [shape] for shape in scene.shapes}
    solids = [shape for shape in scene.glass() if shape.keyword != "plane"]
    for hole in solids:
        assert hole.surface is not None
        around = [one for one in solids if one is not hole and one.surface and np.all(one.surface.holds(hole.surface))]
        if len(around) == 1 and _is_vacuum(hole) and not _is_vacuum(around[0]):
            found[around[0].name].append(found.pop(hole.name)[0])
    return found


def _is_vacuum(shape: Shape) -> bool:
    return shape.material.ior == 1 and not np.any(shape.material.absorption)


def _lost(scene: Described, shapes: Collection[str]) -> list[str]:
    """What POV-Ray does otherwise."""
    lost, glass = [], [shape for shape in scene.glass() if shape.name in shapes]
    solids = [shape for shape in glass if shape.keyword != "plane"]
    for material in scene.materials():
        if material.is_glass and np.any(material.absorption):
            lost.append(f"{material.name}.absorption: POV-Ray attenuates the first stretch of a path in glass only")
        elif not material.is_glass and np.any(material.diffuse) and np.any(material.emission):
            lost.append(f"{material.name}: a matt surface that shines as well; its emission is left out")
        # The border is half a texel wide.
        texture = material.texture
        if texture and texture.texels is not None and (texture.filter, texture.wrap) == ("bilinear", "clamp"):
            lost.append(f"{material.name}: POV-Ray mixes the border of its picture with the other side's")
    pairs = itertools.combinations(solids, 2)
    if len(glass) > 1 and (len(solids) < len(glass) or any(itertools.starmap(touch, pairs))):
        lost.append("glass within glass: POV-Ray takes other media for some of the rays")
    return lost


def _background(scene: Described, stem: str, files: Files) -> str:
    if scene.sky is None:
        return f"background {{ rgb {pov_vector(scene.radiance)} }}"
    assert scene.sky.texels is not None
    name = f"{stem}.{scene.sky.name}.exr"
    files[name] = scene.sky.texels * scene.radiance[:, None, None]
    # POV-Ray's map begins at +x, ours at +z; found by its pictures of skies whose texels are their own coordinates.
    return f'sky_sphere {{ pigment {{ image_map {{ exr "{name}" map_type 1 interpolate 2 }} rotate -90 * y }} }}'


def _shape(shape: Shape, holes: Sequence[Shape], stem: str, files: Files) -> str:
    numbers = shape.numbers
    if shape.keyword not in ("plane", "rectangle"):
        body = _joined("difference", map(_solid, (shape, *holes)))
        return f"// {shape.name}\n{body} {_material(shape, stem, files, np.ones(2))} }}"
    if shape.keyword == "plane":
        right, up = shape.axes()
        n = np.cross(right, up)
        halves, origin, body = np.ones(2), numbers["point"], "plane { z, 0"
    else:
        normal = np.cross(numbers["right"], numbers["up"])
        a, b = (float(norm(numbers[side])) for side in ("right", "up"))
        halves, right, n = np.array([a, b]), numbers["right"] / a, unit(normal)
        corners = ", ".join(pov_vector(corner) for corner in ((-a, -b), (a, -b), (a, b), (-a, b), (-a, -b)))
        origin, body = numbers["center"], f"polygon {{ 5, {corners}"
    frame = ", ".join(pov_vector(row)[1:-1] for row in (right, np.cross(n, right), n, origin))
    return f"// {shape.name}\n{body} {_material(shape, stem, files, halves)} matrix <{frame}> }}"


def _solid(shape: Shape) -> str:
    """What is inside of a shape, without the closing brace."""
    assert shape.surface is not None
    faces = shape.surface.faces
    # A cylinder ends beyond the faces that cut it.
    reach = 2 * max(float(norm(face.position - faces[0].position)) for face in faces)
    return _joined("intersection", (_face(face, reach) for face in faces))


def _joined(kind: str, parts: Iterable[str]) -> str:
    first, *more = parts
    return " ".join([f"{kind} {{", *(f"{part} }}" for part in (first, *more))]) if more else first


def _face(face: Shapes, reach: float) -> str:
    """What is inside of a face, without the closing brace."""
    if not face.curvature:
        return f"plane {{ {pov_vector(face.normal)}, {float(face.normal @ face.position)!r}"
    if face.axis is not None and np.any(face.axis):
        ends = ", ".join(pov_vector(face.position + s * reach * face.axis) for s in (-1, 1))
        return f"cylinder {{ {ends}, {float(face.radius)!r}"
    center, radius = face.position - face.normal / face.curvature, face.radius or 1 / face.curvature
    return f"sphere {{ {pov_vector(center)}, {float(radius)!r}"


def _material(shape: Shape, stem: str, files: Files, halves: np.ndarray) -> str:
    material = shape.material
    if material.is_glass:
        finish = "finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy }"
        # With this power POV-Ray's light falls off as exp(-(1 - colour) * length / distance).
        colour = pov_vector(1 - np.asarray(material.absorption))
        fade = f" fade_distance 1 fade_power 1001 fade_color rgb {colour}" if np.any(material.absorption) else ""
        return f"pigment {{ rgbt 1 }} {finish} interior {{ ior {material.ior!r}{fade} }}"
    is_matt = bool(np.any(material.diffuse))
    colours = np.asarray(material.diffuse if is_matt else material.emission)
    pigment = f"rgb {pov_vector(colours)}"
    if material.texture is not None:
        pigment = _texture(material.texture, colours, f"{stem}.{material.name}.exr", files, halves)
    light = "diffuse 1 emission 0" if is_matt else "diffuse 0 emission 1"
    return f"pigment {{ {pigment} }} finish {{ ambient 0 {light} reflection {{ {material.reflectivity!r} }} }}"


def _texture(texture: Texture, colours: np.ndarray, name: str, files: Files, halves: np.ndarray) -> str:
    if texture.texels is None:
        first, second = (f"rgb {pov_vector(colours * colour)}" for colour in texture.colors)
        shift = pov_vector([*texture.offset, -texture.square / 2])
        return f"checker {first}, {second} scale {texture.square!r} translate {shift}"
    files[name] = texture.texels * colours[:, None, None]
    smooth = "interpolate 2" if texture.filter == "bilinear" else ""
    # POV-Ray's map lies on [0, 1] x [0, 1].
    place = f"translate <-0.5, -0.5, 0> scale {pov_vector([*(2 * halves), 1.0])}"
    return f'image_map {{ exr "{name}" {smooth} }} {place}'


def pov_vector(values: object) -> str:
    return "<" + ", ".join(repr(float(value)) for value in np.asarray(values, np.float64)) + ">"
