"""The picture as a pure function of the scene: traced in tiles, which are spread over devices."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import PartitionSpec
from jaxtyping import Array, Float, Int

from raytrace_jax.errors import SettingsError
from raytrace_jax.scene.film import develop
from raytrace_jax.scene.scene import Camera, Scene
from raytrace_jax.tracer.aovs import AOVS
from raytrace_jax.tracer.film import Film
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.levels.wavefront import Trace
from raytrace_jax.tracer.programs.edge_pixels import trace_pixels
from raytrace_jax.tracer.programs.plan import Plan, Wanted, tile_pixels, too_many
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.world import World, prepare_world

Seen = tuple[World, Camera]
"""What a tile is traced from."""


def render_planned(scene: Scene, settings: ResolvedSettings, plan: Plan) -> tuple[Film, Wanted]:
    """The picture, and for each level the most rays that a tile wanted there. Pure, for use under transformations.

    Args:
        scene: the scene.
        settings: what to render; without `edges` the picture is that of points, and its derivative that of areas.
        plan: sizes for the tracer's arrays.
    """
    film, frame = scene.film, settings.frame(scene.camera.pixeldim)
    scene = dataclasses.replace(scene, film=None)
    if settings.edges:
        light, wanted = trace_light(scene, settings, plan)
        return dataclasses.replace(light, image=develop(light.image, film, frame)), wanted
    # AOVs have no area: where there are some, their derivative is that of points.
    light, wanted = trace_light(scene if settings.aov else jax.lax.stop_gradient(scene), settings.of_points, plan)
    image, overflow = moved_by_areas(scene, light.image, light.overflow, settings, plan)
    return Film(develop(image, film, frame), light.aov, overflow), wanted


@functools.partial(jax.custom_jvp, nondiff_argnums=(3, 4))
def moved_by_areas(
    scene: Scene,
    image: Float[Array, "3 height width"],
    overflow: Int[Array, ""],
    settings: ResolvedSettings,
    plan: Plan,
) -> tuple[Float[Array, "3 height width"], Int[Array, ""]]:
    """The light at the pixels' points with the derivative of the light on their areas, and how many rays found no room.

    A point's colour jumps where an edge crosses it, so that its derivative lacks what edges sweep. The light on an area
    changes by that too, and edge-aware tracing knows how. Only who differentiates pays for it.
    """
    return image, overflow


@moved_by_areas.defjvp
def _moved_by_areas(settings: ResolvedSettings, plan: Plan, primals, tangents):
    scene, image, overflow = primals
    of_areas = plan.derivative
    if of_areas is None:
        prepare_world(scene, settings.of_derivative)  # Refuses a scene of too many shapes.
        raise SettingsError("the plan was made for settings that say `edges`, and these do not: plan with these.")

    def light_on_areas(scene: Scene) -> tuple[Float[Array, "3 height width"], Int[Array, ""]]:
        light, _ = trace_light(scene, dataclasses.replace(settings.of_derivative, aov=()), of_areas)
        return light.image, light.overflow

    _, moved, more = jax.jvp(light_on_areas, (scene,), (tangents[0],), has_aux=True)
    return (image, overflow + more), (moved, np.zeros((), jax.dtypes.float0))


def trace_light(scene: Scene, settings: ResolvedSettings, plan: Plan) -> tuple[Film, Wanted]:
    """What the camera receives, before any film, and the most rays that a tile wanted at each level.

    Args:
        scene: the scene.
        settings: what to render; they say `edges`.
        plan: sizes for the tracer's arrays.
    """
    window = settings.window(scene.camera.pixeldim)
    _, _, width, height = window
    dtype = scene.camera.viewpoint.dtype

    # One sample of each pixel of a tile.
    def trace_offset(seen: Seen, tile, offset: Float[Array, "2"]) -> tuple[Trace, Wanted]:
        world, camera = seen
        column, row, live = tile_pixels(tile, plan, window)
        rays = camera_rays(camera, settings, column.astype(dtype) + offset[0], row.astype(dtype) + offset[1])
        return trace_pixels(world, rays, live, plan, settings)

    # The mean over the samples. In reverse mode each sample is computed anew: memory for one of them is enough.
    def tile_color(seen: Seen, tile):
        if settings.samples == 1:
            traced, wanted = trace_offset(seen, tile, jnp.zeros(2, dtype))
            return traced.color, wanted

        def add_sample(total, offset):
            traced, wanted = trace_offset(seen, tile, offset)
            return total + traced.color, wanted

        offsets = sample_offsets(settings.samples)
        black = jnp.zeros((3, plan.stages[0].capacity), dtype)
        total, wanted = jax.lax.scan(jax.checkpoint(add_sample, prevent_cse=False), black, jnp.asarray(offsets, dtype))
        return total / len(offsets), most(wanted)

    # AOVs are those of the pixel's own point: a mean of places or of numbers of shapes would mean nothing.
    def tile_aov(seen: Seen, tile):
        traced, _ = trace_offset(seen, tile, jnp.zeros(2, dtype))
        rows = {name: AOVS[name] for name in settings.aov}
        return {name: jnp.where(traced.first.valid, row.value(traced), row.missing) for name, row in rows.items()}

    def tile_outputs(seen: Seen, tile):
        color, wanted = tile_color(seen, tile)
        return color, wanted, tile_aov(seen, tile) if settings.aov else {}

    # All tiles, each likewise computed anew in reverse mode.
    seen = prepare_world(scene, settings), scene.camera
    color, wanted, aov = map_tiles(jax.checkpoint(tile_outputs, prevent_cse=False), seen, plan)

    # A tile has every n-th pixel of the picture (`plan.tile_pixels`): the tile's number is the fastest index.
    def to_image(tiles):
        pixels = jnp.moveaxis(tiles[..., : plan.tile_size], 0, -1)
        return pixels.reshape(*tiles.shape[1:-1], -1)[..., : width * height].reshape(*tiles.shape[1:-1], height, width)

    wanted = most(wanted)
    overflow = too_many(plan, wanted)
    return Film(to_image(color), {name: to_image(values) for name, values in aov.items()}, overflow), wanted


def most(wanted: Wanted) -> Wanted:
    """The most rays that were wanted at each level, of several tiles."""
    return jax.tree.map(lambda counts: jnp.max(counts, axis=0), wanted)


def sample_offsets(samples: int) -> Float[np.ndarray, "samples 2"]:
    """Where in its pixel each of `samples` x `samples` samples lies: columns and rows from the pixel's own point."""
    grid = (np.arange(samples) + 0.5) / samples - 0.5
    return np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 2)


def map_tiles(function, common, plan: Plan):
    """`function(common, tile)` for every tile number, stacked; tiles are shared out as the plan says."""

    def map_share(common, share):
        return jax.lax.map(functools.partial(function, common), share)

    tiles = jnp.arange(plan.tiles, dtype=jnp.int32)
    return share_out(map_share, common, tiles) if plan.on_all_devices else map_share(common, tiles)


def share_out(function, common, *arrays):
    """`function(common, *arrays)` with the arrays' first axes shared out evenly over all devices, each with its share.

    Args:
        function: of what it is given and of nothing else that is traced: a value from an earlier program lies on the
            same devices, and JAX refuses such a one where it is closed over.
        common: what every device gets whole.
        arrays: what is shared out.
    """
    if jax.device_count() == 1:
        return function(common, *arrays)
    mesh = jax.make_mesh((jax.device_count(),), ("tiles",), axis_types=(jax.sharding.AxisType.Auto,))
    share = PartitionSpec("tiles")
    specs = PartitionSpec(), *(share for _ in arrays)
    # Unchecked, so that loops within (many shapes, many samples) may start from constants, which do not vary by device.
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=share, check_vma=False)(common, *arrays)
