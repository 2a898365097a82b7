"""The scene of a `model.txt` file as a pytree: struct of arrays, components first, one column an entry.

Units are the file's own (one world unit); the y axis points up. Names, the pixel grid and which material a shape uses
are static; every continuous value is a JAX array, so that any of them can be differentiated. Which block of a file
becomes which of these structs stands in `block_kinds`.
"""

import equinox as eqx
from jaxtyping import Array, Float


class ImagePlaneCamera(eqx.Module):
    """The course's pinhole camera, which looks at the rectangle [0, width] x [0, height] of the plane z = 0.

    Args:
        name: the block's name in the file.
        pixeldim: (width, height) of the picture in pixels.
        worlddim: (width, height) of the image plane in world units.
        viewpoint: where the rays start, (x, y, z) in world units.
    """

    name: str = eqx.field(static=True)
    pixeldim: tuple[int, int] = eqx.field(static=True)
    worlddim: Float[Array, "2"]
    viewpoint: Float[Array, "3"]


class PerspectiveCamera(eqx.Module):
    """A camera with square pixels that looks from a point at a point, through a lens that may distort.

    Args:
        name: the block's name in the file.
        pixeldim: (width, height) of the picture in pixels.
        viewpoint: where the rays start, (x, y, z) in world units.
        lookat: the point that the picture shows at `center`, in world units.
        up: a direction of any length that is upright in the picture.
        fov: the full horizontal angle of view, in degrees, between 0 and 180, of a picture with `center` in its middle
            and without distortion: the focal length is width / (2 tan(fov / 2)) pixels.
        center: the principal point (x, y) in pixels; (0, 0) is the centre of the upper left one.
        distortion: the radial distortion (k1, k2), as in `scene.distortion`.
    """

    name: str = eqx.field(static=True)
    pixeldim: tuple[int, int] = eqx.field(static=True)
    viewpoint: Float[Array, "3"]
    lookat: Float[Array, "3"]
    up: Float[Array, "3"]
    fov: Float[Array, ""]
    center: Float[Array, "2"]
    distortion: Float[Array, "2"]


Camera = ImagePlaneCamera | PerspectiveCamera


class PointLights(eqx.Module):
    """Point lights of a colour `emissivity`.

    In the classic model their light falls off with one over the distance; in the additive one `energy` scales it, and
    it falls off with the distance squared.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    location: Float[Array, "3 lights"]
    emissivity: Float[Array, "3 lights"]
    energy: Float[Array, " lights"]


class Materials(eqx.Module):
    """Surface colours (RGB, scene-linear) and index of refraction `ior` > 0, which both models have; and more.

    Only the classic model has the transparency `alpha` in [0, 1]. Only the additive one has the exponent `hardness` of
    highlights, the weights `reflectivity` of the mirror ray and `transmission` of the refracted one, both in [0, 1],
    and the switch `fresnel`: at 1 Schlick's approximation takes the place of `reflectivity`, between 0 and 1 both are
    mixed.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    ambient: Float[Array, "3 materials"]
    diffuse: Float[Array, "3 materials"]
    specular: Float[Array, "3 materials"]
    alpha: Float[Array, " materials"]
    ior: Float[Array, " materials"]
    hardness: Float[Array, " materials"]
    reflectivity: Float[Array, " materials"]
    fresnel: Float[Array, " materials"]
    transmission: Float[Array, " materials"]


class Planes(eqx.Module):
    """Two-sided planes through `point`; `normal` is kept as the file gives it and need not have length one.

    `material` holds, for each plane, the index of its material.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    normal: Float[Array, "3 planes"]
    point: Float[Array, "3 planes"]


class Spheres(eqx.Module):
    """Spheres with outward normals. `material` holds, for each sphere, the index of its material."""

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    center: Float[Array, "3 spheres"]
    radius: Float[Array, " spheres"]


class Rectangles(eqx.Module):
    """Two-sided rectangles `center + u right + v up` with u and v from -1 to 1.

    `right` and `up` are the vectors from the center to the middles of two sides; they are orthogonal. `material` holds,
    for each rectangle, the index of its material.
    """

    names: tuple[str, ...] = eqx.field(static=True)
    material: tuple[int, ...] = eqx.field(static=True)
    center: Float[Array, "3 rectangles"]
    right: Float[Array, "3 rectangles"]
    up: Float[Array, "3 rectangles"]


class Scene(eqx.Module):
    """All blocks of a `model.txt` file.

    `shape_order` lists the names of all shapes in the order of the file: the course's tracer gives a tie between two
    shapes to the first of them, and the writer keeps this order. A shape's index, as in the film's `shape_index`, is
    its place in this list.
    """

    camera: Camera
    lights: PointLights
    materials: Materials
    planes: Planes
    spheres: Spheres
    rectangles: Rectangles
    shape_order: tuple[str, ...] = eqx.field(static=True)
