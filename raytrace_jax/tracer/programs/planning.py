"""How many rays a picture has at each level, counted on a sparse sample of it, and the plan that holds them."""

import dataclasses
import functools
import math
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.camera import camera_rays
from raytrace_jax.tracer.geometry.rays import Rays
from raytrace_jax.tracer.levels.compaction import pack
from raytrace_jax.tracer.levels.level import trace_level
from raytrace_jax.tracer.levels.wavefront import Stage, pack_rays
from raytrace_jax.tracer.programs.plan import FEW_RUNS, SLACK, Plan, Shares, make_plan, tile_layout, tile_pixels
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, WholeSettings, resolve_settings
from raytrace_jax.tracer.settings import RenderSettings
from raytrace_jax.tracer.world import MOST_SHAPES, World, prepare_world
from raytrace_jax.util.compilation import jit

MOVING_SLACK = 1.3
"""Room for the rays that a scene may grow while its parameters move, before the tracer must be compiled anew."""

PROBE = 4096
"""How many rays the planning pass follows at each level."""

LEAST_LISTED = 40_000
"""In pictures with fewer pixels all are traced edge-aware: two kinds of levels take longer to compile than that saves.

For POV-Ray's checker, 160 x 120, the steps of a search took as long with a list as without, and compiling, in two cold
fits that ran side by side, took 134 s instead of 95."""

MOST_LISTED = 0.2
"""Where a larger share of the pixels sees an edge, they are not listed: a list would gain nothing.

With a list POV-Ray's checker, 640 x 480, where a fiftieth sees one, takes 0.61 times as long; the course's scene, where
a seventh does and has most of the rays, 0.8 times; at 320 x 240, where a quarter does, as long as without."""


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
        settings: what will be rendered; None is what the scene's file says. Where they do not say `edges`, the plan has
            room for the picture's derivative too.
        slack: room for more rays than were counted, as a factor. Ask for more before an optimisation that moves the
            scene.
        others: scenes of the same structure whose rays the sizes have to hold as well.
        runs: how many programs the levels may be, at most. One compiles soonest, a loop over levels of one size; with
            more the deeper levels take fewer slots, and less time. None is up to six of a
            point-sampled picture, and two of an edge-aware one.

    Returns:
        The plan, for `render` and its like.
    """
    settings = resolve_settings(scene, settings)
    derivative = None
    if settings.edges is None and len(scene.shape_order) <= MOST_SHAPES:
        derivative = plan_render(scene, settings.of_derivative, slack, others, 1)
    settings = settings.of_points
    window = settings.window(scene.camera.pixeldim)
    probes = [probe_camera(one, settings) for one in (scene, *others)]
    shares = count_shares(probes, settings, window[2] * window[3])
    plan = make_plan(*tile_layout(window), shares, slack, settings, runs)
    return dataclasses.replace(plan, derivative=derivative)


def few_runs(scene: Scene, settings: ResolvedSettings) -> int:
    """How many runs are best for the levels of a picture that is traced a few times."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    # Up to 100,000 pixels one run saves more time of compiling than it costs in tracing. Edge-aware pictures gain at
    # any size: 640 x 480 pixels compile in 6.1 s instead of 9.5 and take 1.1 s instead of 0.8.
    return 1 if settings.edges == "aware" or width * height <= 100_000 else FEW_RUNS


class Probe(NamedTuple):
    """Some camera rays to count from: the world, the rays, and which of them count."""

    world: World
    rays: Rays
    live: Bool[Array, " rays"]


@functools.partial(jit, static_argnames="settings")
def probe_camera(scene: Scene, settings: ResolvedSettings) -> Probe:
    """The world and a choice of camera rays, spread over the picture; one program, not one for each operation."""
    window = settings.window(scene.camera.pixeldim)
    stride = max(1, window[2] * window[3] // PROBE)
    while math.gcd(stride, window[2]) != 1:
        stride += 1
    layout = Plan(stride, PROBE, (Stage(PROBE, 1),))
    column, row, live = tile_pixels(jnp.asarray(0), layout, window)
    dtype = scene.camera.viewpoint.dtype
    rays = camera_rays(scene.camera, settings, column.astype(dtype), row.astype(dtype))
    return Probe(prepare_world(scene, settings), rays, live)


class ProbedLevel(NamedTuple):
    """One level of a probe.

    Args:
        children: an even choice of the rays that it sends on, which fits.
        live: which of them count.
        parent: the ray that sent each of them.
        total: how many there are in truth.
        sees_edge: which of the level's own rays see an edge; None where that is not asked.
    """

    children: Rays
    live: Bool[Array, " slots"]
    parent: Int[Array, " slots"]
    total: Int[Array, ""]
    sees_edge: Bool[Array, " rays"] | None


@functools.partial(jit, static_argnames="settings")
def probe_level(
    world: World, rays: Rays, live: Bool[Array, " rays"], number: Int[Array, ""], settings: ResolvedSettings
) -> ProbedLevel:
    """Trace one level without shading."""
    level = trace_level(world, rays, live, number, settings)
    wanted = jnp.stack([kind for kind, _ in level.children])
    everything = pack(wanted, wanted.size)
    # Of more children than fit keep every n-th: those at which this share of the running number steps up.
    keep = jnp.minimum(1, PROBE / jnp.maximum(everything.count, 1).astype(jnp.float32))
    rank = jnp.where(wanted, everything.slot, 0).astype(jnp.float32)
    chosen = wanted & (jnp.floor((rank + 1) * keep) > jnp.floor(rank * keep))
    kinds = [(kind, children) for kind, (_, children) in zip(chosen, level.children, strict=True)]
    children, packing = pack_rays(kinds, PROBE)
    parent = packing.candidate % live.shape[0]
    return ProbedLevel(children, packing.live, parent, everything.count, level.sees_edge)


def of_rays(settings: ResolvedSettings) -> ResolvedSettings:
    """The settings as far as they matter to rays: where the pixels are, and how large, the rays know themselves."""
    samples = settings.samples if settings.edges == "aware" else 1
    return dataclasses.replace(settings, size=None, crop=None, binning=1, mapping="corner", aov=(), samples=samples)


def count_shares(probes: Sequence[Probe], settings: ResolvedSettings, pixels: int) -> Shares:
    """About how many rays there are for each camera ray, in the scene that has most.

    Args:
        probes: some camera rays of each scene.
        settings: what is rendered.
        pixels: of how many pixels; of many those that see an edge are counted apart, if they are few enough.
    """
    if settings.edges == "aware" and pixels >= LEAST_LISTED:
        whole = WholeSettings.of(settings)
        counts = [count_levels(probe, whole) for probe in probes]
        shares = [np.sum(sees) / max(1, np.sum(probe.live)) for probe, (_, sees) in zip(probes, counts, strict=True)]
        if max(shares) <= MOST_LISTED:
            listed = [probe._replace(live=jnp.asarray(sees)) for probe, (_, sees) in zip(probes, counts, strict=True)]
            further = [share * count_levels(probe, settings)[0] for share, probe in zip(shares, listed, strict=True)]
            levels = functools.reduce(np.maximum, (levels for levels, _ in counts))
            return Shares(levels, np.append(max(shares), functools.reduce(np.maximum, further)))
    return Shares(functools.reduce(np.maximum, (count_levels(probe, settings)[0] for probe in probes)))


def count_levels(
    probe: Probe, settings: ResolvedSettings
) -> tuple[Float[np.ndarray, " levels"], Bool[np.ndarray, " rays"]]:
    """Count the rays of each level on some of the camera's rays.

    Returns:
        About how many rays each level after the first has for each of the camera's; and which of the given ones see an
        edge, as `Trace.sees_edge`: none where that is not asked.
    """
    world, rays, live = probe
    share, sees_edge = np.zeros(settings.levels), np.zeros(live.shape, bool)
    if not world.shapes.kinds:
        return share, sees_edge
    traced = of_rays(settings)
    weight = 1 / max(1, int(jnp.sum(live)))
    pixel = np.arange(len(sees_edge))
    for number in range(settings.levels + (not settings.splits)):
        level = probe_level(world, rays, live, jnp.asarray(number, jnp.int32), traced)
        if level.sees_edge is not None:
            sees_edge[pixel[np.asarray(level.sees_edge)]] = True
        if number < settings.levels:
            share[number] = weight * int(level.total)
        rays, live, pixel = level.children, level.live, pixel[np.asarray(level.parent)]
        weight *= max(1.0, int(level.total) / PROBE)
        if not level.total:
            break
    return share, sees_edge
