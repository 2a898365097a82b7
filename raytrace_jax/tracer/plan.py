"""How a picture is cut into tiles, and how many rays each level of a tile has to hold.

A tile is not a rectangle but a sparse lattice over the whole picture, so that every tile has nearly the same share of
glass and of background: one set of capacities fits all of them tightly.
"""

import dataclasses
import functools
import math
import os
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.compaction import BLOCK, pack
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.level import trace_level
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.tracer.scene_settings import resolve_settings
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.wavefront import Stage, pack_rays
from raytrace_jax.tracer.world import World, prepare_world
from raytrace_jax.util.compilation import jit

FEW_RUNS = 2
"""Into how many runs of one size levels are cut where a program more takes longer to compile than it saves.
Point-sampled pictures of 640 x 480 pixels compile in 3.4 s instead of 8.1 and take 11 % longer, with derivatives by
four numbers in 8.8 s instead of 20 and take 30 % longer; one run compiles in 2.4 and 6.3 s, and takes 60 % longer."""

MOST_PIXELS_IN_ONE_RUN = 100_000
"""Up to this size a few point-sampled pictures take less time in one run than a second program for the deeper levels
takes to compile. Edge-aware ones do at any size: at 640 x 480 pixels they compile in 6.1 s instead of 9.5 and take
1.1 s instead of 0.8, with derivatives by four numbers in 15 s instead of 19 and take as long as in two runs."""

MOST_RUNS = 6
"""Into how many runs of one size the levels of point-sampled pictures are cut where that is not said: each level of the
course's five bounces has its own, and of a deep tree the last ones, which hold few rays, share one."""

SLACK = 1.06
"""Room beyond the rays that were counted: counts of a sample, or of another tile, are off by a few in a hundred."""

MOVING_SLACK = 1.3
"""Room for the rays that a scene may grow while its parameters move, before the tracer must be compiled anew."""

PROBE = 4096
"""How many rays the planning pass follows at each level."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """The static sizes of a render.

    Args:
        tiles: number of tiles, a multiple of the number of devices.
        tile_size: camera rays in a tile.
        stages: the levels' capacities, from the camera rays on.
        runs: into how many stages the levels are cut at most; None is as many as are usual.
        on_all_devices: whether the devices share the tiles; else one of them traces all.
    """

    tiles: int
    tile_size: int
    stages: tuple[Stage, ...]
    runs: int | None = None
    on_all_devices: bool = True

    def for_loops(self) -> "Plan":
        """The same for programs of others, which may start the next one before this one has ended."""
        return dataclasses.replace(self, on_all_devices=can_share_loops())

    @property
    def capacities(self) -> tuple[int, ...]:
        """Rays that each level can hold, from the camera rays on."""
        return tuple(stage.capacity for stage in self.stages for _ in range(stage.levels))


def can_share_loops() -> bool:
    """Whether XLA has threads enough for programs on all devices that are started without waiting for those before.

    On the CPU each device waits in a thread for the others' share of a picture. Where a loop starts the next program
    before, devices that run ahead hold all threads, and XLA ends the process after 40 s. Of two devices 3 threads lock
    up and 4 do not; they are as many as the processor's cores, or as the environment variable NPROC says.
    """
    if jax.default_backend() != "cpu":
        return True
    said = os.environ.get("NPROC", "")
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return (int(said) if said.isdecimal() else cores) >= 2 * jax.device_count()


def plan_render(
    scene: Scene,
    settings: RenderSettings | None = None,
    slack: float = SLACK,
    others: Sequence[Scene] = (),
    runs: int | None = None,
) -> Plan:
    """Count the rays of each level on a sparse sample of the picture and choose sizes that hold them.

    Args:
        scene: concrete values, not traced ones.
        settings: what will be rendered; None is what the scene's file says.
        slack: room for more rays than were counted, as a factor. Ask for more before an optimisation that moves the
            scene.
        others: scenes of the same structure whose rays the sizes have to hold as well.
        runs: how many programs the levels may be, at most. One compiles soonest, a loop over levels of one size; with
            more the deeper levels take fewer slots, and less time. None is up to `MOST_RUNS` of a
            point-sampled picture, and two of an edge-aware one.
    """
    settings = resolve_settings(scene, settings)
    tiles, tile_size = tile_layout(settings.window(scene.camera.pixeldim))
    share = functools.reduce(np.maximum, (count_rays(one, settings) for one in (scene, *others)))
    return Plan(tiles, tile_size, make_stages(share, tile_size, slack, settings, runs), runs)


def few_runs(scene: Scene, settings: ResolvedSettings) -> int:
    """Into how many runs the levels of a picture are best cut that is traced a few times."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    return 1 if settings.edges == "aware" or width * height <= MOST_PIXELS_IN_ONE_RUN else FEW_RUNS


def make_stages(
    share: Float[np.ndarray, " levels"],
    tile_size: int,
    slack: float,
    settings: ResolvedSettings,
    runs: int | None = None,
) -> tuple[Stage, ...]:
    """Stages for levels that hold `share` rays for each camera ray; trailing empty levels are left out.

    Args:
        share: for each level after the first, how many rays it has for each camera ray.
        tile_size: camera rays in a tile.
        slack: room for more rays than these, as a factor.
        settings: what is rendered.
        runs: how many stages at most; None is the usual number. Levels of point-sampled pictures are small programs:
            most get their own size. Edge-aware ones are large: they share sizes.
    """
    share = np.trim_zeros(share, "b")
    spread = 2 * np.sqrt(share * tile_size) / tile_size  # Lattices differ less than random samples do.
    needed = [tile_size, *(slack * (share + spread) * tile_size)]
    capacities = [int(BLOCK * math.ceil(n / BLOCK)) for n in needed]
    if runs is None:
        runs = MOST_RUNS if settings.edges == "point" else FEW_RUNS
    return best_runs(tuple(capacities), min(runs, len(capacities)))


def best_runs(capacities: tuple[int, ...], runs: int) -> tuple[Stage, ...]:
    """Of all ways to cut levels into so many runs of one size that with the fewest slots.

    A run of several levels, which is a loop, hands on as many slots as it has: later levels find room in it.

    Args:
        capacities: what each level needs.
        runs: how many, from 1 to the number of levels.
    """

    @functools.cache
    def best(first: int, runs: int) -> tuple[int, tuple[Stage, ...]]:
        """The fewest slots, and the stages, of the levels from one on."""
        ends = [len(capacities)] if runs == 1 else range(first + 1, len(capacities) - runs + 2)
        found = []
        for end in ends:
            size = max(capacities[first : end if end - first == 1 else None])
            slots, stages = best(end, runs - 1) if runs > 1 else (0, ())
            found.append((slots + size * (end - first), (Stage(size, end - first), *stages)))
        return min(found, key=lambda one: one[0])

    return best(0, runs)[1]


def too_many(plan: Plan, wanted: Int[Array, " levels"]) -> Int[Array, ""]:
    """How many rays found no room, summed over levels, in the tile that wanted most."""
    capacities = jnp.asarray((*plan.capacities[1:], 0)[: wanted.shape[0]], jnp.int32)
    return jnp.sum(jnp.maximum(wanted - capacities, 0))


def tile_layout(window: tuple[int, int, int, int]) -> tuple[int, int]:
    """Number of tiles and camera rays in each: tiles that stay in a CPU's cache, or fill a GPU."""
    _, _, width, height = window
    devices = jax.device_count()
    target = 4096 if jax.default_backend() == "cpu" else 1 << 17
    tiles = devices * math.ceil(width * height / (devices * target))
    # Stepping through the pixels by a number that shares no factor with the width spreads a tile over all columns.
    while math.gcd(tiles, width) > devices:
        tiles += devices
    return tiles, BLOCK * math.ceil(width * height / (tiles * BLOCK))


def tile_pixels(
    tile: Int[Array, ""], plan: Plan, window: tuple[int, int, int, int]
) -> tuple[Int[Array, " rays"], Int[Array, " rays"], Bool[Array, " rays"]]:
    """Column and row in the whole picture of each camera ray of a tile, and whether it is one of the window's."""
    x, y, width, height = window
    place = jnp.arange(plan.stages[0].capacity, dtype=jnp.int32)
    number = place * plan.tiles + tile
    live = (place < plan.tile_size) & (number < width * height)
    return x + number % width, y + number // width, live


def count_rays(scene: Scene, settings: ResolvedSettings) -> Float[np.ndarray, " levels"]:
    """For each level after the first, about how many rays it has for each camera ray."""
    return count_levels(*probe_camera(scene, settings), settings=settings)


@functools.partial(jit, static_argnames="settings")
def probe_camera(scene: Scene, settings: ResolvedSettings) -> tuple[World, Rays, Bool[Array, " rays"]]:
    """The world and a choice of camera rays, spread over the picture; one program, not one for each operation."""
    window = settings.window(scene.camera.pixeldim)
    stride = max(1, window[2] * window[3] // PROBE)
    while math.gcd(stride, window[2]) != 1:
        stride += 1
    layout = Plan(stride, PROBE, (Stage(PROBE, 1),))
    column, row, live = tile_pixels(jnp.asarray(0), layout, window)
    dtype = scene.camera.viewpoint.dtype
    rays = camera_rays(scene.camera, settings, column.astype(dtype), row.astype(dtype))
    return prepare_world(scene, settings), rays, live


@functools.partial(jit, static_argnames="settings")
def probe_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], number: Int[Array, ""], settings: ResolvedSettings
) -> tuple[Rays, Bool[Array, " rays"], Int[Array, ""]]:
    """Trace one level without shading; return an even choice of its children that fits, and their true number."""
    kinds = trace_level(world, rays, live, number, settings).children
    wanted = jnp.stack([kind for kind, _ in kinds])
    everything = pack(wanted, wanted.size)
    # Of more children than fit keep every n-th: those at which this share of the running number steps up.
    keep = jnp.minimum(1, PROBE / jnp.maximum(everything.count, 1).astype(jnp.float32))
    rank = jnp.where(wanted, everything.slot, 0).astype(jnp.float32)
    chosen = wanted & (jnp.floor((rank + 1) * keep) > jnp.floor(rank * keep))
    rays, packing = pack_rays([(kind, rays) for kind, (_, rays) in zip(chosen, kinds, strict=True)], PROBE)
    return rays, packing.live, everything.count


def of_rays(settings: ResolvedSettings) -> ResolvedSettings:
    """The settings as far as they matter to rays: where the pixels are, and how large, the rays know themselves."""
    samples = settings.samples if settings.edges == "aware" else 1
    return dataclasses.replace(settings, size=None, crop=None, binning=1, mapping="corner", aov=(), samples=samples)


def count_levels(
    world: World, rays: Rays, live: Bool[Array, " rays"], settings: ResolvedSettings
) -> Float[np.ndarray, " levels"]:
    """For each level after the first, about how many rays it has for each of the camera's, of which some are given."""
    if not world.shapes.kinds:
        return np.zeros(settings.levels)
    traced = of_rays(settings)
    share = np.zeros(settings.levels)
    weight = 1 / max(1, int(jnp.sum(live)))
    for level in range(settings.levels):
        rays, live, count = probe_level(world, rays, live, jnp.asarray(level, jnp.int32), traced)
        share[level] = weight * int(count)
        weight *= max(1.0, int(count) / PROBE)
        if not count:
            break
    return share
