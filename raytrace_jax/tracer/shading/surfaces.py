"""What every shading model takes of a scene and gives to the tracer."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from raytrace_jax.scene.scene import Scene
from raytrace_jax.tracer.geometry.shapes import file_order


class ShapeMaterials(eqx.Module):
    """The material of each shape in the order of the file; the same fields as `Materials`, but for the names."""

    ambient: Float[Array, "3 *shapes"]
    diffuse: Float[Array, "3 *shapes"]
    specular: Float[Array, "3 *shapes"]
    alpha: Float[Array, " *shapes"]
    ior: Float[Array, " *shapes"]
    hardness: Float[Array, " *shapes"]
    reflectivity: Float[Array, " *shapes"]
    fresnel: Float[Array, " *shapes"]
    transmission: Float[Array, " *shapes"]


class Children(eqx.Module):
    """The rays that a hit sends on: a reflected and a transmitted one.

    `reflect` and `transmit` say which of them are wanted; each has an origin and a direction. `shape` is the shape that
    was hit, or `NO_SHAPE` if the origins are moved off it; `entering` whether it was hit on the side that its normal
    points to; `path_length` that of the path to the hit.
    """

    reflect: Bool[Array, " *rays"]
    transmit: Bool[Array, " *rays"]
    reflected: Float[Array, "3 *rays"]
    transmitted: Float[Array, "3 *rays"]
    reflected_o: Float[Array, "3 *rays"]
    transmitted_o: Float[Array, "3 *rays"]
    path_length: Float[Array, " *rays"]
    shape: Int[Array, " *rays"]
    entering: Bool[Array, " *rays"]


def shape_materials(scene: Scene) -> ShapeMaterials:
    """The material of every shape, in the order of the file."""
    used = scene.planes.material + scene.spheres.material
    columns = jnp.asarray([used[place] for place in file_order(scene)], jnp.int32)
    fields = [field.name for field in dataclasses.fields(ShapeMaterials)]
    return ShapeMaterials(**{name: getattr(scene.materials, name)[..., columns] for name in fields})
