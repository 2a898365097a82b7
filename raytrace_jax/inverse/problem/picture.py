"""The picture of the scene that is fitted, and its derivatives by the unknowns: all that a fit traces."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.programs.plan import Plan, Wanted
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.compilation import jit


class Picture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        image: the picture.
        columns: its derivative with respect to each of the unknowns.
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Trace.sees_edge`; else None.
    """

    image: Float[Array, "3 height width"]
    columns: Float[Array, "parameters 3 height width"]
    sees_edge: Bool[np.ndarray, "height width"] | None = None


def rendered_picture(
    values: Float[Array, " parameters"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings, plan: Plan
) -> tuple[Float[Array, "3 height width"], Wanted]:
    """The picture with free parameters of these values, and the plan's ray counts.

    Args:
        values: of the free parameters.
        scene: gives all that is not free.
        unknowns: what is free.
        settings, plan: what to render, and the sizes of the tracer's arrays.
    """
    film, wanted = render_planned(unknowns.scene(scene, values), settings, plan)
    return film.image, wanted


@functools.partial(jit, static_argnames=("unknowns", "settings", "plan"))
def differentiate(
    y: Float[Array, " parameters"], scene: Scene, unknowns: Unknowns, settings: ResolvedSettings, plan: Plan
) -> tuple[Picture, Wanted]:
    """Picture and derivatives at the unknowns `y` in one forward pass, and the plan's ray counts.

    What a picture is compared with, and how, is not in it: no part of a comparison makes another program of it.
    """

    def picture(y):
        return rendered_picture(unknowns.values(y), scene, unknowns, settings, plan)

    def derivative(direction):
        return jax.jvp(picture, (y,), (direction,), has_aux=True)

    image, columns, wanted = jax.vmap(derivative, out_axes=(None, 0, None))(jnp.eye(len(unknowns.names), dtype=y.dtype))
    return Picture(image, columns), wanted
