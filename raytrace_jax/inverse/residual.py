"""How far a rendered picture is from the target, and how that changes with the free parameters."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .._compile import jit
from ..parameters import set_parameters
from ..plan import Plan
from ..render import render_planned
from ..scene import Scene
from ..settings import RenderSettings
from .pyramid import blur
from .transforms import Transform, to_values


class Linearization(eqx.Module):
    """A least-squares problem near one point, rotated into as few numbers as it has.

    With `[J r] = Q R` the triangle `R` has the same `J^T J`, `J^T r` and `|r|` as the whole picture: a solver that is
    given its columns takes exactly the steps that it would take with millions of rows.

    Args:
        jacobian: derivative of the rotated residuals with respect to the unknowns.
        residual: the rotated residuals.
        wanted: the most rays that a tile wanted, for each level of the plan.
    """

    jacobian: Float[Array, "rows parameters"]
    residual: Float[Array, " rows"]
    wanted: Int[Array, " levels"]


def residual_image(
    y: Float[Array, " parameters"],
    scene: Scene,
    target: Float[Array, "3 height width"],
    sigma: Float[Array, ""],
    names: tuple[str, ...],
    transforms: tuple[Transform, ...],
    settings: RenderSettings,
    plan: Plan,
) -> tuple[Float[Array, "3 height width"], Int[Array, " levels"]]:
    """Picture minus target, blurred; and the plan's ray counts.

    Args:
        y: the unknowns of the free parameters `names`.
        scene: gives all that is not free.
        target: the target picture.
        sigma: standard deviation of the blur in pixels.
        names, transforms: the free scalar parameters, and how they follow from `y`.
        settings, plan: what to render, and the sizes of the tracer's arrays.
    """
    values = to_values(transforms, y)
    scene = set_parameters(scene, {name: values[k] for k, name in enumerate(names)})
    film, wanted = render_planned(scene, settings, plan)
    return blur(film.image - target, sigma), wanted


@functools.partial(jit, static_argnames=("names", "transforms", "settings", "plan"))
def linearize(
    y: Float[Array, " parameters"],
    scene: Scene,
    target: Float[Array, "3 height width"],
    sigma: Float[Array, ""],
    names: tuple[str, ...],
    transforms: tuple[Transform, ...],
    settings: RenderSettings,
    plan: Plan,
) -> Linearization:
    """Residual and Jacobian of `residual_image` at `y` in one forward pass, as a `Linearization`."""

    def image(y):
        return residual_image(y, scene, target, sigma, names, transforms, settings, plan)

    def derivative(direction):
        return jax.jvp(image, (y,), (direction,), has_aux=True)

    residual, columns, wanted = jax.vmap(derivative, out_axes=(None, 0, None))(jnp.eye(len(names), dtype=y.dtype))
    system = jnp.concatenate([columns.reshape(len(names), -1), residual.reshape(1, -1)]).T
    triangle = jnp.linalg.qr(system, mode="r")
    # The signs of the rows are arbitrary: fix them, so that residuals of successive steps can be compared.
    triangle = triangle * jnp.where(jnp.diagonal(triangle) < 0, -1, 1)[:, None]
    return Linearization(triangle[:, :-1], triangle[:, -1], wanted)
