"""Radiance of pixels and pictures, before the camera's response, and its derivatives by a scene's numbers.

There are two programs for all scenes. The first gives colours at any number of points of the pictures of any number of
scenes; the second gives colours with their derivatives in forward mode. Each exists once by points and once edge-aware.
Neither depends on a picture's size. Within a transformation of JAX they are a part of the
caller's program.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..errors import PictureError, SettingsError
from ..scene.response import Frame, apply_response
from ..scene.scene import Camera, Scene, map_scenes, without_texels
from ..util.compilation import jit
from ..util.numerics import is_traced, is_zero, materialize
from ..util.session import lack_of_memory
from .batches import (
    Batches,
    Points,
    map_batches,
    ray_budget,
    refuse_overflow,
    trace_points,
)
from .film import Film, Image
from .geometry.camera import picture_place, pixel_step
from .geometry.rays import Step
from .geometry.shape_types import face_owners
from .integrator import Wavefront, trace
from .settings import AOVS, ResolvedSettings
from .shading.image_texture import Pyramid
from .shading.textures import prepare_pyramids
from .world import World, prepare_world

Parameters = Float[Array, " parameters"]
Jacobian = Float[Array, "parameters 3 height width"]


class Pixels(NamedTuple):
    points: Points  # Where they look, as `picture_place`.
    step: Step  # How far it is from one pixel to the next, as `pixel_step`.


class PixelDerivatives(NamedTuple):
    """Each pixel's colour, the colour's derivatives, and whether the pixel is an area that sees an edge."""

    color: Float[np.ndarray, "3 pixels"]
    jacobian: Float[np.ndarray, "parameters 3 pixels"]
    sees_edge: Bool[np.ndarray, " pixels"]
    overflow: Any = 0  # How many samples of pixels lacked room for their rays.


@runtime_checkable
class SceneFunction(Protocol):
    """A scene as a function of the numbers that it is differentiated by; hashable, as a program's static argument."""

    def moved(self, scene: Scene, y: Parameters) -> Scene: ...


def numpy_of(scene: Scene) -> Any:
    """NumPy, or that of JAX within a transformation of JAX."""
    return jnp if is_traced(scene) else np


def picture_pixels(scene: Scene, settings: ResolvedSettings) -> Pixels:
    """All pixels of a scene's picture, row by row from the top; traced if the scene is, lest a program holds all."""
    x, y, width, height = settings.window(scene.camera.pixeldim)
    numpy = numpy_of(scene)
    dtype = scene.camera.viewpoint.dtype if numpy is jnp else float
    row, column = (part.astype(dtype) for part in numpy.divmod(numpy.arange(width * height), width))
    points = numpy.stack(picture_place(scene.camera, settings, column + float(x), row + float(y)))
    return Pixels(points, pixel_step(scene.camera, settings))


def sample_offsets(samples: int) -> Float[np.ndarray, "samples 2"]:
    """Places of `samples` x `samples` samples in their pixel: columns and rows from the pixel's own point."""
    grid = (np.arange(samples) + 0.5) / samples - 0.5
    return np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)


def mean_of_samples(
    pixels: Pixels, samples: int, at: Callable[[Points], tuple[Sequence[Any], Any]]
) -> tuple[list[Any], Any]:
    """The means over `samples` x `samples` points in each pixel of what is there, pixels on the last axis.

    Args:
        at: what is at points, and the overflow, as `trace_points` returns them; points are traced if the pixels are.
    """
    if samples == 1:
        found, overflow = at(pixels.points)
        return list(found), overflow
    offsets, count = sample_offsets(samples) * pixels.step, pixels.points.shape[1]
    if is_traced(pixels.points):
        # One sample after the other. In reverse mode each is computed anew: memory for one of them is enough.
        def add_sample(sums, offset):
            found, overflow = at(pixels.points + offset[:, None])
            return [sum_ + each for sum_, each in zip(sums, found, strict=True)], overflow

        nothing = [jnp.zeros(x.shape, x.dtype) for x in jax.eval_shape(at, pixels.points)[0]]
        offsets = jnp.asarray(offsets, pixels.points.dtype)
        sums, overflow = jax.lax.scan(jax.checkpoint(add_sample, prevent_cse=False), nothing, offsets)
        return [sum_ / len(offsets) for sum_ in sums], jnp.sum(overflow)
    sums: list[Any] = []
    # Some samples at a time: in small pictures many, so that each call has enough to do.
    for some in np.array_split(offsets, min(len(offsets), -(-len(offsets) * count // 100_000))):
        points = (pixels.points[:, None] + some.T[:, :, None]).reshape(2, -1)
        found = [x.reshape(*x.shape[:-1], len(some), count).sum(axis=-2) for x in at(points)[0]]
        sums = [*map(np.add, sums, found)] if sums else found
    return [each / np.array(len(offsets), each.dtype) for each in sums], 0


def pixel_colors(
    scenes: Scene, points: Points, settings: ResolvedSettings, step: Step | None = None
) -> Float[np.ndarray, "scenes 3 points"]:
    """Radiance at some points of the pictures of some scenes, which have concrete values.

    Args:
        settings: what to render; what it says of pixels and their edges does not matter.
        step: as `pixel_step`: then each point stands for the edge-aware pixel around it; without it, for one ray.
    """
    viewpoint, count = scenes.camera.viewpoint, points.shape[1]
    if not len(viewpoint) or not count:
        return np.zeros((len(viewpoint), 3, count), viewpoint.dtype)
    settings = dataclasses.replace(settings, edges="point" if step is None else "aware", samples=1, aov=())
    pixels = Pixels(points, np.zeros(2) if step is None else step)
    return pixel_outputs(map_scenes(np.asarray, scenes), pixels, settings)[0]["color"]


def rays_of(settings: ResolvedSettings, pixels: Pixels) -> ResolvedSettings:
    """The settings as far as they matter to rays; within a transformation with the number that there is room for."""
    if not is_traced(pixels.points):
        return settings.of_rays
    room = ray_budget(settings, pixels.step, pixels.points.shape[1])
    return dataclasses.replace(settings.of_rays, throw=settings.throw, rays_per_pixel=room)


def pixel_outputs(
    scenes: Scene,
    pixels: Pixels,
    settings: ResolvedSettings,
    reversible: bool = False,
) -> tuple[dict[str, Any], Any]:
    """The `color` of pixels, and the arbitrary output variables of the settings there, by name; and the overflow.

    Args:
        scenes: stacked, as by `map_scenes`.
        reversible: whether reverse mode can go through it.
    """
    scenes, names = dataclasses.replace(scenes.alone(), film=None), ("color", *settings.aov)
    rays = rays_of(settings, pixels)

    def program(batches: Batches):
        own = map_scenes(lambda x: x[batches.picture], scenes)
        found, complete = color_batches(own, batches, rays, settings.aov, reversible)
        return tuple(found[name] for name in names), complete

    viewpoint = scenes.camera.viewpoint
    points = pixels.points.astype(viewpoint.dtype)
    found, overflow = trace_points(len(viewpoint), points, pixels.step, settings, program)
    return dict(zip(names, found, strict=True)), overflow


@functools.partial(jit, static_argnames=("settings", "aov", "reversible"))
def color_batches(
    scenes: Scene, batches: Batches, settings: ResolvedSettings, aov: tuple[str, ...], reversible: bool
) -> tuple[dict[str, Array], Bool[Array, "devices slots places"]]:
    """Colours and output variables by name at batches of points, and which points are complete.

    Args:
        scenes: the scene of each slot.
        reversible: whether reverse mode can go through it.
    """

    def lay_out(pyramids: tuple[Pyramid, ...], scene: Scene) -> tuple[World, Camera]:
        return prepare_world(scene, settings, pyramids), scene.camera

    def one_batch(common: Any, scene: Any, points: Float[Array, "2 places"], count, step):
        world, camera = common if reversible else materialize(lay_out(common, scene), count > 0)
        found = trace(Wavefront(world, camera, points, step, count, bool(aov)), reversible)
        one = refuse_overflow(found, count, settings)
        first: Any = found.first
        # The error is asked for here, too: who takes the variables alone may not use the colour.
        valid: Any = first.valid & (one > 0) if aov else None
        variables = {name: jnp.where(valid, AOVS[name].value(found), AOVS[name].missing) for name in aov}
        if "shape_index" in aov and scenes.shape_order:
            owners = jnp.asarray([place for _, place in face_owners(scenes)], jnp.int32)
            variables["shape_index"] = jnp.where(valid, owners[first.shape], AOVS["shape_index"].missing)
        return {"color": found.color * one, **variables}, found.complete

    # Textures are filtered once for all batches: a loop would filter them again for each. In reverse mode all batches
    # are of one scene, which is laid out once, too.
    pyramids, bare = prepare_pyramids(scenes, settings.edges), without_texels(scenes)
    if reversible:
        common = lay_out(pyramids, jax.tree.map(lambda x: x[0, 0], bare))
        return map_batches(one_batch, common, (), batches, reversible)
    return map_batches(one_batch, pyramids, bare, batches, reversible)


def pixel_derivatives(
    y: Array,
    scene: Scene,
    pixels: Pixels,
    unknowns: SceneFunction,
    settings: ResolvedSettings,
    reversible: bool = False,
) -> PixelDerivatives:
    """Radiance of pixels and its derivatives by `y` in forward mode; the settings say `edges`."""
    y, scene, rays = jnp.asarray(y), scene.alone(), rays_of(settings, pixels)

    def program(batches: Batches):
        return differentiate_batches(y, scene, batches, unknowns, rays, reversible)

    def at(points: Points):
        found, overflow = trace_points(1, points.astype(y.dtype), pixels.step, settings, program)
        color, jacobian, sees_edge = (each[0] for each in found)
        return (color, jacobian, sees_edge.astype(y.dtype)), overflow

    (color, jacobian, sees_edge), overflow = mean_of_samples(pixels, settings.samples, at)
    return PixelDerivatives(color, jacobian, sees_edge > 0, overflow)


@functools.partial(jit, static_argnames=("unknowns", "settings", "reversible"))
def differentiate_batches(
    y: Array, scene: Scene, batches: Batches, unknowns: SceneFunction, settings: ResolvedSettings, reversible: bool
) -> tuple[tuple[Array, Array, Array], Bool[Array, "devices slots places"]]:
    """The fields of `PixelDerivatives` of each batch, and which points are complete; `reversible` as above."""

    def one_batch(common: tuple[Array, Scene, tuple[Pyramid, ...]], _, points: Float[Array, "2 places"], count, step):
        y, scene, pyramids = common

        def color(y):
            moved = unknowns.moved(scene, y)
            world = materialize(prepare_world(moved, settings, pyramids), count > 0)
            found = trace(Wavefront(world, moved.camera, points, step, count), reversible)
            sees_edge = jnp.zeros(points.shape[1], bool) if found.sees_edge is None else found.sees_edge
            one = refuse_overflow(found, count, settings)
            return found.color * one, (sees_edge, found.complete)

        # Forward mode: the picture is traced once, and all derivatives ride along.
        def derivative(direction):
            return jax.jvp(color, (y,), (direction,), has_aux=True)

        directions = jnp.eye(len(y), dtype=y.dtype)
        image, jacobian, (sees_edge, complete) = jax.vmap(derivative, out_axes=(None, 0, None))(directions)
        return (image, jacobian, sees_edge), complete

    common = y, without_texels(scene), prepare_pyramids(scene, settings.edges)
    return map_batches(one_batch, common, (), batches, reversible)


def refuse_too_large(scene: Scene, settings: ResolvedSettings, derivatives: int = 0) -> None:
    """Raise PictureError where there is no memory for a picture, and SettingsError of a crop outside of it."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    channels = 3 * (1 + derivatives) + sum(len(AOVS[name].channels) for name in settings.aov)
    # A channel of a pixel is rendered and written in several copies. Between pictures of 1024 and 2048 pixels a side
    # the peak grows by 34 bytes (OpenEXR), 32 (PNG), 37 (64 bits) and, with a derivative, 31.
    if lack := lack_of_memory(30 * channels * width * height):
        by = f" with derivatives by {derivatives} numbers" if derivatives else ""
        raise PictureError(
            f"a picture of {width} x {height} pixels{by} {lack}: render it in parts (--crop), or smaller (--size)."
        )


def render_radiance(scene: Scene, settings: ResolvedSettings, reversible: bool = False) -> Film:
    """The picture of a scene before the camera's response, by settings that say `edges`; the scene was checked."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    scenes = map_scenes(lambda x: numpy_of(scene).asarray(x)[None], dataclasses.replace(scene.alone(), film=None))
    pixels = picture_pixels(scene, settings)
    found: dict[str, Any] = {}
    overflow: Any = 0
    if settings.samples == 1 or settings.aov:
        # The variables are those of the pixels' own points: their means would mean nothing.
        found, overflow = pixel_outputs(scenes, pixels, settings, reversible)
    if settings.samples > 1:
        without = dataclasses.replace(settings, aov=())

        def colors(points):
            found, overflow = pixel_outputs(scenes, pixels._replace(points=points), without, reversible)
            return [found["color"]], overflow

        [found["color"]], more = mean_of_samples(pixels, settings.samples, colors)
        overflow = overflow + more
    aov = {name: x[0].reshape(*x.shape[1:-1], height, width) for name, x in found.items()}
    if not is_traced(scene):
        # Put there as they are: `jnp.asarray` would compile a program for each size.
        aov, overflow = jax.device_put((aov, np.int32(overflow)))
    return Film(aov.pop("color"), aov, overflow)


def radiance_derivatives(
    y: Array,
    scene: Scene,
    unknowns: SceneFunction,
    settings: ResolvedSettings,
    reversible: bool = False,
) -> tuple[Any, Any, Any]:
    """A picture before the camera's response, its derivatives by `y` in forward mode, and the overflow.

    Without `edges` the picture is that of points, and only the derivative that of areas.
    """
    scene = scene.alone()
    _, _, width, height = settings.window(scene.camera.pixeldim)
    pixels = picture_pixels(scene, settings)
    found = pixel_derivatives(y, scene, pixels, unknowns, settings.with_edges("aware"), reversible)
    image, overflow = found.color.reshape(3, height, width), found.overflow
    if not settings.edges:
        points = dataclasses.replace(settings.with_edges("point"), aov=())
        radiance = render_radiance(unknowns.moved(scene, y), points, reversible)
        image, overflow = radiance.image, overflow + radiance.overflow
    return image, found.jacobian.reshape(-1, 3, height, width), overflow


@jax.custom_jvp
def not_differentiable(values: Any) -> Any:
    """The values themselves, with respect to which nothing may be differentiated."""
    return values


def _refuse_derivative(primals, tangents):
    if is_zero(tangents):
        return *primals, *tangents
    raise SettingsError(
        "edges: a picture whose derivative contains the motion of edges has no second derivative; RenderSettings("
        "edges='point') has one, without that motion, and Gauss-Newton steps (J^T J) do with first derivatives."
    )


not_differentiable.defjvp(_refuse_derivative, symbolic_zeros=True)


@functools.partial(jit, static_argnames=("unknowns", "frame"))
def response_derivatives(
    image: Image,
    jacobian: Jacobian,
    y: Parameters,
    scene: Scene,
    unknowns: SceneFunction,
    frame: Frame,
) -> tuple[Image, Jacobian]:
    """A picture of radiance as the camera's response shows it, and its derivatives by all unknowns.

    Args:
        scene: gives the response, with None for effects that do nothing.
    """

    def developed(image, y):
        return apply_response(image, unknowns.moved(scene, y).film, frame)

    def derivative(change, direction):
        return jax.jvp(developed, (image, y), (change, direction))

    # Chain rule: derivatives of the radiance pass through the response, and the response's own ones are added.
    return jax.vmap(derivative, out_axes=(None, 0))(jacobian, jnp.eye(len(y), dtype=y.dtype))
