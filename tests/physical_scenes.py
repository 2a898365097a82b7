"""Scenes of the physical model for its tests: plain descriptions, the same as a lab file, and random ones."""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np


@dataclass(frozen=True, eq=False)
class Checker:
    color1: tuple
    color2: tuple
    square: float
    offset: tuple = (0, 0)


@dataclass(frozen=True, eq=False)
class Image:
    texels: np.ndarray  # (height, width, 3), top row first
    file: str = "image.exr"
    filter: str = "bilinear"  # or nearest
    wrap: str = "clamp"  # or repeat, black


@dataclass(frozen=True, eq=False)
class Material:
    emission: tuple = (0, 0, 0)
    transmission: float = 0
    ior: float | tuple = 1.0  # three numbers are the channels' own
    abbe: float | None = None
    absorption: tuple = (0, 0, 0)
    reflectivity: float = 0
    diffuse: tuple = (0, 0, 0)
    texture: Checker | Image | None = None


@dataclass(frozen=True)
class Sphere:
    material: Material
    center: tuple
    radius: float


@dataclass(frozen=True)
class Plane:
    material: Material
    point: tuple
    normal: tuple


@dataclass(frozen=True)
class Rectangle:
    material: Material
    center: tuple
    right: tuple
    up: tuple


@dataclass(frozen=True)
class Light:
    location: tuple
    emissivity: tuple


@dataclass(frozen=True)
class Camera:
    pixeldim: tuple
    viewpoint: tuple
    lookat: tuple
    up: tuple
    fov: float  # of the whole width, in degrees
    center: tuple | None = None  # the principal point in pixels; the centre of the upper left pixel is (0, 0)
    distortion: tuple = (0, 0)


@dataclass(frozen=True)
class Scene:
    camera: Camera
    shapes: list
    lights: list = field(default_factory=list)
    radiance: tuple = (0, 0, 0)
    sky: Image | None = None
    max_bounces: int = 12
    least_weight: float = 0


def scene_text(scene):
    """The scene as a lab file; its images are files that `write_images` writes."""
    materials = list({id(shape.material): shape.material for shape in scene.shapes}.values())
    textures = [material.texture for material in materials] + [scene.sky]
    textures = list({id(texture): texture for texture in textures if texture is not None}.values())

    def name(thing, things, letter):
        return f"{letter}{[id(other) for other in things].index(id(thing))}"

    eye = scene.camera
    lens = f" distortion {numbers(eye.distortion)}" if any(eye.distortion) else ""
    if eye.center is not None:
        lens = f" center {numbers(eye.center)}{lens}"
    sky = f" texture {name(scene.sky, textures, 't')}" if scene.sky is not None else ""
    lines = [
        f"settings main {{ model physical mapping center max_bounces {scene.max_bounces}"
        f" least_weight {numbers(scene.least_weight)} }}",
        f"camera eye {{ pixeldim {eye.pixeldim[0]} {eye.pixeldim[1]} viewpoint {numbers(eye.viewpoint)}"
        f" lookat {numbers(eye.lookat)} up {numbers(eye.up)} fov {numbers(eye.fov)}{lens} }}",
        f"background sky {{ radiance {numbers(scene.radiance)}{sky} }}",
    ]
    for texture in textures:
        attributes = (
            f"kind image file {texture.file} filter {texture.filter} wrap {texture.wrap}"
            if isinstance(texture, Image)
            else f"kind checker color1 {numbers(texture.color1)} color2 {numbers(texture.color2)}"
            f" square {numbers(texture.square)} offset {numbers(texture.offset)}"
        )
        lines.append(f"texture {name(texture, textures, 't')} {{ {attributes} }}")
    for i, material in enumerate(materials):
        kinds = ("emission", "transmission", "ior", "abbe", "absorption", "reflectivity", "diffuse")
        given = [(kind, getattr(material, kind)) for kind in kinds if getattr(material, kind) is not None]
        attributes = " ".join(f"{kind} {numbers(value)}" for kind, value in given)
        if material.texture is not None:
            attributes += f" texture {name(material.texture, textures, 't')}"
        lines.append(f"material m{i} {{ {attributes} }}")
    for i, lamp in enumerate(scene.lights):
        lines.append(f"light l{i} {{ location {numbers(lamp.location)} emissivity {numbers(lamp.emissivity)} }}")
    for i, shape in enumerate(scene.shapes):
        values = {key: value for key, value in vars(shape).items() if key != "material"}
        attributes = " ".join(f"{key} {numbers(value)}" for key, value in values.items())
        kind = type(shape).__name__.lower()
        lines.append(f"{kind} s{i} {{ material {name(shape.material, materials, 'm')} {attributes} }}")
    return "\n".join(lines) + "\n"


def write_images(scene, folder):
    """Writes the files that `scene_text` names as float32 EXR."""
    import OpenEXR

    for texture in [shape.material.texture for shape in scene.shapes] + [scene.sky]:
        if isinstance(texture, Image):
            header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
            channels = {"RGB": np.ascontiguousarray(texture.texels, np.float32)}
            OpenEXR.File(header, channels).write(str(Path(folder) / texture.file))


def numbers(values):
    return " ".join(repr(float(value)) for value in np.atleast_1d(np.array(values, float)))


def random_scene(
    random, spheres=6, planes=2, rectangles=3, lights=2, size=(48, 36), images=False, disperse=False, **settings
):
    """A scene of glass within glass, mirrors and matt colours; what it holds depends on the numbers of things only.

    The first spheres are a big one, one within it and one that cuts it; the first plane is a floor that is seen as
    squares, further ones may be glass half spaces; the first rectangle is a lit board of squares (`images`: a picture).
    `disperse` gives spheres an index per channel and the rest an Abbe number.
    """
    viewpoint = np.array([0, 0, 6]) + random.uniform(-1, 1, 3)
    camera = Camera(
        size,
        tuple(viewpoint),
        tuple(random.uniform(-0.5, 0.5, 3)),
        tuple(random.normal([0, 1, 0], 0.2)),
        random.uniform(35, 60),
        tuple((np.array(size) - 1) / 2 + random.uniform(-3, 3, 2)),
        tuple(random.uniform(-0.1, 0.1, 2)),
    )
    checker = Checker(
        *(tuple(random.uniform(0, 1, 3)) for _ in range(2)), random.uniform(0.4, 1), tuple(random.uniform(-1, 1, 2))
    )
    board = random_image(random, "board.exr") if images else checker
    shapes = []
    for i in range(spheres):
        center, radius = random.uniform([-2, -1, -3], [2, 2, 1.5]), random.uniform(0.3, 0.9)
        if i == 0:
            radius = random.uniform(1, 1.4)
        if i in (1, 2):  # within the first, and across its surface
            reach = shapes[0].radius * (random.uniform(0, 0.5) if i == 1 else random.uniform(0.8, 1.2))
            radius = shapes[0].radius * random.uniform(0.2, 0.45)
            center = shapes[0].center + reach * direction(random)
        glass = 1 if i < 3 else None
        shapes.append(Sphere(random_material(random, "channels" if disperse else None, glass), tuple(center), radius))
    for i in range(planes):
        normal = direction(random) * [1, 0, 1] + [0, 0.3, 0] if i else np.array([0.02, 1, -0.03])
        point = random.uniform([-1, -3, -1], [1, -2, 1]) - (0 if i == 0 else random.uniform(4, 8)) * normal
        material = random_material(random, "abbe" if disperse else None, None if i else 0, checker if i == 0 else None)
        shapes.append(Plane(material, tuple(point), tuple(normal)))
    for i in range(rectangles):
        center = random.uniform([-2, -1, -5], [2, 2, -3]) if i == 0 else random.uniform([-3, -1, -3], [3, 2, 2])
        right, up = direction(random), direction(random)
        up = np.cross(right, up) * random.uniform(0.5, 2)
        if i == 0:
            right, up = np.array([3, 0, 0.3]), np.array([0, 2.5, 0])
        material = random_material(random, "abbe" if disperse else None, 0, None if i else board)
        shapes.append(Rectangle(material, tuple(center), tuple(right), tuple(up)))
    lamps = [
        Light(tuple(random.uniform([-4, 1, -2], [4, 5, 6])), tuple(random.uniform(0, 30, 3))) for _ in range(lights)
    ]
    sky = random_image(random, "sky.exr") if images else None
    shapes = shapes[::2] + shapes[1::2]
    settings = {"max_bounces": 6, "least_weight": 1e-4} | settings
    return Scene(camera, shapes, lamps, tuple(random.uniform(0, 1, 3)), sky, **settings)


def random_material(random, dispersion, transmission=None, texture=None):
    """Each kind of surface is as likely as its absence: matt, mirror, glass and what lies between."""
    if transmission is None:
        transmission = random.choice([0, random.uniform(0.3, 0.9), 1])
    ior = random.choice([1.0, random.uniform(1.2, 2), random.uniform(1.2, 2)])
    emission, diffuse = random.uniform(0, 1, (2, 3)) * random.integers(0, 2, (2, 1))
    return Material(
        emission=tuple(emission if texture is None else np.ones(3)),
        transmission=float(transmission),
        ior=tuple(ior + np.array([0, 0.02, 0.05])) if dispersion == "channels" else float(ior),
        abbe=random.uniform(20, 60) if dispersion == "abbe" else None,
        absorption=tuple(random.uniform(0, 0.8, 3) * random.integers(0, 2)),
        reflectivity=float(random.uniform(0, 1) * random.integers(0, 2)),
        diffuse=tuple(diffuse),
        texture=texture,
    )


def random_image(random, file):
    return Image(random.uniform(0, 1, (6, 8, 3)).astype(np.float32), file)


def direction(random):
    vector = random.normal(size=3)
    return vector / np.linalg.norm(vector)
