"""Radiance of pixels, and its derivatives by a scene's numbers: two programs for all scenes.

The first gives colours at any number of points of the pictures of any number of scenes; the second gives colours with
their derivatives in forward mode. Each exists once by points and once edge-aware. Neither depends on a picture's size.
Within a transformation of JAX the same two functions are a part of the caller's program.
"""

import dataclasses
import functools
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from ..scene.scene import Camera, Scene, map_scenes, without_texels
from ..scene.slabs import surface_owners
from ..util.compilation import jit
from ..util.numerics import materialize
from .batches import (
    Batches,
    Points,
    TracePoints,
    in_batches,
    map_batches,
    ray_budget,
    refuse_overflow,
)
from .geometry.camera import picture_place, pixel_step
from .levels.integrator import Wavefront, trace
from .resolved_settings import ResolvedSettings
from .settings import AOVS
from .shading.image_texture import Pyramid
from .shading.textures import prepare_pyramids
from .world import World, prepare_world


class Pixels(NamedTuple):
    points: Points  # Where they look, as `picture_place`.
    step: Float[np.ndarray, "2"]  # How far it is from one pixel to the next, as `pixel_step`.


class PixelDerivatives(NamedTuple):
    """Each pixel's colour, the colour's derivatives, and whether the pixel is an area that sees an edge."""

    color: Float[np.ndarray, "3 pixels"]
    jacobian: Float[np.ndarray, "parameters 3 pixels"]
    sees_edge: Bool[np.ndarray, " pixels"]
    overflow: Any = 0  # How many samples of pixels lacked room for their rays.


@runtime_checkable
class SceneFunction(Protocol):
    """A scene as a function of the numbers that it is differentiated by; hashable, as a program's static argument."""

    def moved(self, scene: Scene, y: Float[Array, " parameters"]) -> Scene: ...


def picture_pixels(scene: Scene, settings: ResolvedSettings, numpy: Any = np) -> Pixels:
    """All pixels of a scene's picture, row by row from the top.

    `numpy` is JAX's within a transformation of JAX, lest a program holds all points.
    """
    x, y, width, height = settings.window(scene.camera.pixeldim)
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
        at: what is at points, and the overflow, as `TracePoints` returns them; points are traced if the pixels are.
    """
    if samples == 1:
        found, overflow = at(pixels.points)
        return list(found), overflow
    offsets, count = sample_offsets(samples) * pixels.step, pixels.points.shape[1]
    if not isinstance(pixels.points, np.ndarray):
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
    scenes: Scene, points: Points, settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None = None
) -> Float[np.ndarray, "scenes 3 points"]:
    """Radiance at some points of the pictures of some scenes, which have concrete values.

    Args:
        settings: what to render; what it says of pixels and their edges does not matter.
        step: as `pixel_step`: then each point stands for the edge-aware pixel around it; without it, for one ray.
    """
    viewpoint, count = scenes.camera.viewpoint, points.shape[1]
    if not len(viewpoint) or not count:
        return np.zeros((len(viewpoint), 3, count), viewpoint.dtype)
    pixels = Pixels(points, np.zeros(2) if step is None else step)
    return pixel_outputs(map_scenes(np.asarray, scenes), pixels, _of_colors(settings, step))[0]["color"]


def rays_of(settings: ResolvedSettings, pixels: Pixels, trace_points: TracePoints) -> ResolvedSettings:
    """The settings as far as they matter to rays; within a transformation with the number that there is room for."""
    if trace_points is in_batches:
        return settings.of_rays
    room = ray_budget(settings, pixels.step, pixels.points.shape[1])
    return dataclasses.replace(settings.of_rays, throw=settings.throw, rays_per_pixel=room)


def pixel_outputs(
    scenes: Scene,
    pixels: Pixels,
    settings: ResolvedSettings,
    trace_points: TracePoints = in_batches,
    reversible: bool = False,
) -> tuple[dict[str, Any], Any]:
    """The `color` of pixels, and the arbitrary output variables of the settings there, by name; and the overflow.

    Args:
        scenes: stacked, as by `map_scenes`.
    """
    scenes, names = dataclasses.replace(scenes, film=None), ("color", *settings.aov)
    rays = rays_of(settings, pixels, trace_points)

    def program(batches: Batches):
        own = map_scenes(lambda x: x[batches.picture], scenes)
        found, complete = color_batches(own, batches, rays, settings.aov, reversible)
        return tuple(found[name] for name in names), complete

    viewpoint = scenes.camera.viewpoint
    points = pixels.points.astype(viewpoint.dtype)
    found, overflow = trace_points(len(viewpoint), points, pixels.step, settings, program)
    return dict(zip(names, found, strict=True)), overflow


def _of_colors(settings: ResolvedSettings, step: Float[np.ndarray, "2"] | None) -> ResolvedSettings:
    return dataclasses.replace(settings, edges="point" if step is None else "aware", samples=1, aov=())


@functools.partial(jit, static_argnames=("settings", "aov", "reversible"))
def color_batches(
    scenes: Scene, batches: Batches, settings: ResolvedSettings, aov: tuple[str, ...] = (), reversible: bool = False
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
        found = trace(Wavefront(world, camera, points, step, count, settings, bool(aov)), reversible)
        one = refuse_overflow(found.complete, count, found.color.dtype, settings)
        first: Any = found.first
        # The error is asked for here, too: who takes the variables alone may not use the colour.
        valid: Any = first.valid & (one > 0) if aov else None
        variables = {name: jnp.where(valid, AOVS[name].value(found), AOVS[name].missing) for name in aov}
        if "shape_index" in aov and scenes.slabs.names:
            owners = jnp.asarray([*surface_owners(scenes).values()], jnp.int32)
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
    trace_points: TracePoints = in_batches,
    reversible: bool = False,
) -> PixelDerivatives:
    """Radiance of pixels and its derivatives by `y` in forward mode; the settings say `edges`."""
    y, rays = jnp.asarray(y), rays_of(settings, pixels, trace_points)

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
    y: Array, scene: Scene, batches: Batches, unknowns: SceneFunction, settings: ResolvedSettings, reversible=False
) -> tuple[tuple[Array, Array, Array], Bool[Array, "devices slots places"]]:
    """The fields of `PixelDerivatives` of each batch, and which points are complete; `reversible` as above."""

    def one_batch(common: tuple[Array, Scene, tuple[Pyramid, ...]], _, points: Float[Array, "2 places"], count, step):
        y, scene, pyramids = common

        def color(y):
            moved = unknowns.moved(scene, y)
            world = materialize(prepare_world(moved, settings, pyramids), count > 0)
            found = trace(Wavefront(world, moved.camera, points, step, count, settings), reversible)
            sees_edge = jnp.zeros(points.shape[1], bool) if found.sees_edge is None else found.sees_edge
            one = refuse_overflow(found.complete, count, found.color.dtype, settings)
            return found.color * one, (sees_edge, found.complete)

        # Forward mode: the picture is traced once, and all derivatives ride along.
        def derivative(direction):
            return jax.jvp(color, (y,), (direction,), has_aux=True)

        directions = jnp.eye(len(y), dtype=y.dtype)
        image, jacobian, (sees_edge, complete) = jax.vmap(derivative, out_axes=(None, 0, None))(directions)
        return (image, jacobian, sees_edge), complete

    common = y, without_texels(scene), prepare_pyramids(scene, settings.edges)
    return map_batches(one_batch, common, (), batches, reversible)
