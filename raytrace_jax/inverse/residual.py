"""How far a rendered picture is from the target, and how that changes with the free parameters."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

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
        rms: root mean square of the residuals, blurred but before any loss.
        typical: median of the residuals' magnitude where the picture depends on the parameters at all.
        wanted: the most rays that a tile wanted, for each level of the plan.
    """

    jacobian: Float[Array, "rows parameters"]
    residual: Float[Array, " rows"]
    rms: Float[Array, ""]
    typical: Float[Array, ""]
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


def cauchy(residual: Float[Array, "*any"], scale: Float[Array, ""]) -> Float[Array, "*any"]:
    """Residuals whose sum of squares is the Cauchy loss, `scale^2 log(1 + (residual / scale)^2)`.

    Small residuals stay as they are, large ones count less and less; an infinite scale leaves all alone. 2.385
    standard deviations keep 95 % of the efficiency of least squares on Gaussian noise (Holland and Welsch 1977).
    """
    finite = jnp.isfinite(scale)
    squared = (residual / jnp.where(finite, scale, 1)) ** 2
    large = squared > 1e-8
    shrink = jnp.sqrt(jnp.log1p(jnp.where(large, squared, 1)) / jnp.where(large, squared, 1))
    return jnp.where(finite & large, residual * shrink, residual)


@functools.partial(jit, static_argnames=("names", "transforms", "settings", "plan"))
def linearize(
    y: Float[Array, " parameters"],
    scene: Scene,
    target: Float[Array, "3 height width"],
    sigma: Float[Array, ""],
    loss_scale: Float[Array, ""],
    names: tuple[str, ...],
    transforms: tuple[Transform, ...],
    settings: RenderSettings,
    plan: Plan,
) -> Linearization:
    """Residual and Jacobian of `residual_image` at `y` in one forward pass, as a `Linearization`.

    Args:
        y, scene, target, sigma, names, transforms, settings, plan: as for `residual_image`.
        loss_scale: scale of the Cauchy loss; infinity for plain least squares.
    """

    def image(y):
        return residual_image(y, scene, target, sigma, names, transforms, settings, plan)

    def derivative(direction):
        return jax.jvp(image, (y,), (direction,), has_aux=True)

    residual, columns, wanted = jax.vmap(derivative, out_axes=(None, 0, None))(jnp.eye(len(names), dtype=y.dtype))
    rms = jnp.sqrt(jnp.mean(residual * residual))
    typical = typical_magnitude(residual, jnp.any(columns != 0, axis=0))

    residual, slope = jax.jvp(lambda r: cauchy(r, loss_scale), (residual,), (jnp.ones_like(residual),))
    system = jnp.concatenate([(columns * slope).reshape(len(names), -1), residual.reshape(1, -1)]).T
    triangle = jnp.linalg.qr(system, mode="r")
    # The signs of the rows are arbitrary: fix them, so that residuals of successive steps can be compared.
    triangle = triangle * jnp.where(jnp.diagonal(triangle) < 0, -1, 1)[:, None].astype(y.dtype)
    return Linearization(triangle[:, :-1], triangle[:, -1], rms, typical, wanted)


def typical_magnitude(residual: Float[Array, "3 height width"], matters: Bool[Array, "3 height width"]):
    """Median magnitude of the residuals that matter, from a sample of them (every seventh; sorting is slow)."""
    sample = jnp.where(matters, jnp.abs(residual), jnp.inf).reshape(-1)[::7]
    count = jnp.sum(jnp.isfinite(sample), dtype=jnp.int32)
    return jnp.where(count > 0, jnp.sort(sample)[count // 2], 0)
