"""The scene of a `model.txt` file as a pytree, and functions of whole scenes; its parts are the structs of blocks."""

import dataclasses
import functools
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

from ..errors import SceneError
from ..util.compilation import refuse_fork
from ..util.files import StrPath
from ..util.text import did_you_mean, listed, quoted
from .setting_words import ModelName
from .structs import (
    AbbeMaterials,
    Background,
    Boxes,
    CameraResponse,
    ChannelMaterials,
    Checkers,
    CutCylinders,
    CutSpheres,
    Cylinders,
    FileSettings,
    ImagePlaneCamera,
    Images,
    Lenses,
    Materials,
    PerspectiveCamera,
    Planes,
    PointLights,
    Prisms,
    Rectangles,
    Slabs,
    Spheres,
)

Camera = ImagePlaneCamera | PerspectiveCamera


class View(eqx.Module):
    """A camera that looks at a scene, and its response to the light; None responds with the light itself."""

    camera: Camera
    film: CameraResponse | None


class Scene(eqx.Module):
    """All blocks of a `model.txt` file.

    `shape_order` lists the names of all shapes in the order of the file: the course's tracer gives a tie between two
    shapes to the first of them, and the writer keeps this order. A shape's index, as in the film's `shape_index`, is
    its place in this list.

    `model` is the model with which the scene was loaded; its defaults fill in what the blocks leave out.

    `camera` and `film` are what is rendered; `further_views` are the other cameras, each with its film, in the order of
    the file. `seen_by` makes another camera the one that is rendered.
    """

    model: ModelName = eqx.field(static=True)
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
    cut_spheres: CutSpheres
    rectangles: Rectangles
    boxes: Boxes
    prisms: Prisms
    cylinders: Cylinders
    cut_cylinders: CutCylinders
    lenses: Lenses
    slabs: Slabs
    shape_order: tuple[str, ...] = eqx.field(static=True)
    further_views: tuple[View, ...] = ()

    def __repr__(self) -> str:
        """The scene in a line: its model, its camera's pixels, how many blocks of each type it has."""
        # JAX builds scenes that hold anything, without blocks: to compare, and to tell where trees differ.
        width, height = getattr(self.camera, "pixeldim", ("?", "?"))
        counts = {name: len(getattr(group, "names", ())) for name, group in vars(self).items()}
        if isinstance(self.further_views, tuple):
            counts["further_views"] = len(self.further_views)
        blocks = [f"{name}={count}" for name, count in counts.items() if count]
        return f"Scene({', '.join([self.model, f'camera={width}x{height}', *blocks])})"

    def __getitem__(self, name: str) -> Array:
        """The value of a parameter, as `scene["glass.ior"]`: shape () for a number, (2,) or (3,) for a vector.

        Raises:
            ParameterError: there is no parameter of that name.
        """
        from .parameters import get_parameter

        return get_parameter(self, name)

    @property
    def cameras(self) -> tuple[str, ...]:
        """The names of all cameras: first the one that is rendered, then the others in their order."""
        return (self.camera.name, *(view.camera.name for view in self.further_views))

    def seen_by(self, name: str) -> "Scene":
        """The scene as the camera of this name shows it: its `camera` and `film` are that camera's.

        The other cameras are the further views, in their order. The camera that is rendered anyway gives the scene
        itself.

        Raises:
            SceneError: no camera has this name; the message lists those there are.
        """
        if name not in self.cameras:
            names = listed(self.cameras)
            guess = did_you_mean(str(name), self.cameras)
            raise SceneError(f"there is no camera {quoted(str(name))}.{guess} Cameras of this scene: {names}.")
        views = [View(self.camera, self.film), *self.further_views]
        if name == self.camera.name:
            return self
        view = views.pop(self.cameras.index(name))
        return dataclasses.replace(self, camera=view.camera, film=view.film, further_views=tuple(views))

    def alone(self) -> "Scene":
        """The scene without its further views: all that a picture is made of. It is the scene itself if it has none."""
        return dataclasses.replace(self, further_views=()) if self.further_views else self

    def save(self, path: StrPath) -> None:
        """Write the scene as a `model.txt` file, and beside it the pictures of its textures; see `save_scene`.

        Raises:
            ModelFileError: the scene holds what no file can say.
            RaytraceError: the file cannot be written.
        """
        from .writer import save_scene

        save_scene(self, path, model=self.model)

    def to_dict(self) -> dict[str, Any]:
        """The scene as strings, numbers and lists; see `scene.writer.scene_to_dict`."""
        from .writer import scene_to_dict

        return scene_to_dict(self)

    @staticmethod
    def from_dict(values: Mapping[str, Any], *, folder: StrPath = ".", dtype: DTypeLike | None = None) -> "Scene":
        """The scene of `to_dict`'s values; see `scene.build.scene_from_dict`."""
        from .build import scene_from_dict

        return scene_from_dict(values, folder=folder, dtype=dtype)


def check_scene(given: object) -> None:
    """Refuse a path or a text where a `Scene` is expected. Raises SceneError that says how a scene is made of it."""
    refuse_fork()
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
    """A scene with the texels of another one: what `without_texels` took away."""
    return eqx.tree_at(lambda scene: scene.images.texels, scene, other.images.texels)


def fingerprint(scene: Scene) -> str:
    """16 hexadecimal digits that tell the pictures of a scene's textures from others; empty where it has none."""
    digest = hashlib.sha256()
    for texels in scene.images.texels:
        digest.update(repr(texels.shape).encode() + np.asarray(texels).tobytes())
    return digest.hexdigest()[:16] if scene.images.names else ""


def world_length(scene: Scene) -> Float[Array, ""]:
    """The order of magnitude of a scene's lengths: exactly a power of ten, without a derivative, also inside `jax.jit`.

    It is the power of ten that is nearest, in the logarithm, to what the camera shows: the diagonal of the image plane,
    or the distance from viewpoint to lookat. The course's scenes have 10 world units.
    """
    camera = scene.camera
    across = camera.worlddim if isinstance(camera, ImagePlaneCamera) else camera.lookat - camera.viewpoint
    return _length_of(across)


@functools.partial(jax.jit, inline=True)
def _length_of(across: Float[Array, " axes"]) -> Float[Array, ""]:
    # One program, where it is not part of another: by single operations it would be twenty.
    across = jax.lax.stop_gradient(across)
    limits = jnp.finfo(across.dtype)
    # By the largest side, because squares may overflow or vanish.
    sides = jnp.maximum(jnp.abs(across), limits.tiny)
    largest = jnp.max(sides)
    exponent = jnp.log10(largest) + jnp.log10(jnp.linalg.norm(sides / largest))
    # All powers of ten that are normal numbers, exact ones: `10**x` of a float is not.
    least = int(np.ceil(np.log10(limits.tiny)))
    powers = np.array([f"1e{k}" for k in range(least, int(np.log10(limits.max)) + 1)], np.float64).astype(across.dtype)
    index = jnp.clip(jnp.round(exponent).astype(jnp.int32) - least, 0, len(powers) - 1)
    return jnp.asarray(powers)[index]


def least_distance(unit: Float[Array, ""]) -> Float[Array, ""]:
    """The least distance at which a shape is hit: the course's 1e-5, or 1e-4 in float32, which resolves no more.

    It only matters where two shapes meet. Whether a ray can meet its own shape again is decided by identity and side.
    `unit` is a tenth of `world_length`.
    """
    return (1e-5 if unit.dtype == jnp.float64 else 1e-4) * unit
