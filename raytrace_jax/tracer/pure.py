"""The picture as a pure function of the scene, for callers' own `jit`, `grad` and `vmap`: `make_renderer` offers it.

The pixels' batches are a loop whose sizes are static: `room_for` measures them with concrete scenes. Each batch is
computed anew in reverse mode, in the memory of one.
"""

import dataclasses
import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from raytrace_jax.errors import SceneError, SettingsError
from raytrace_jax.scene.checks import check_values
from raytrace_jax.scene.response import develop
from raytrace_jax.scene.scene import Scene, check_scene, map_scenes
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.levels.integrator import trace_channels
from raytrace_jax.tracer.pixels import output_variables, picture_pixels, pixel_outputs, sample_offsets
from raytrace_jax.tracer.rendering import Film, refuse_too_large, render_concrete
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.run import Capacity, capacity_for, known_need, scene_key, spread_out
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.world import MOST_SHAPES, prepare_world
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import is_traced, with_lower_ranks


class Room(NamedTuple):
    """The sizes of a pure picture's batches; static and hashable.

    Args:
        derivative: of the derivative of a picture by points, which is that of areas; None where the derivative is the
            picture's own, or edge-aware tracing cannot take the scene.
    """

    picture: Capacity
    derivative: Capacity | None = None

    def lacks(self, needed: "Room") -> bool:
        """Whether this room is too small where another one is needed."""
        pairs = zip((self.picture, self.derivative), (needed.picture, needed.derivative), strict=True)
        return any(a and b and (a.rays < b.rays or a.pixels > b.pixels) for a, b in pairs)


def room_for(scene: Scene, settings: ResolvedSettings, slack: float) -> Room:
    """Room for the rays of a picture."""
    has_derivative = settings.edges is None and len(scene.shape_order) <= MOST_SHAPES
    derivative = _measured(scene, settings.of_derivative, slack) if has_derivative else None
    return Room(_measured(scene, settings.of_points, slack), derivative)


def _measured(scene: Scene, settings: ResolvedSettings, slack: float) -> Capacity:
    """The capacity of a batch, from tracing some pixels that are spread over the picture."""
    settings = dataclasses.replace(settings, samples=1, aov=())
    pixels = picture_pixels(scene, settings)
    some = pixels.points[:, spread_out(pixels.points.shape[1])[0][:4096]]
    scenes = map_scenes(lambda x: np.asarray(x)[None], dataclasses.replace(scene, film=None))
    pixel_outputs(scenes, some, settings, pixels.step)
    return capacity_for(slack * known_need(scene_key(scenes, settings.of_rays), settings), derivatives=True)


@with_lower_ranks
def pure_picture(scene: Scene, settings: ResolvedSettings, room: Room) -> Film:
    """The picture; `film.overflow` is positive where rays found no room.

    Args:
        settings: what to render; without `edges` the picture is that of points, and its derivative that of areas.
    """
    film, frame = scene.film, settings.frame(scene.camera.pixeldim)
    scene = dataclasses.replace(scene, film=None)
    if settings.edges:
        light = trace_light(scene, settings, room.picture)
        return dataclasses.replace(light, image=develop(light.image, film, frame))
    # AOVs have no area: where there are some, their derivative is that of points.
    light = trace_light(scene if settings.aov else jax.lax.stop_gradient(scene), settings.of_points, room.picture)
    image, overflow = moved_by_areas(scene, light.image, light.overflow, settings, room)
    return Film(develop(image, film, frame), light.aov, overflow)


compiled_picture = jit(pure_picture, static_argnames=("settings", "room"))
"""`pure_picture`, compiled once for each of settings and room."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def moved_by_areas(
    scene: Scene,
    image: Float[Array, "3 height width"],
    overflow: Int[Array, ""],
    settings: ResolvedSettings,
    room: Room,
) -> tuple[Float[Array, "3 height width"], Int[Array, ""]]:
    """The light at the pixels' points with the derivative of the light on their areas, and how many rays found no room.

    A point's colour jumps where an edge crosses it, so that its derivative lacks what edges sweep. The light on an area
    changes by that too, and edge-aware tracing knows how. Only who differentiates pays for it.
    """
    return image, overflow


@moved_by_areas.defjvp
@with_lower_ranks
def _moved_by_areas(settings: ResolvedSettings, room: Room, primals, tangents):
    scene, image, overflow = primals
    capacity = room.derivative
    if capacity is None:
        prepare_world(scene, settings.of_derivative)  # Refuses a scene of too many shapes.
        raise SettingsError("this renderer was made for settings that say `edges`, and these do not.")

    def light_on_areas(scene: Scene) -> tuple[Float[Array, "3 height width"], Int[Array, ""]]:
        light = trace_light(scene, dataclasses.replace(settings.of_derivative, aov=()), capacity)
        return light.image, light.overflow

    _, moved, more = jax.jvp(light_on_areas, (scene,), (tangents[0],), has_aux=True)
    return (image, overflow + more), (moved, np.zeros((), jax.dtypes.float0))


@jax.custom_jvp
def differentiable_once(scene: Scene) -> Scene:
    """The scene itself, whose derivatives must not be differentiated again: those of areas are estimates.

    The slopes of edges and the spreads of footprints are constants to the first derivative; a second one would lack
    what they change.
    """
    return scene


def _differentiable_once(primals, tangents):
    return _not_differentiable(*primals), *tangents


@jax.custom_jvp
def _not_differentiable(scene: Scene) -> Scene:
    return scene


def _refuse_derivative(primals, tangents):
    zeros = jax.custom_derivatives.SymbolicZero
    if all(isinstance(tangent, zeros) for tangent in jax.tree.leaves(tangents)):
        return *primals, *tangents
    raise SettingsError(
        "edges: a picture whose derivative contains the motion of edges has no second derivative; RenderSettings("
        "edges='point') has one, without that motion, and Gauss-Newton steps (J^T J) do with first derivatives."
    )


differentiable_once.defjvp(_differentiable_once, symbolic_zeros=True)
_not_differentiable.defjvp(_refuse_derivative, symbolic_zeros=True)


def trace_light(scene: Scene, settings: ResolvedSettings, capacity: Capacity) -> Film:
    """The light that the camera receives, before any film."""
    if settings.edges == "aware":
        scene = differentiable_once(scene)
    x, y, width, height = settings.window(scene.camera.pixeldim)
    total, dtype = width * height, scene.camera.viewpoint.dtype
    world = prepare_world(scene, settings)

    # Each batch has every n-th pixel. If n shares no factor with the width, these are spread over all columns.
    batches = max(1, -(-total // capacity.pixels))
    while math.gcd(batches, width) > 1:
        batches += 1

    # One sample of each pixel of a batch.
    def trace_offset(batch: Int[Array, ""], offset: Float[Array, "2"]):
        number = jnp.arange(capacity.rays // 2, dtype=jnp.int32) * batches + batch
        column, row = x + number % width, y + number // width
        rays = camera_rays(scene.camera, settings, column.astype(dtype) + offset[0], row.astype(dtype) + offset[1])
        count = (total - batch + batches - 1) // batches
        return trace_channels(world, rays, count, settings, with_hits=bool(settings.aov), reversible=True)

    # The mean over the samples. In reverse mode each sample is computed anew: memory for one of them is enough.
    def batch_color(batch):
        def add_sample(sum_, offset):
            traced = trace_offset(batch, offset)
            return sum_ + traced.color, traced.wanted

        if settings.samples == 1:
            return add_sample(0, jnp.zeros(2, dtype))
        offsets = sample_offsets(settings.samples)
        black = jnp.zeros((3, capacity.rays // 2), dtype)
        sum_, wanted = jax.lax.scan(jax.checkpoint(add_sample, prevent_cse=False), black, jnp.asarray(offsets, dtype))
        return sum_ / len(offsets), jnp.max(wanted)

    # AOVs are those of the pixel's own point: a mean of places or of numbers of shapes would mean nothing.
    def batch_outputs(batch):
        color, wanted = batch_color(batch)
        aov = output_variables(trace_offset(batch, jnp.zeros(2, dtype)), settings.aov) if settings.aov else {}
        return color, aov, wanted

    color, aov, wanted = jax.lax.map(
        jax.checkpoint(batch_outputs, prevent_cse=False), jnp.arange(batches, dtype=jnp.int32)
    )

    # A batch has every n-th pixel: its number is the fastest index.
    def to_image(values):
        pixels = jnp.moveaxis(values[..., : -(-total // batches)], 0, -1)
        return pixels.reshape(*values.shape[1:-1], -1)[..., :total].reshape(*values.shape[1:-1], height, width)

    overflow = jnp.maximum(jnp.max(wanted) - capacity.rays, 0)
    return Film(to_image(color), {name: to_image(values) for name, values in aov.items()}, overflow)


MOVING_SLACK = 1.3
"""Room for the rays that a scene may grow while its parameters move, before a program must be compiled anew."""


class Renderer:
    """`renderer(scene)` is the scene's `Film`; see `make_renderer`."""

    def __init__(self, settings: ResolvedSettings, room: Room, model: ModelName):
        self.settings, self.room, self.model = settings, room, model

    def __call__(self, scene: Scene) -> Film:
        """The film of a scene of the same structure; pure and differentiable.

        With concrete values it never lacks room. Under a transformation of JAX the sizes are those of `room` when the
        program is traced: where rays find no room they are black, `film.overflow` counts them, and `grow` makes room.

        Raises:
            SceneError: the scene was loaded with another model than that which the renderer was made with; a number is
                not finite, or not a value that its attribute can have.
        """
        check_scene(scene)
        if scene.model != self.model:
            raise SceneError(
                f"this renderer was made with a scene of the {self.model} model, and this scene is of the "
                f"{scene.model} one: make a renderer for it, or load it with that model"
            )
        if is_traced(scene):
            return compiled_picture(scene, self.settings, self.room)
        check_values(scene)
        return render_concrete(scene, self.settings.of_points)

    def grow(self, scene: Scene) -> bool:
        """Make room for a scene that overflowed inside of a transformation. Returns whether there was too little.

        Functions that were traced before keep the old sizes: if this returns True, apply `jax.jit` to them anew.
        """
        needed = room_for(scene, self.settings, 1.0)
        if not self.room.lacks(needed):
            return False
        self.room = room_for(scene, self.settings, MOVING_SLACK)
        return True


def make_renderer(scene: Scene, settings: RenderSettings | None = None, slack: float = MOVING_SLACK) -> Renderer:
    """Make a renderer for all scenes of one structure; it works under `jax.jit`, `jax.grad`, `jax.jvp` and `jax.vmap`.

    The sizes of a program's arrays are measured here, so that the scene may be traced afterwards::

        renderer = make_renderer(scene, settings)
        loss = lambda scene: ((renderer(scene).image - target) ** 2).mean()
        gradient = jax.jit(jax.grad(loss))(scene)

    Where the settings do not say `edges`, pixels are the colours at their points (or the mean of `samples` x `samples`
    of them), and their derivative is that of their areas: it contains what a pixel gains or loses as an edge moves
    across it, and is paid for only where it is asked for. `edges="point"` has the derivative of the points, which lacks
    that; `edges="aware"` has the values of areas as well. Second derivatives (`jax.hessian`) are those of points, with
    `edges="point"`; those of areas are refused.

    Args:
        scene: concrete values; scenes given to the renderer have the same structure.
        settings: what to render; None is what the scene's file says.
        slack: room for more rays than this scene has, as a factor.

    Returns:
        The renderer: `renderer(scene)` is the scene's film.

    Raises:
        ValueError: the scene is traced.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such a picture.
    """
    settings = resolve_settings(scene, settings)
    if is_traced(scene):
        raise ValueError("make_renderer() measures a scene's values: call it outside of JAX's transformations")
    settings.window(scene.camera.pixeldim)
    check_values(scene)
    refuse_too_large(scene, settings)
    return Renderer(settings, room_for(scene, settings, slack), scene.model)
