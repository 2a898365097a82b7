"""The picture of the scene that is fitted, and its derivatives by the unknowns: all that a fit traces and develops.

The scene's light is traced with the derivatives by the numbers that it depends on; what the film makes of it, with its
own numbers, follows from that picture without a ray.
"""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from raytrace_jax.images.filters import gaussian_blur
from raytrace_jax.inverse.problem.observation import Observation
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.film import FilmResponse, Frame, develop
from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.programs.plan import Plan, Wanted
from raytrace_jax.tracer.programs.tiles import render_planned
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.compilation import jit

RANK = 1e-6
"""Of the largest: a smaller eigenvalue of normal equations in columns of length one is rounding."""


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


@functools.partial(jit, static_argnames=("unknowns", "frame"))
def develop_picture(
    picture: Picture, y: Float[Array, " parameters"], scene: Scene, unknowns: Unknowns, frame: Frame
) -> Picture:
    """What a film makes of a picture, and its derivatives by all unknowns.

    Args:
        picture: of the scene's light, with the derivatives by the unknowns that are not the film's.
        y: all unknowns.
        scene: gives the film, with None for effects that do nothing.
        unknowns: what is free.
        frame: which part of the whole picture it is.
    """
    places = np.array(unknowns.light_places, int)
    columns = jnp.zeros((len(unknowns.names), *picture.image.shape), picture.image.dtype)
    columns = columns.at[places].set(picture.columns)

    def developed(image, y):
        film = unknowns.scene(scene, unknowns.values(y)).film
        return develop(image, film, frame)

    def derivative(column, direction):
        return jax.jvp(developed, (picture.image, y), (column, direction))

    image, columns = jax.vmap(derivative, out_axes=(None, 0))(columns, jnp.eye(len(unknowns.names), dtype=y.dtype))
    return Picture(image, columns)


@functools.partial(jit, static_argnames=("unknowns", "frame", "linear"))
def develop_best(
    rows: Float[Array, "pictures parameters"],
    lights: Float[Array, "pictures 3 height width"],
    scene: Scene,
    observation: Observation,
    blur: Float[Array, ""],
    unknowns: Unknowns,
    frame: Frame,
    linear: tuple[int, ...],
) -> tuple[Float[Array, "pictures parameters"], Float[Array, "pictures 3 height width"]]:
    """Values that bring each picture nearest to the target, and the pictures.

    Of the values those change in which the picture is linear: their best ones have a closed form, that of least
    squares.

    Args:
        rows, lights: values of the free parameters and the picture of the light, for each.
        scene, unknowns, frame: as for `develop_picture`.
        observation: the target and its weights.
        blur: standard deviation of a blur, in pixels, with which they are compared.
        linear: the places of the numbers that may change.
    """
    places = np.array(linear, int)

    def best(row, light):
        def developed(numbers):
            film = unknowns.scene(scene, row.at[places].set(numbers)).film
            return develop(light, film, frame)

        def residual(numbers):
            return gaussian_blur(observation.residual(developed(numbers)), blur).reshape(-1)

        numbers = row[places]
        if linear:
            jacobian = jax.jacfwd(residual)(numbers)
            normal, right = jacobian.T @ jacobian, jacobian.T @ residual(numbers)
            # What a picture leaves open, such as the gain of a black one, stays.
            length = jnp.sqrt(jnp.diagonal(normal))
            length = jnp.where(length > 0, length, 1)
            step = jnp.linalg.pinv(normal / jnp.outer(length, length), rtol=RANK) @ (right / length) / length
            # A picture that would have to be turned into its negative is compared as it is.
            least, most = jnp.asarray(unknowns.limits, row.dtype)[:, places]
            moved = numbers - step
            numbers = jnp.where(jnp.all((moved > least) & (moved < most)), moved, numbers)
        return row.at[places].set(numbers), developed(numbers)

    return jax.vmap(best)(rows, lights)


@functools.partial(jit, static_argnames="frame")
def develop_changes(
    image: Float[Array, "3 height width"],
    changes: Float[Array, "changes 3 height width"],
    film: FilmResponse,
    frame: Frame,
) -> Float[Array, "changes 3 height width"]:
    """How much what the film makes of a picture changes with small changes of the picture."""
    _, push = jax.linearize(lambda image: develop(image, film, frame), image)
    return jax.lax.map(push, changes)
