"""How a picture is cut into tiles, and how many rays each level of a tile has to hold.

`planning` counts them. A tile is not a rectangle but a sparse lattice over the whole picture, so that every tile has
nearly the same share of glass and of background: one set of capacities fits all of them tightly.
"""

import dataclasses
import functools
import math
import os
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.tracer.levels.compaction import BLOCK
from raytrace_jax.tracer.levels.wavefront import Stage
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

FEW_RUNS = 2
"""Into how many runs of one size levels are cut where a program more takes longer to compile than it saves.

Point-sampled pictures of 640 x 480 pixels compile in 3.4 s instead of 8.1 and take 11 % longer; with derivatives by
four numbers they compile in 8.8 s instead of 20 and take 30 % longer. One run compiles in 2.4 and 6.3 s, and takes 60 %
longer."""

SLACK = 1.06
"""Room for the rays that were counted, as a factor: counts of a sample or of another tile are off by a few percent."""


@dataclasses.dataclass(frozen=True)
class Plan:
    """The static sizes of a render.

    Args:
        tiles: number of tiles, a multiple of the number of devices.
        tile_size: camera rays in a tile.
        stages: the levels' capacities, from the camera rays on.
        runs: into how many stages the levels are cut at most; None is as many as are usual.
        on_all_devices: whether the devices share the tiles; else one of them traces all.
        edges: where only the pixels that see an edge are traced edge-aware, the capacities of their rays, from the
            camera's on; those of `stages` hold the whole areas then. None where every pixel is traced alike.
        derivative: the sizes for the derivative of a picture by points, which is that of areas; None where the
            derivative is the picture's own, or edge-aware tracing cannot take the scene.
    """

    tiles: int
    tile_size: int
    stages: tuple[Stage, ...]
    runs: int | None = None
    on_all_devices: bool = True
    edges: tuple[Stage, ...] | None = None
    derivative: "Plan | None" = None

    def for_loops(self) -> "Plan":
        """The plan for programs of others, which may start the next program before this one has ended."""
        derivative = self.derivative and self.derivative.for_loops()
        return dataclasses.replace(self, on_all_devices=can_share_loops(), derivative=derivative)

    @property
    def capacities(self) -> tuple[int, ...]:
        """Rays that each level can hold, from the camera rays on."""
        return level_capacities(self.stages)


class Wanted(NamedTuple):
    """How many rays were to be traced, in a tile or in the one that wanted most.

    Args:
        levels: at each level after the first.
        edges: where a plan has `edges`, how many pixels see one, and how many rays they wanted at each further level.
    """

    levels: Int[Array, " levels"]
    edges: Int[Array, " more"] | None = None


class Shares(NamedTuple):
    """How many rays there are for each camera ray; the fields are those of `Wanted`."""

    levels: Float[np.ndarray, " levels"]
    edges: Float[np.ndarray, " more"] | None = None


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


def level_capacities(stages: tuple[Stage, ...]) -> tuple[int, ...]:
    """Rays that each level can hold, from the camera rays on."""
    return tuple(stage.capacity for stage in stages for _ in range(stage.levels))


def make_plan(
    tiles: int, tile_size: int, shares: Shares, slack: float, settings: ResolvedSettings, runs: int | None = None
) -> Plan:
    """A plan with room for so many rays; trailing empty levels are left out.

    Args:
        tiles, tile_size: as `Plan` has them.
        shares: how many rays there are for each camera ray.
        slack: room for more rays than these, as a factor.
        settings: what is rendered.
        runs: how many stages at most; None is the usual number. Levels of point-sampled pictures are small programs:
            most get their own size. Edge-aware ones are large: they share sizes.
    """
    # Six runs: each level of the course's five bounces has its own. In a deep tree the last levels, of few rays, share.
    most = runs or (FEW_RUNS if settings.edges == "aware" else 6)

    def make_stages(capacities: list[int]) -> tuple[Stage, ...]:
        return best_runs(tuple(capacities), min(most, len(capacities)))

    stages, edges = make_stages([in_blocks(tile_size), *room(shares.levels, tile_size, slack)]), None
    if shares.edges is not None:
        # A list has a place at least, so that one more is noticed, and no more places than there are pixels.
        listed, *further = room(shares.edges, tile_size, slack) or [BLOCK]
        edges = make_stages([min(listed, in_blocks(tile_size)), *further])
    return Plan(tiles, tile_size, stages, runs, edges=edges)


def room(share: Float[np.ndarray, " levels"], tile_size: int, slack: float) -> list[int]:
    """How many rays of a tile each level should hold, for shares of its camera rays and a slack as a factor."""
    share = np.trim_zeros(share, "b")
    spread = 2 * np.sqrt(share * tile_size) / tile_size  # Lattices differ less than random samples do.
    return [in_blocks(rays) for rays in slack * (share + spread) * tile_size]


def in_blocks(rays: float | int) -> int:
    """A capacity that holds so many rays."""
    return int(BLOCK * math.ceil(rays / BLOCK))


def best_runs(capacities: tuple[int, ...], runs: int) -> tuple[Stage, ...]:
    """The cut of levels into a given number of runs of one size that takes the fewest slots.

    A run of several levels, which is a loop, hands on as many slots as it has: later levels find room in it.

    Args:
        capacities: what each level needs.
        runs: how many, from 1 to the number of levels.
    """

    @functools.cache
    def best(first: int, runs: int) -> tuple[int, tuple[Stage, ...]]:
        """The fewest slots, and the stages, for the levels from `first` on."""
        ends = [len(capacities)] if runs == 1 else range(first + 1, len(capacities) - runs + 2)
        found = []
        for end in ends:
            size = max(capacities[first : end if end - first == 1 else None])
            slots, stages = best(end, runs - 1) if runs > 1 else (0, ())
            found.append((slots + size * (end - first), (Stage(size, end - first), *stages)))
        return min(found, key=lambda one: one[0])

    return best(0, runs)[1]


def too_many(plan: Plan, wanted: Wanted) -> Int[Array, ""]:
    """How many rays, and pixels that see an edge, found no room, summed over levels, in the tile that wanted most."""

    def lacking(capacities: tuple[int, ...], wanted: Int[Array, " levels"]) -> Int[Array, ""]:
        room = jnp.asarray((*capacities, *[0] * wanted.shape[0])[: wanted.shape[0]], jnp.int32)
        return jnp.sum(jnp.maximum(wanted - room, 0))

    missing = lacking(plan.capacities[1:], wanted.levels)
    if wanted.edges is not None and plan.edges is not None:
        missing += lacking(level_capacities(plan.edges), wanted.edges)
    return missing


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
