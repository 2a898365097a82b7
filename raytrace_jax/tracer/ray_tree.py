"""The rays of one pixel as a tree of nodes."""

import functools
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..errors import RaytraceError, SettingsError
from ..optics import refract
from ..scene.scene import Scene
from ..util.compilation import jit
from ..util.numerics import dot
from .geometry.camera import picture_place, pixel_step
from .geometry.rays import NO_SHAPE, unpacked
from .geometry.shape_types import face_owners
from .integrator import RAYS_A_PLACE, Wavefront, trace_queue
from .level import MODELS
from .settings import RenderSettings, ResolvedSettings, resolve_settings
from .shading.model import materials_at
from .world import prepare_world

RayKind = Literal["camera", "reflected", "transmitted"]
KINDS: tuple[RayKind, ...] = ("reflected", "transmitted")


class RayNode(NamedTuple):
    """A ray, what it hits, and the colour that it brings back."""

    number: int  # Its place in the tree; parents come before their children, and 0 is the camera's ray.
    parent: int | None
    kind: RayKind
    bounce: int  # How many rays lie before it on its path.
    weight: float  # About how much its colour counts in the pixel's: the product of the weights along its path.
    o: Float[np.ndarray, "3"]  # Where it starts, world units.
    d: Float[np.ndarray, "3"]
    p: Float[np.ndarray, "3"]
    n: Float[np.ndarray, "3"]
    distance: float  # From `o` to `p`, world units.
    path_length: float  # Of the whole path from the viewpoint to `p`; ambient light falls off with it.
    color: Float[np.ndarray, "3"]  # What the ray brings back, scene-linear RGB.
    shape: str | None = None  # The one that it hits; if None, `p`, `n`, lengths and what follows have no meaning.
    entering: bool = False  # Whether it comes from the side that the normal points to.
    theta_i: float = 0.0  # Angle of incidence in radians, 0 to pi / 2.
    theta_t: float | None = None  # Angle of refraction in radians; None where nothing is transmitted.
    total: bool = False  # Whether there is total internal reflection.
    reflect: float = 0.0  # Weight of the reflected ray in this one's colour, of the largest channel; 0 if none.
    transmit: float = 0.0
    medium: str | None = None  # The shape whose glass it runs through; None in vacuum, and in models without media.
    absorbed: float = 0.0  # The share of its radiance that is absorbed there, the mean of the channels.


class RayTree(NamedTuple):
    pixel: tuple[int, int]  # Column and row, from the top left of the picture.
    nodes: tuple[RayNode, ...]  # The rays, level by level; the first is the camera's and has the pixel's colour.
    dropped: int  # How many more rays were wanted after the last bounce that the settings allow; they count as black.


def trace_tree(scene: Scene, pixel: tuple[int, int], settings: RenderSettings | None = None) -> RayTree:
    """Trace one pixel of a picture and keep every ray.

    The colour of the first ray is that of the pixel in `render(scene, settings)`, up to rounding.

    Args:
        pixel: column and row, counted in the whole picture from its top left, also where the settings have a crop.
        settings: what to render, one sample a pixel, without awareness of edges; None is what the scene's file says.

    Raises:
        SettingsError: a pixel or a crop outside of the picture, or settings for which a pixel is not one ray.
        RaytraceError: more than 8192 rays.
    """
    settings = resolve_settings(scene, settings)
    x, y, width, height = settings.window(scene.camera.pixeldim)
    column, row = pixel
    if not (x <= column < x + width and y <= row < y + height):
        where = f"columns are {x} to {x + width - 1}, rows are {y} to {y + height - 1}"
        raise SettingsError(f"pixel {column} {row} does not lie in the picture: {where}.")
    if settings.samples != 1:
        raise SettingsError(f"samples is {settings.samples}; a tree of rays is that of one sample.")
    if settings.edges == "aware":
        raise SettingsError(f"edges is {settings.edges!r}; a tree of rays is that of a point.")

    # More rays could not be read, and double with each further bounce.
    most = 8192
    tail, arrays = jax.tree.map(np.asarray, _queue_of(scene.alone(), float(column), float(row), settings, most))
    if tail > most:
        raise RaytraceError(f"the tree has more than {most} rays; allow fewer bounces.")
    arrays = {name: values[..., :tail] for name, values in arrays.items()}
    dropped = int(np.sum(arrays["wanted"] & (arrays["number"] == settings.levels)))
    return RayTree((column, row), _as_nodes(arrays, [name for name, _ in face_owners(scene)]), dropped)


@functools.partial(jit, static_argnames=("settings", "most"))
def _queue_of(
    scene: Scene, column: Float[Array, ""], row: Float[Array, ""], settings: ResolvedSettings, most: int
) -> tuple[Int[Array, ""], dict[str, Array]]:
    camera, world = scene.camera, prepare_world(scene, settings)
    dtype, step = camera.viewpoint.dtype, pixel_step(camera, settings)
    place = jnp.stack([jnp.full(most // RAYS_A_PLACE, x, dtype) for x in (column, row)])
    points = jnp.stack(picture_place(camera, settings, *place))
    queue, results = trace_queue(Wavefront(world, camera, points, jnp.asarray(step, dtype), 1, True))
    rays, record, si = unpacked(queue.rays), queue.traced, queue.traced.si
    assert si is not None
    arrays = {"number": queue.rays.number, "color": results.color, "o": rays.o, "d": rays.d, "valid": record.valid}
    arrays |= {"shape": si.shape, "p": si.p, "n": si.n, "distance": si.t, "path_length": si.path_length}
    surface = record.scattering.surface
    if surface is None or record.wanted is None:  # An empty scene.
        nothing = jnp.zeros((0, record.valid.size), bool)
        return queue.tail, arrays | {"children": nothing, "wanted": nothing}

    # What the tracer does not keep: angles, weights and media.
    model, d_dot_n = MODELS[settings.model], dot(rays.d, si.n)
    media = model.media(world, si, d_dot_n < 0)
    _, cos_theta_t, total = refract(rays.d, si.n, media.eta)
    transparent = si.valid & (model.transparency(materials_at(world, si)) > 0)
    reflect, transmit = jnp.where(record.wanted, jnp.stack(surface.child_weights()), 0)
    arrays |= {"children": record.children, "wanted": record.wanted, "entering": d_dot_n < 0}
    arrays |= {"theta_i": jnp.arccos(jnp.clip(jnp.abs(d_dot_n), 0, 1)), "total": total & transparent}
    arrays |= {"theta_t": jnp.where(transparent & ~total, jnp.arccos(jnp.clip(cos_theta_t, -1, 1)), -1)}
    arrays |= {"reflect": reflect, "transmit": transmit}
    if media.transmittance is not None and media.front is not None:
        arrays |= {"medium": media.front, "absorbed": 1 - jnp.mean(media.transmittance, axis=0)}
    return queue.tail, arrays


def _as_nodes(arrays: dict[str, np.ndarray], names: Sequence[str]) -> tuple[RayNode, ...]:
    """The rays of a queue as nodes, level by level; what is told of a hit is nothing where there is none."""
    nodes: list[RayNode] = []
    # Whose child sits in which place of the queue; parents come before their children.
    origins: dict[int, tuple[int | None, RayKind]] = {0: (None, "camera")}
    for number, place in enumerate(np.argsort(arrays["number"], kind="stable").tolist()):
        ray = {name: values[..., place] for name, values in arrays.items()}
        origins |= {child: (number, kind) for child, kind in zip(ray["children"].tolist(), KINDS, strict=False)}
        parent, kind = origins[place]
        # Its weight is its parent's times what the parent sends its way.
        above = None if parent is None else nodes[parent]
        weight = above.weight * (above.reflect if kind == "reflected" else above.transmit) if above else 1.0
        fields: dict[str, Any] = {name: ray[name] for name in ("o", "d", "p", "n", "color")}
        fields |= {name: ray[name].item() for name in ("distance", "path_length")}
        if ray["valid"]:
            fields |= {name: ray[name].item() for name in ("entering", "theta_i", "total", "reflect", "transmit")}
            fields |= {
                "shape": names[ray["shape"].item()],
                "theta_t": ray["theta_t"].item() if ray["theta_t"] >= 0 else None,
            }
            if ray.get("medium", NO_SHAPE) != NO_SHAPE:
                fields |= {"medium": names[ray["medium"].item()], "absorbed": ray["absorbed"].item()}
        nodes.append(RayNode(number, parent, kind, ray["number"].item(), weight, **fields))
    return tuple(nodes)
