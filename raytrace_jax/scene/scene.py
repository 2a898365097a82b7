"""The scene of a `model.txt` file as a pytree: struct of arrays, components first, one column an entry.

Units are the file's own (one world unit); the y axis points up. Names, the pixel grid and the material of a shape are
static; every continuous value is a JAX array, so that any of them can be differentiated. `table` says which block of a
file becomes which of these structs. A struct's `names` are those of its blocks, `name` that of the only one.
"""

import hashlib
import os
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from raytrace_jax.errors import SceneError
from raytrace_jax.images import Transfer
from raytrace_jax.scene import setting_words as words
from raytrace_jax.util.text import quoted


class ImagePlaneCamera(eqx.Module):
    """The course's pinhole camera, which looks at the rectangle [0, width] x [0, height] of the plane z = 0.

    Args:
        pixeldim: (width, height) of the picture in pixels.
        worlddim: (width, height) of the image plane in world units.
        viewpoint: where the rays start, (x, y, z) in world units.
        center: where the rectangle's middle is seen, as `PerspectiveCamera.center` counts pixels.
    """

    name: str = eqx.field(static=True)
    pixeldim: tuple[int, int] = eqx.field(static=True)
    worlddim: Float[Array, "2"]
    viewpoint: Float[Array, "3"]
    center: Float[Array, "2"]


class PerspectiveCamera(eqx.Module):
    """A camera with square pixels that looks from a point at a point, through a lens that may distort.

    Args:
        pixeldim: (width, height) of the picture in pixels.
        viewpoint: where the rays start, (x, y, z) in world units.
        lookat: the point that the picture shows at `center`, in world units.
        up: a direction of any length that is upright in the picture.
        fov: the full horizontal angle of view, in degrees, between 0 and 180, of a picture with `center` in its middle
            and without distortion: the focal length is width / (2 tan(fov / 2)) pixels.
        center: the principal point (x, y) in pixels; (0, 0) is the centre of the upper left one.
        distortion: the radial distortion (k1, k2), as in `scene.lens`.
    """

    name: str = eqx.field(static=True)
    pixeldim: tuple[int, int] = eqx.field(static=True)
    viewpoint: Float[Array, "3"]
    lookat: Float[Array, "3"]
    up: Float[Array, "3"]
    fov: Float[Array, ""]
    center: Float[Array, "2"]
    distortion: Float[Array, "2"]


Camera = ImagePlaneCamera | PerspectiveCamera


class CameraResponse(eqx.Module):
    """The camera's response to the light that falls on it; the fields are in the order in which they take effect.

    Without an effect its field is None, as in a compiled program that leaves out what does nothing.

    Args:
        vignetting: the fraction of the light that is lost in the picture's corners; it grows with the squared distance
            from the picture's middle.
        blur: standard deviation of a Gaussian point-spread function, in pixels.
        gain: of each channel, a factor.
        offset: what is added to each channel, in units of white.
        gamma: the power of light as it is stored.
    """

    name: str = eqx.field(static=True)
    vignetting: Float[Array, ""] | None
    blur: Float[Array, ""] | None
    gain: Float[Array, "3"] | None
    offset: Float[Array, "3"] | None
    gamma: Float[Array, ""] | None


class FileSettings(eqx.Module):
    """The settings of a picture that a file has; None where it does not say. `RenderSettings` tells what it means."""

    name: str = eqx.field(static=True)
    model: words.ModelName | None = eqx.field(static=True)
    mapping: words.PixelConvention | None = eqx.field(static=True)
    max_bounces: int | None = eqx.field(static=True)
    edges: words.EdgeMode | None = eqx.field(static=True)
    samples: int | None = eqx.field(static=True)
    path_limit: float | None = eqx.field(static=True)
    least_weight: float | None = eqx.field(static=True)
    reflectance: words.Reflectance | None = eqx.field(static=True)
    eta: words.EtaConvention | None = eqx.field(static=True)


class Background(eqx.Module):
    """A light from all around and infinitely far away, which rays see that hit nothing.

    Args:
        radiance: its colour (RGB, scene-linear).
        texture: the column of a picture that it is multiplied with, as `parameters.blocks_of` counts, or `NO_BLOCK`.
    """

    name: str = eqx.field(static=True)
    radiance: Float[Array, "3"]
    texture: int = eqx.field(static=True)


class PointLights(eqx.Module):
    """Point lights of a colour `emissivity`.

    In the classic model their light falls off with one over the distance, in the others with the distance squared; in
    the additive one `energy` scales it.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    location: Float[Array, "3 lights"]
    emissivity: Float[Array, "3 lights"]
    energy: Float[Array, " lights"]


class Checkers(eqx.Module):
    """Checker boards: `color1` where `floor(x) + floor(y)` is even, with x and y = (place - `offset`) / `square`.

    A place on a surface is measured in world units.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    color1: Float[Array, "3 checkers"]
    color2: Float[Array, "3 checkers"]
    square: Float[Array, " checkers"]
    offset: Float[Array, "2 checkers"]


class Images(eqx.Module):
    """Pictures on surfaces, scene-linear; row 0 is the top one.

    Args:
        file: where each was read from, as the scene's file has it; empty for one that came as numbers.
        transfer: what the file was told of the numbers of a PNG, or None.
        filter: `bilinear` or `nearest`.
        wrap: what is beyond the border: `clamp`, `repeat` or `black`.
        texels: the pictures.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    file: tuple[str, ...] = eqx.field(static=True)
    transfer: tuple[Transfer | None, ...] = eqx.field(static=True)
    filter: tuple[words.TextureFilter, ...] = eqx.field(static=True)
    wrap: tuple[words.TextureWrap, ...] = eqx.field(static=True)
    texels: tuple[Float[Array, "3 _ _"], ...]


class Materials(eqx.Module):
    """Surface colours (RGB, scene-linear) and index of refraction `ior` > 0, which all models have; and more.

    Only the classic model has the transparency `alpha` in [0, 1]. Only the additive one has the exponent `hardness` of
    highlights and the switch `fresnel`: at 1 Schlick's approximation takes the place of `reflectivity`, between 0 and 1
    both are mixed. It and the physical one have the weights `reflectivity` of the mirror ray and `transmission` of the
    refracted one, both in [0, 1]. Only the physical one has the radiance `emission`, the `absorption` inside of what it
    fills, per world unit, and the column of a `texture`, or `NO_BLOCK`.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    ambient: Float[Array, "3 materials"]
    diffuse: Float[Array, "3 materials"]
    specular: Float[Array, "3 materials"]
    alpha: Float[Array, " materials"]
    ior: Float[Array, " materials"]
    hardness: Float[Array, " materials"]
    reflectivity: Float[Array, " materials"]
    fresnel: Float[Array, " materials"]
    transmission: Float[Array, " materials"]
    emission: Float[Array, "3 materials"]
    absorption: Float[Array, "3 materials"]
    texture: tuple[int, ...] = eqx.field(static=True)


class AbbeMaterials(Materials):
    """Materials with dispersion: `ior` is that at 587.56 nm, `abbe` > 0 Abbe's number V."""

    abbe: Float[Array, " materials"]


class ChannelMaterials(Materials):
    """Materials with an index of refraction for each channel."""

    ior: Float[Array, "3 materials"]


class Planes(eqx.Module):
    """Two-sided planes through `point`; `normal` is kept as the file gives it and need not have length one.

    `material` holds, for each plane, the column of its material, as `parameters.blocks_of` counts them.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    normal: Float[Array, "3 planes"]
    point: Float[Array, "3 planes"]


class Spheres(eqx.Module):
    """Spheres with outward normals. `material` holds the columns of their materials."""

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    center: Float[Array, "3 spheres"]
    radius: Float[Array, " spheres"]


class Rectangles(eqx.Module):
    """Two-sided rectangles `center + u right + v up` with u and v from -1 to 1.

    `right` and `up` are the vectors from the center to the middles of two sides; they are orthogonal. `material` holds
    the columns of their materials.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    center: Float[Array, "3 rectangles"]
    right: Float[Array, "3 rectangles"]
    up: Float[Array, "3 rectangles"]


class Scene(eqx.Module):
    """All blocks of a `model.txt` file.

    `shape_order` lists the names of all shapes in the order of the file: the course's tracer gives a tie between two
    shapes to the first of them, and the writer keeps this order. A shape's index, as in the film's `shape_index`, is
    its place in this list.

    `model` is the model with which the scene was loaded; its defaults fill in what the blocks leave out.
    """

    model: words.ModelName = eqx.field(static=True)
    settings: FileSettings | None
    camera: Camera
    film: CameraResponse | None
    background: Background | None
    lights: PointLights
    checkers: Checkers
    images: Images
    materials: Materials
    abbe_materials: AbbeMaterials
    channel_materials: ChannelMaterials
    planes: Planes
    spheres: Spheres
    rectangles: Rectangles
    shape_order: tuple[str, ...] = eqx.field(static=True)

    def __repr__(self) -> str:
        """The scene in a line: its model, its camera's pixels, how many blocks of each type it has."""
        groups = {
            "sphere": "spheres",
            "plane": "planes",
            "rectangle": "rectangles",
            "material": "materials abbe_materials channel_materials",
            "texture": "checkers images",
            "light": "lights",
        }
        # JAX builds scenes that hold anything, without blocks: to compare, and to tell where trees differ.
        counts = {
            word: sum(len(getattr(getattr(self, group), "names", ())) for group in names.split())
            for word, names in groups.items()
        }
        width, height = getattr(self.camera, "pixeldim", ("?", "?"))
        blocks = [f"{count} {word}{'s' if count > 1 else ''}" for word, count in counts.items() if count]
        return f"Scene({', '.join([self.model, f'camera {width} x {height}', *blocks])})"

    def __getitem__(self, name: str) -> Array:
        """The value of a parameter, as `scene["glass.ior"]`; see `get_parameter`."""
        from raytrace_jax.scene.parameters import get_parameter

        return get_parameter(self, name)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the scene as a `model.txt` file, and beside it the pictures of its textures; see `save_scene`.

        Raises:
            ModelFileError: the scene holds what no file can say.
            RaytraceError: the file cannot be written.
        """
        from raytrace_jax.scene.writer import save_scene

        save_scene(self, path, model=self.model)

    def to_dict(self) -> dict[str, Any]:
        """The scene as strings, numbers and lists; see `scene.writer.scene_to_dict`."""
        from raytrace_jax.scene.writer import scene_to_dict

        return scene_to_dict(self)

    @staticmethod
    def from_dict(
        values: Mapping[str, Any], *, folder: str | os.PathLike[str] = ".", dtype: DTypeLike | None = None
    ) -> "Scene":
        """The scene of `to_dict`'s values; see `scene.build.scene_from_dict`."""
        from raytrace_jax.scene.build import scene_from_dict

        return scene_from_dict(values, folder=folder, dtype=dtype)


def check_scene(given: object) -> None:
    """Refuse a path or a text where a `Scene` is expected. Raises SceneError that says how a scene is made of it."""
    if isinstance(given, Scene):
        return
    if isinstance(given, str) and "{" in given:
        raise SceneError("a scene is wanted, and this is the text of one: read it with parse_scene.")
    if isinstance(given, str | os.PathLike):
        name = quoted(os.fspath(given))
        raise SceneError(f"a scene is wanted, and this is the text {name}: load it with load_scene({name}).")
    raise SceneError(
        f"a scene is wanted, as load_scene and make_scene return it, and this is of the type {type(given).__name__}."
    )


def map_scenes(function: Callable, *scenes: Scene) -> Scene:
    """A function of the arrays of one or several scenes, as `jax.tree.map`; the texels are those of the first.

    So scenes of one structure become one, a batch whose arrays have the scenes as another first axis. The texels of
    pictures have not: all scenes have them in common, however many there are.
    """
    return with_texels(jax.tree.map(function, *map(without_texels, scenes)), scenes[0])


def without_texels(scene: Scene) -> Scene:
    """The scene with pictures of no texels: a program that only moves numbers need not copy them."""
    return eqx.tree_at(lambda scene: scene.images.texels, scene, ())


def with_texels(scene: Scene, other: Scene) -> Scene:
    """The scene with the texels of another one, not copied."""
    return eqx.tree_at(lambda scene: scene.images.texels, scene, other.images.texels)


def fingerprint(scene: Scene) -> str:
    """16 hexadecimal digits that tell the pictures of a scene's textures from others; empty where it has none."""
    found = hashlib.sha256()
    for texels in scene.images.texels:
        found.update(repr(texels.shape).encode() + np.asarray(texels).tobytes())
    return found.hexdigest()[:16] if scene.images.names else ""


def world_length(scene: Scene) -> Float[Array, ""]:
    """The order of magnitude of a scene's lengths: exactly a power of ten, without a derivative, also inside `jax.jit`.

    It is the power of ten that is nearest, in the logarithm, to what the camera shows: the diagonal of the image plane,
    or the distance from viewpoint to lookat. The course's scenes have 10 world units.
    """
    camera = scene.camera
    across = camera.worlddim if isinstance(camera, ImagePlaneCamera) else camera.lookat - camera.viewpoint
    across = jax.lax.stop_gradient(across)
    limits = jnp.finfo(across.dtype)
    # By logarithms, because squares may overflow or vanish.
    exponents = jnp.log10(jnp.maximum(jnp.abs(across), limits.tiny))
    largest = jnp.max(exponents)
    exponent = largest + jnp.log10(jnp.sum(10 ** (2 * (exponents - largest)))) / 2
    # All powers of ten that are normal numbers, as exact as numbers can be: `10**x` of a float is not.
    least = int(np.ceil(np.log10(limits.tiny)))
    powers = np.array([f"1e{k}" for k in range(least, int(np.log10(limits.max)) + 1)], np.float64).astype(across.dtype)
    index = jnp.clip(jnp.round(exponent).astype(jnp.int32) - least, 0, len(powers) - 1)
    return jnp.asarray(powers)[index]


def least_distance(unit: Float[Array, ""]) -> Float[Array, ""]:
    """The least distance at which a shape is hit: the course's 1e-5, or 1e-4 in float32, which resolves no more.

    It only matters where two shapes meet. Whether a ray can meet its own shape again is decided by identity and side.

    Args:
        unit: a tenth of `world_length`.
    """
    return (1e-5 if unit.dtype == jnp.float64 else 1e-4) * unit
