"""The tree of plugins that Mitsuba 3 has for a scene."""

import itertools
import math

import equinox as eqx
import numpy as np
from numpy.linalg import norm
from numpy.typing import ArrayLike

from ..described import Described, Material, Shape, Texture, Triple, overlap, reach, unit
from .plugins import UPSIDE_DOWN, Color, LookAt, Matrix, Plugin, Point, Ref, Value, numbered

KINDS = {"sphere": "sphere", "plane": "rectangle", "rectangle": "rectangle", "box": "cube", "cylinder": "cylinder"}
"""Mitsuba's shapes by the keywords of ours."""


class MitsubaWriter:
    """A scene on its way: pictures of textures by their files, what Mitsuba does otherwise, plugins by their ids.

    `stem` begins the names of the files of its textures.
    """

    def __init__(self, scene: Described, stem: str):
        self.scene, self.stem = scene, stem
        self.files: dict[str, np.ndarray] = {}
        self.ids: dict[str, Plugin] = {}
        self.lost = [*scene.lost, *_lost(scene)]

    def plugins(self) -> list[Plugin]:
        scene = self.scene
        absorbs = any(np.any(shape.material.absorption) for shape in scene.glass())
        depth: dict[str, Value] = {"max_depth": scene.settings.max_bounces + 1, "rr_depth": 1000}
        plugins = [Plugin("integrator", "volpath" if absorbs else "path", depth), self.sensor()]
        plugins += [self.background()] if scene.background else []
        for name, location, intensity in scene.lights:
            values = {"position": Point(_triple(location)), "intensity": _color(intensity)}
            plugins.append(Plugin("emitter", "point", values, name))
        for shape in scene.shapes:
            if not (shape.is_hidden or _parts_nothing(shape) or _is_formless(shape)):
                plugins += self.shape(shape)
        return [self.identified(plugin) for plugin in plugins]

    def identified(self, plugin: Plugin) -> Plugin:
        """A plugin whose id, and those of all within it, are the only ones; one that comes again is referred to.

        Ours are names of one kind of blocks, Mitsuba's of all: the id of what comes second has its tag behind it.
        """
        name = self.id_of(plugin)
        values = {key: self.within(value) for key, value in plugin.values.items()}
        return plugin._replace(name=name, values=values)

    def within(self, value: Value) -> Value:
        if not isinstance(value, Plugin):
            return value
        known = value.name and value.tag in ("bsdf", "texture") and self.ids.get(self.id_of(value)) is not value
        return Ref(self.id_of(value)) if known else self.identified(value)

    def id_of(self, plugin: Plugin) -> str:
        if not plugin.name:
            return ""
        for name in itertools.chain([plugin.name], numbered(f"{plugin.name}.{plugin.tag}", ".")):
            if eqx.tree_equal(self.ids.setdefault(name, plugin), plugin):
                return name
        raise AssertionError("numbers do not end")

    def sensor(self) -> Plugin:
        """The camera, with its film and how often it samples a pixel."""
        view, given = self.scene.view, self.scene.view.given
        width, height = view.size
        across, upwards = float(norm(view.across)), float(norm(view.upwards))
        right, up = view.across / across, view.upwards / upwards
        forward = np.cross(up, right)
        same = 1e-6  # Sides of pixels that differ by a smaller share are equal.
        if abs(across / width * height / upwards - 1) > same:
            self.lost.append(f"{view.name}: its pixels are no squares, as of a mapping from corner to corner")
        fov = float(given.fov) if given else math.degrees(2 * math.atan(across / 2 / float(view.middle @ forward)))
        target, upright = (given.lookat, given.up) if given else (view.eye + forward, up)
        to_world = LookAt(_triple(view.eye), _triple(target), _triple(upright))
        values: dict[str, Value] = {"fov_axis": "x", "fov": fov, "to_world": to_world}
        # How far the picture's middle is from the point that the camera looks at, in shares of the picture's sides.
        aside, above = float(view.middle @ right) / across, float(view.middle @ up) / upwards
        for name, share in (("principal_point_offset_x", aside), ("principal_point_offset_y", -above)):
            if abs(share) > same / max(width, height):
                values[name] = share
        film = {"width": width, "height": height, "pixel_format": "rgb", "component_format": "float32"}
        values["film"] = Plugin("film", "hdrfilm", film | {"rfilter": Plugin("rfilter", "box", {})})
        # A scene that says nothing of samples gets 256 a pixel.
        samples = self.scene.settings.samples**2 if self.scene.settings.samples > 1 else 256
        values["sampler"] = Plugin("sampler", "independent", {"sample_count": samples})
        values |= _media(medium=self.scene.eye_medium)
        return Plugin("sensor", "perspective", values, view.name)

    def background(self) -> Plugin:
        scene = self.scene
        if scene.sky is None or scene.sky.texels is None:
            return Plugin("emitter", "constant", {"radiance": _color(scene.radiance)}, scene.background)
        name = self.file(scene.sky.name, rows_at_both_poles(scene.sky.texels * scene.radiance[:, None, None]))
        half_a_turn = Matrix(np.diag([-1.0, 1.0, -1.0, 1.0]))
        return Plugin("emitter", "envmap", {"filename": name, "to_world": half_a_turn}, scene.background)

    def shape(self, shape: Shape) -> list[Plugin]:
        numbers, material, halves = shape.numbers, shape.material, np.ones(2)
        kind, values = KINDS[shape.keyword], dict[str, Value]()
        if kind == "sphere":
            values |= {"center": Point(_triple(numbers["center"])), "radius": numbers["radius"]}
        elif kind == "cylinder":
            first, last = (Point(_triple(numbers["center"] + s * numbers["axis"])) for s in (-1, 1))
            values |= {"p0": first, "p1": last, "radius": numbers["radius"]}
        else:
            matrix, halves = self.frame(shape)
            values["to_world"] = Matrix(matrix)
            # A rectangle emits on the side of its normal: it is turned to the camera. Of glass the normal points out.
            if kind != "cube" and not material.is_glass and (self.scene.view.eye - matrix[:3, 3]) @ matrix[:3, 2] < 0:
                values["flip_normals"] = True
        values["bsdf"] = self.bsdf(shape, halves)
        if np.any(material.emission) and not material.is_glass:
            values["emitter"] = Plugin("emitter", "area", {"radiance": self.colored(shape, "emission", halves)})
        # What is opaque parts no media: a path that it mirrors stays where it is.
        if material.is_glass:
            values |= _media(interior=shape.inside, exterior=shape.outside)
        surface = Plugin("shape", kind, values, shape.name)
        return [surface, *_ends(shape, values)] if kind == "cylinder" else [surface]

    def frame(self, shape: Shape) -> tuple[np.ndarray, np.ndarray]:
        """The transform that makes a rectangle of Mitsuba's, whose sides are two long; and the halves of its sides."""
        numbers = shape.numbers
        if shape.keyword == "plane":
            # A rectangle stands for the plane, half as wide as 1000 times the scene's largest distance.
            half = 1e3 * reach(self.scene.shapes, self.scene.view.eye)
            (right, up), center, side = (half * axis for axis in shape.axes()), numbers["point"], f"{2 * half:.3g}"
            self.lost.append(f"{shape.name}: a plane without end; a rectangle with sides of {side} stands for it")
        else:
            right, up, center = numbers["right"], numbers["up"], numbers["center"]
        matrix = np.eye(4)
        depth = numbers.get("depth", 1.0) * unit(np.cross(right, up))
        matrix[:3] = np.column_stack([right, up, depth, center])
        return matrix, np.array([norm(right), norm(up)])

    def bsdf(self, shape: Shape, halves: np.ndarray) -> Plugin:
        """What a surface does with light."""
        material = shape.material
        if material.is_glass:
            indices = {"int_ior": _index(shape.inside), "ext_ior": _index(shape.outside)}
            return Plugin("bsdf", "dielectric", indices, material.name)
        kind, values = "diffuse", {"reflectance": self.colored(shape, "diffuse", halves)}
        if material.reflectivity and not np.any(material.diffuse):
            kind, values = "conductor", {"material": "none", "specular_reflectance": _color(material.reflectivity)}
        if shape.keyword != "sphere":
            kind, values = "twosided", {"bsdf": Plugin("bsdf", kind, values)}
        return Plugin("bsdf", kind, values, material.name)

    def colored(self, shape: Shape, what: str, halves: np.ndarray) -> Value:
        """A colour of a material, `emission` or `diffuse`, times its texture."""
        scale, texture = getattr(shape.material, what), shape.material.texture
        if texture is None or not np.any(scale):
            return _color(scale)
        if texture.texels is None:
            return _checkerboard(texture, scale, halves)
        file = self.file(texture.name, texture.texels * scale[:, None, None])
        if texture.wrap == "black":
            self.lost.append(f"{texture.name}.wrap: black; the picture's border goes on")
        values: dict[str, Value] = {"filename": file, "raw": True, "filter_type": texture.filter}
        values |= {"wrap_mode": "repeat" if texture.wrap == "repeat" else "clamp", "to_uv": Matrix(UPSIDE_DOWN)}
        return Plugin("texture", "bitmap", values, texture.name)

    def file(self, name: str, texels: np.ndarray) -> str:
        """The file of a picture, another one for each."""
        names = (f"{self.stem}.{one}.exr" for one in numbered(name, "."))
        return next(one for one in names if np.array_equal(self.files.setdefault(one, texels), texels))


def _lost(scene: Described) -> list[str]:
    """What Mitsuba does otherwise."""
    glass, formless = scene.glass(), filter(_is_formless, scene.shapes)
    lost = [f"{shape.name}: {shape.keyword} has no form in Mitsuba; it is left out" for shape in formless]
    for material in scene.materials():
        if not material.is_glass and np.any(material.diffuse) and material.reflectivity:
            lost.append(f"{material.name}: a matt surface that is a mirror as well; its reflectivity is left out")
    # Where light ends in the medium that it began in, the squared indices of its path cancel.
    shining = [
        shape
        for shape in scene.shapes
        if np.any(shape.material.emission) or (scene.lights and np.any(shape.material.diffuse))
    ]
    begins = {_index(one) for shape in shining for one in shape.around}
    begins |= {_index(one) for one in scene.far_media if scene.background}
    if begins - {_index(scene.eye_medium)}:
        lost.append("light from within glass, or seen from within: Mitsuba scales radiance by the squared index")
    if any(overlap(a, b) for k, a in enumerate(glass) for b in glass[:k]):
        lost.append("overlapping glass: Mitsuba has no rule for media that overlap")
    if scene.lights and glass:
        lost.append("light through glass: in Mitsuba glass shadows point lights")
    return lost


def _is_formless(shape: Shape) -> bool:
    return shape.keyword not in KINDS or "cut" in shape.numbers


def _ends(shape: Shape, values: dict[str, Value]) -> list[Plugin]:
    """The two discs that close a cylinder, of the values of its tube."""
    center, axis, radius = (shape.numbers[name] for name in ("center", "axis", "radius"))
    across = unit(np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))]))
    discs = []
    for s, called in ((-1, "first end"), (1, "last end")):
        matrix, out = np.eye(4), s * unit(axis)
        matrix[:3] = np.column_stack([radius * across, radius * np.cross(out, across), out, center + s * axis])
        # Plugins of their own, as what is the same object counts as one that comes for the first time.
        shared = {
            key: value._replace() if isinstance(value, Plugin) else value
            for key, value in values.items()
            if key not in ("p0", "p1", "radius")
        }
        discs.append(Plugin("shape", "disk", {"to_world": Matrix(matrix), **shared}, f"{shape.name} {called}"))
    return discs


def rows_at_both_poles(texels: np.ndarray) -> np.ndarray:
    """Rows of a sky as Mitsuba takes them: 2 h + 1 in place of h, of which the first and the last lie at the poles.

    Ours are in the middle of h strips; each of them is one of the new rows, so that linear interpolation loses nothing.
    """
    height = texels.shape[1]
    place = np.clip(np.arange(2 * height + 1) / 2 - 0.5, 0, height - 1)
    first, second = np.floor(place).astype(int), np.ceil(place).astype(int)
    return (texels[:, first] + texels[:, second]) / 2


def _checkerboard(texture: Texture, scale: np.ndarray, halves: np.ndarray) -> Plugin:
    """Mitsuba's checker board: a square is half a unit wide, and the first colour is where both halves are alike."""
    to_uv = np.eye(4)
    to_uv[[0, 1], [0, 1]] = halves / texture.square
    to_uv[:2, 3] = -(halves + texture.offset) / (2 * texture.square)
    first, second = (_color(scale * color) for color in texture.colors)
    return Plugin("texture", "checkerboard", {"color0": first, "color1": second, "to_uv": Matrix(to_uv)}, texture.name)


def _parts_nothing(shape: Shape) -> bool:
    """Whether one medium is on both sides of a glass surface, another one than its own: nothing is seen of it."""
    return shape.material.is_glass and shape.inside is shape.outside and shape.inside is not shape.material


def _index(medium: Material | None) -> float:
    return 1.0 if medium is None else medium.ior


def _media(**media: Material | None) -> dict[str, Value]:
    """What absorbs, of some media by their roles."""
    return {
        role: Plugin("medium", "homogeneous", {"sigma_t": _color(medium.absorption), "albedo": 0.0})
        for role, medium in media.items()
        if medium is not None and np.any(medium.absorption)
    }


def _color(values: ArrayLike) -> Color:
    return Color(_triple(values))


def _triple(values: ArrayLike) -> Triple:
    return tuple(np.broadcast_to(values, (3,)).tolist())
