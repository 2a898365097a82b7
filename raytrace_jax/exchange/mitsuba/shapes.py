"""Mitsuba's spheres and rectangles with their materials, textures and media, and its skies."""

import math
from collections import defaultdict
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import numpy as np
from numpy.linalg import norm

from ...errors import SceneError
from ...images.pictures import read_whole_picture
from ...scene.table import OBLIQUE
from ..described import BLACK, Material, Shape, Texture, Triple, reach, unit
from ..media import SurfaceMedia
from .plugins import UPSIDE_DOWN, Color, Plugin, Point, Value

WHITE, GREY = (1.0, 1.0, 1.0), (0.5, 0.5, 0.5)

Lost = list[str]
"""What we have not, a few words each; a function adds to it what it comes upon."""

Halves = np.ndarray | None
"""The halves of a rectangle's sides; None for a sphere."""

INDICES = {
    "vacuum": 1.0, "helium": 1.000036, "hydrogen": 1.000132, "air": 1.000277, "carbon dioxide": 1.00045,
    "water": 1.3330, "acetone": 1.36, "ethanol": 1.361, "carbon tetrachloride": 1.461, "glycerol": 1.4729,
    "benzene": 1.501, "silicone oil": 1.52045, "bromine": 1.661, "water ice": 1.31, "fused quartz": 1.458,
    "pyrex": 1.470, "acrylic glass": 1.49, "polypropylene": 1.49, "bk7": 1.5046, "sodium chloride": 1.544,
    "amber": 1.55, "pet": 1.5750, "diamond": 2.419,
}  # fmt: skip
"""The indices of refraction that Mitsuba has names for (its source, `ior.h`)."""


def read_shape(plugin: Plugin, eye: Sequence[float] | None, lost: Lost) -> Shape | None:
    """A shape, yet without a name; None where it is of a form that we have not. `lost` gets what else we have not.

    `eye` is where the camera is; None where there is none.
    """
    numbers = _numbers(plugin, lost)
    if numbers is None:
        return None
    is_flat, is_flipped = plugin.kind == "rectangle", plugin.values.get("flip_normals") is True
    halves = np.array([norm(numbers[side]) for side in ("right", "up")]) if is_flat else None
    surface = read_bsdf(plugin, halves, lost)
    inner, outer = "interior", "exterior"
    # A mirrored sphere's normals point inwards as well (those of a rectangle follow from its sides).
    is_mirrored = np.linalg.det(plugin.transform()[:3, :3]) < 0
    if not is_flat and is_mirrored != is_flipped:
        if surface.inside and "emitter" not in plugin.values:
            surface = surface._replace(inside=surface.outside, outside=surface.inside)
            inner, outer = outer, inner
        else:
            lost.append("a mirror in to_world" if is_mirrored else "flip_normals")
    surface = read_medium(plugin.values.get(inner), surface, lost)
    surface = read_radiance(plugin, halves, surface, lost)
    around = read_medium(plugin.values.get(outer), Material("", ior=surface.outside), lost)
    if is_flat and surface.inside and is_flipped:
        numbers["right"] = -numbers["right"]
    if is_flat and surface.emission != BLACK and eye is not None:
        side = -1 if is_flipped else 1
        if side * np.cross(numbers["right"], numbers["up"]) @ np.subtract(eye, numbers["center"]) < 0:
            lost.append("it shines to the camera too, from its back")
    keyword = "box" if plugin.kind == "cube" else plugin.kind
    return Shape(keyword, "", numbers, surface, outside=around if np.any(around.absorption) else None)


def _numbers(plugin: Plugin, lost: Lost) -> dict[str, Any] | None:
    """The numbers of a shape; None where its transform makes it one that we have not."""
    matrix = plugin.transform()

    def is_round(gram: np.ndarray) -> bool:
        # Lengths that differ by a smaller share than 1e-9 are equal.
        return np.allclose(gram, gram[0, 0] * np.eye(len(gram)), rtol=0, atol=1e-9 * np.abs(gram).max())

    if plugin.kind == "sphere":
        gram, radius = matrix[:3, :3].T @ matrix[:3, :3], plugin.number("radius", 1.0)
        if not is_round(gram):
            lost.append("its to_world makes it an ellipsoid")
            return None
        return {"center": plugin.place("center"), "radius": radius * math.sqrt(gram[0, 0])}
    if plugin.kind == "cylinder":
        p0, p1 = (
            np.array(plugin.value(key, Point, Point((0.0, 0.0, z))).values) for key, z in (("p0", 0.0), ("p1", 1.0))
        )
        axis = matrix[:3, :3] @ (p1 - p0) / 2
        # The rows of Vt are along the tube and across it.
        across = matrix[:3, :3] @ np.linalg.svd((p1 - p0)[None])[2][1:].T
        gram = across.T @ across
        if not is_round(gram) or norm(axis @ across) > OBLIQUE * norm(axis) * norm(across):
            lost.append("its to_world makes it no upright cylinder")
            return None
        radius = plugin.number("radius", 1.0) * math.sqrt(gram[0, 0])
        return {"center": matrix[:3, :3] @ (p0 + p1) / 2 + matrix[:3, 3], "axis": axis, "radius": radius}
    right, up, depth = matrix[:3, :3].T
    pairs = [(right, up), (up, depth), (depth, right)][: 3 if plugin.kind == "cube" else 1]
    if any(abs(a @ b) > OBLIQUE * norm(a) * norm(b) for a, b in pairs):
        lost.append("its sides are not at right angles")
        return None
    sides = {"center": matrix[:3, 3], "right": right, "up": up}
    return sides | {"depth": float(norm(depth))} if plugin.kind == "cube" else sides


def is_end(disc: Plugin, tube: Plugin, shape: Shape, side: int) -> bool:
    """Whether a disc closes a tube at an end, and looks and is as the tube."""
    matrix, numbers = disc.transform(), shape.numbers
    middle, axis, radius = (numbers[name] for name in ("center", "axis", "radius"))
    place = np.column_stack([side * unit(axis), middle + side * axis])
    own = np.column_stack([unit(np.cross(matrix[:3, 0], matrix[:3, 1])), matrix[:3, 3]])
    sides = matrix[:3, :2]
    return (
        bool(np.allclose(own, place, rtol=0, atol=CLOSE * radius))
        and np.allclose(sides.T @ sides, radius**2 * np.eye(2), rtol=0, atol=CLOSE * radius**2)
        and bool(eqx.tree_equal(disc.values.get("bsdf"), tube.values.get("bsdf")))
    )


def endless_glass(shapes: Sequence[Shape], eye: Sequence[float], lost: Lost) -> list[Shape]:
    """The shapes with planes for rectangles of glass so large that no end of them is seen; others are left out."""
    found, far = [], 100 * reach(shapes, np.asarray(eye))
    for shape in shapes:
        if shape.keyword == "rectangle" and shape.material.is_glass:
            right, up = shape.numbers["right"], shape.numbers["up"]
            if not 0 < far <= min(norm(right), norm(up)):
                lost.append(f"shape {shape.name}: flat glass that ends, which has no inside here; it is left out")
                continue
            numbers = {"point": shape.numbers["center"], "normal": np.cross(unit(right), unit(up))}
            shape = shape._replace(keyword="plane", numbers=numbers)
        found.append(shape)
    return found


def other_side(plane: Shape, name: str) -> Shape:
    """What absorbs outside of a plane, as a plane that looks the other way."""
    assert plane.outside is not None
    inside, outside = plane.material.outside, plane.material.inside
    medium = plane.outside._replace(transmission=1.0, inside=inside, outside=outside, ior=inside / outside)
    return Shape("plane", name, plane.numbers | {"normal": -plane.numbers["normal"]}, medium)


def deepest_first(shapes: Sequence[Shape]) -> list[Shape]:
    """The shapes with parallel planes in the order in which all of them are seen, for the first in a file decides."""
    parallel = defaultdict[Triple | None, list[Shape]](list)

    def normal(shape: Shape) -> Triple | None:
        return tuple(np.round(shape.numbers["normal"], 6).tolist()) if shape.keyword == "plane" else None

    for shape in shapes:
        parallel[normal(shape)].append(shape)
    for planes in (planes for key, planes in parallel.items() if key is not None):
        planes.sort(key=lambda plane: np.dot(plane.numbers["normal"], plane.numbers["point"]))
    return [parallel[normal(shape)].pop(0) for shape in shapes]


def with_indices(shapes: Sequence[Shape], media: SurfaceMedia, lost: Lost) -> list[Shape]:
    """The shapes with indices against vacuum for inner and outer ones, found from outside of all glass inwards."""
    done: dict[int, Material] = {}

    def glass(place: int, within: frozenset[int] = frozenset()) -> Material:
        if place not in done:
            material, around = shapes[place].material, media.sides[place][0]
            # Surfaces that cut, and both sides of a plane, may each lie in the other: the file's index is from vacuum.
            if around in within:
                return material._replace(ior=material.inside)
            outer = None if around is None else glass(around, within | {place})
            ior = material.inside / material.outside * (1.0 if outer is None else outer.ior)
            if outer is not None and outer.inside == material.outside:
                ior = material.inside * (outer.ior / outer.inside)  # Exact where the file's indices are.
            done[place] = material._replace(ior=ior)
        return done[place]

    found = []
    for place, (shape, (outside, inside)) in enumerate(zip(shapes, media.sides, strict=True)):
        if shape.material.is_glass:
            # What is the same against vacuum is one material, whatever is around it.
            shape = shape._replace(material=glass(place)._replace(inside=0.0, outside=1.0))
            if inside != place:
                lost.append(f"shape {shape.name}: glass in glass of which here the smaller decides, not its surface")
        around = BLACK if outside is None else shapes[outside].material.absorption
        if shape.outside is not None and not np.allclose(shape.outside.absorption, around):
            lost.append(f"shape {shape.name}: exterior; what is around it here absorbs otherwise")
        found.append(shape)
    return found


def read_bsdf(shape: Plugin, halves: Halves, lost: Lost) -> Material:
    """Read what a surface does with light; what it has and we have not is added to `lost`."""
    # Wrappers are taken off, but for what they do: the material within is read, by the outermost name that there is.
    bsdf = shape.values.get("bsdf")
    if not isinstance(bsdf, Plugin):
        return Material("", diffuse=GREY)
    name = bsdf.name
    while bsdf.kind in ("twosided", "mask", "bumpmap", "normalmap"):
        if bsdf.kind != "twosided":
            lost.append(f"bsdf {bsdf.kind}; what it covers is taken")
        inner = [value for value in bsdf.values.values() if isinstance(value, Plugin) and value.tag == "bsdf"]
        if not inner:
            raise SceneError(f"bsdf {bsdf.kind} has no bsdf in it.")
        if len(inner) > 1:
            lost.append("the second bsdf, of its back; both sides have the first")
        bsdf = inner[0]
        name = name or bsdf.name

    # Glass and mirrors are smooth here; all else is matt.
    smooth = bsdf.kind.removeprefix("rough")
    if smooth != bsdf.kind and smooth in ("dielectric", "conductor"):
        lost.append(f"bsdf {bsdf.kind}; it is smooth")
    values = bsdf.values
    if smooth == "dielectric":
        tints = ("specular_reflectance", "specular_transmittance")
        lost += [key for key in tints if values.get(key) not in (None, 1, Color(WHITE))]
        inside, outside = _index(values.get("int_ior", "bk7")), _index(values.get("ext_ior", "air"))
        return Material(name, transmission=1.0, inside=inside, outside=outside, ior=inside / outside)
    if smooth == "conductor":
        if values.get("material", "none") != "none" or {"eta", "k"} & values.keys():
            lost.append("a metal; it is a mirror without colour of its own")
        color = values.get("specular_reflectance", Color(WHITE))
        numbers = color.values if isinstance(color, Color) else WHITE
        has_color = len(set(numbers)) > 1
        if has_color or not isinstance(color, Color):
            lost.append("specular_reflectance with a colour; a mirror has one reflectivity")
        return Material(name, reflectivity=float(np.mean(numbers)) if has_color else numbers[0])
    if smooth != "diffuse":
        lost.append(f"bsdf {bsdf.kind}; it is matt and grey")
        return Material(name, diffuse=GREY)
    color, texture = _colored(bsdf, "reflectance", 0.5, halves, lost)
    return Material(name, diffuse=color, texture=texture)


def read_radiance(shape: Plugin, halves: Halves, surface: Material, lost: Lost) -> Material:
    """The surface with the light of its own."""
    emitter = shape.values.get("emitter")
    if not isinstance(emitter, Plugin):
        return surface
    if emitter.kind != "area":
        lost.append(f"emitter of type {emitter.kind}")
        return surface
    color, texture = _colored(emitter, "radiance", 1.0, halves, lost)
    if surface.texture is not None and not surface.texture.is_like(texture):
        lost.append("its reflectance has another texture than its radiance, which is taken")
    elif surface.texture is None and texture is not None and surface.diffuse != BLACK:
        lost.append("its radiance has a texture and its reflectance none; both have it")
    return surface._replace(emission=color, texture=texture)


def read_medium(medium: Value | None, surface: Material, lost: Lost) -> Material:
    """The surface with what its inside absorbs."""
    if not isinstance(medium, Plugin):
        return surface
    if medium.kind != "homogeneous" or not isinstance(medium.values.get("sigma_t", 1.0), Color | int | float):
        lost.append(f"a medium of type {medium.kind}")
        return surface
    albedo, scale = medium.values.get("albedo", 0.75), medium.number("scale", 1.0)
    if albedo.values != BLACK if isinstance(albedo, Color) else albedo != 0:
        lost.append("a medium that scatters; it absorbs")
    return surface._replace(absorption=tuple(scale * x for x in medium.color("sigma_t", 1.0)))


def _colored(plugin: Plugin, key: str, default: float, halves: Halves, lost: Lost) -> tuple[Triple, Texture | None]:
    """A colour of a plugin and the texture that it scales."""
    value = plugin.values.get(key)
    if not isinstance(value, Plugin):
        return plugin.color(key, default), None
    texture = _texture(value, np.ones(2) if halves is None else halves, lost)
    if texture is None:
        return GREY, None
    if halves is None:
        lost.append("a texture on a sphere; it has the mean colour")
        return texture.mean, None
    return WHITE, texture


def _index(value: Value) -> float:
    """An index of refraction, as a number or by its name."""
    value = INDICES.get(value.lower(), value) if isinstance(value, str) else value
    if isinstance(value, bool) or not isinstance(value, int | float) or not value > 0:
        raise SceneError(f"the index {value!r} is no number above 0; there are names: {', '.join(INDICES)}.")
    return float(value)


CLOSE = 1e-5
"""Numbers of which one program has rounded the other's differ by at most this share."""


def _texture(plugin: Plugin, halves: np.ndarray, lost: Lost) -> Texture | None:
    """A texture on a rectangle whose sides are twice `halves`; None where it is of a kind that we have not."""
    to_uv = plugin.transform("to_uv")
    if plugin.kind == "checkerboard":
        return _checkerboard(plugin, to_uv, halves, lost)
    if plugin.kind != "bitmap":
        lost.append(f"a texture of type {plugin.kind}")
        return None
    texels = _picture(plugin)
    if not np.allclose(to_uv, UPSIDE_DOWN):
        texels = texels[:, ::-1]
        if not np.allclose(to_uv, np.eye(4)):
            lost.append("a bitmap with a to_uv; it lies on the whole rectangle")
    wrap = str(plugin.values.get("wrap_mode", "repeat"))
    if wrap == "mirror":
        lost.append("a bitmap that is mirrored beyond its border; its border goes on")
    smooth = str(plugin.values.get("filter_type", "bilinear"))
    return Texture(plugin.name, texels=texels, filter=smooth, wrap="repeat" if wrap == "repeat" else "clamp")


def _checkerboard(plugin: Plugin, to_uv: np.ndarray, halves: np.ndarray, lost: Lost) -> Texture | None:
    defaults = {"color0": 0.4, "color1": 0.2}
    if any(isinstance(plugin.values.get(key), Plugin) for key in defaults):
        lost.append("a checkerboard of textures")
        return None
    colors = [plugin.color(key, default) for key, default in defaults.items()]
    scales, shifts = np.diag(to_uv)[:2], to_uv[:2, 3]
    if np.any(to_uv[[0, 1], [1, 0]]) or not np.all(scales > 0):
        lost.append("a checkerboard that is turned")
        return None
    # A square is half a unit of Mitsuba's. Its transform has roundings beyond twelve digits, which nobody wrote.
    squares = halves / scales
    if abs(squares[0] / squares[1] - 1) > CLOSE:
        lost.append("a checkerboard whose fields are no squares; those of its width are taken")
    square, *offset = (float(f"{x:.12g}") for x in (squares[0], *(-2 * squares[0] * shifts - halves)))
    return Texture(plugin.name, colors=tuple(colors), square=square, offset=tuple(offset))


def read_sky(plugin: Plugin, lost: Lost) -> np.ndarray:
    """The picture all around, as `background` takes it.

    Mitsuba's first and last row lie at the poles; ours are in the middle of as many strips.
    """
    texels = _picture(plugin)
    turn = plugin.transform()
    if not np.allclose(turn[1, [0, 2]], 0) or not np.isclose(turn[1, 1], 1):
        lost.append("envmap: it is turned about another axis than y; it stands upright")
        turn = np.eye(4)
    # Ours is theirs after half a turn: what is left of the turn moves columns.
    angle = np.arctan2(turn[0, 2], turn[0, 0]) + np.pi
    columns = angle / (2 * np.pi) * texels.shape[2]
    whole = round(columns)
    if abs(columns - whole) > CLOSE:
        lost.append("envmap: its turn is no whole number of columns; the nearest is taken")
    texels = np.roll(texels, -whole % texels.shape[2], axis=2)
    between, means = texels[:, 1::2], (texels[:, :-1] + texels[:, 1:]) / 2
    if texels.shape[1] % 2 and texels.shape[1] > 1:
        inner = (between[:, :-1] + between[:, 1:]) / 2
        poles = np.stack([between[:, 0], between[:, -1]], axis=1)
        scale = CLOSE * max(float(np.abs(texels).max()), 1e-30)
        if np.allclose(texels[:, 2:-1:2], inner, 0, scale) and np.allclose(texels[:, [0, -1]], poles, 0, scale):
            return between
    lost.append("envmap: its rows lie at the poles; the means of each two are taken")
    return means if means.shape[1] else texels


def _picture(plugin: Plugin) -> np.ndarray:
    path = plugin.values.get("filename")
    if not isinstance(path, str):
        raise SceneError(f"{plugin.tag} {plugin.kind} has no filename.")
    return read_whole_picture(Path(path), transfer="course" if plugin.values.get("raw") is True else "srgb")
