"""Scenes for the tests of the tracer."""

import functools
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from raytrace_jax import RenderSettings, list_parameters, load_scene, parse_scene, set_parameters
from raytrace_jax.scene.parameters import resolve
from raytrace_jax.tracer.geometry.camera import picture_place, pixel_step, rays_through
from raytrace_jax.tracer.settings import resolve_settings

DATA = Path(__file__).parent.parent / "data"


@functools.cache
def assignment_scene(dtype=jnp.float64):
    return load_scene(DATA / "vitreous.txt", dtype=dtype)


def resolved(**settings):
    """Settings of a picture of the classic model, with nothing left open."""
    return resolve_settings(assignment_scene(), RenderSettings(**settings))


def camera_rays(camera, settings, column, row):
    """Rays through fractional pixel positions."""
    u, v = picture_place(camera, settings, column, row)
    return rays_through(camera, settings, u, v, jnp.asarray(pixel_step(camera, settings), u.dtype))


def random_plane(random, i):
    normal, point = random.normal(size=3), random.uniform([0, 0, -9], [8, 6, -2])
    return f"plane p{i} {{ material m{i} normal {numbers(normal)} point {numbers(point)} }}"


def random_ball(random):
    return random.uniform([0, 0, -6], [8, 6, 0]), random.uniform(0.3, 2.2)


def sphere(i, center, radius):
    return f"sphere s{i} {{ material m{i} center {numbers(center)} radius {numbers([radius])} }}"


def random_scene(seed, planes=2, spheres=4, lights=2, size=(48, 36), camera_inside=None, dtype=None):
    """A scene of glass, mirrors and matt colours; its static structure depends on the numbers of things only.

    `camera_inside` puts the viewpoint into the first sphere; None leaves it to chance.
    """
    random = np.random.default_rng(seed)
    camera = np.array([4, 3, 6]) + random.uniform(-1, 1, 3)
    blocks = [f"camera eye {{ pixeldim {size[0]} {size[1]} worlddim 8 6 viewpoint {numbers(camera)} }}"]
    for i in range(lights):
        location, emissivity = random.uniform([-2, 0, -6], [10, 6, 4]), random.uniform(0, 1, 3)
        blocks.append(f"light l{i} {{ location {numbers(location)} emissivity {numbers(emissivity)} }}")
    shapes = [random_plane(random, i) for i in range(planes)]
    for i in range(planes, planes + spheres):
        center, radius = random_ball(random)
        if i == planes and (random.random() < 0.25 if camera_inside is None else camera_inside):
            center, radius = camera + random.uniform(-0.5, 0.5, 3), random.uniform(1, 4)
        shapes.append(sphere(i, center, radius))
    for i in range(planes + spheres):
        # Each kind of surface is as likely as its absence: matt, mirror, glass and what lies between.
        diffuse, specular = random.uniform(0, 1, (2, 3)) * random.integers(0, 2, (2, 1))
        alpha, ior = random.uniform(0.2, 1) * random.integers(0, 2), random.choice([random.uniform(0.6, 2.4), 1.0])
        blocks.append(
            f"material m{i} {{ ambient {numbers(random.uniform(0, 4, 3))} diffuse {numbers(diffuse)}"
            f" specular {numbers(specular)} alpha {numbers([alpha])} ior {numbers([ior])} }}"
        )
    shapes = np.asarray(shapes, object)
    # Planes and spheres mixed, in an order that is the same for every seed.
    return parse_scene("\n".join([*blocks, *np.random.default_rng(0).permutation(shapes)]), dtype=dtype)


AWKWARD = [
    "concentric",
    "touching",
    "on a plane",
    "grazing",
    "camera in glass",
    "camera on glass",
    "air",
    "bubble",
    "lit",
]
"""What is awkward about an `awkward_scene`."""


def awkward_scene(seed, what, size):
    """A random scene with something in it that sits exactly where formulas divide by zero."""
    scene = random_scene(seed, size=size, camera_inside=what == "camera in glass")
    center, radius = (np.array(x) for x in (scene.spheres.center, scene.spheres.radius))
    ior, alpha, light = (np.array(x) for x in (scene.materials.ior, scene.materials.alpha, scene.lights.location))
    eye, random = np.asarray(scene.camera.viewpoint), np.random.default_rng(seed)
    toward = random.normal(size=3)
    toward /= np.linalg.norm(toward)
    if what == "concentric":
        center[:, 1], radius[1] = center[:, 0], radius[0] / 2
    elif what == "touching":
        center[:, 1] = center[:, 0] + toward * (radius[0] + radius[1])
    elif what == "on a plane":
        normal = np.asarray(scene.planes.normal)[:, 0]
        center[:, 0] = np.asarray(scene.planes.point)[:, 0] + normal / np.linalg.norm(normal) * radius[0]
    elif what == "grazing":  # The ray through a pixel's middle touches the sphere.
        pixel = np.array([size[0] // 2 / (size[0] - 1) * 8, size[1] // 3 / (size[1] - 1) * 6, 0])
        ray = (pixel - eye) / np.linalg.norm(pixel - eye)
        across = np.cross(ray, toward)
        center[:, 0] = eye + 8 * ray + radius[0] * across / np.linalg.norm(across)
    elif what == "camera on glass":
        center[:, 0] = eye + toward * radius[0]
    elif what == "lit":
        light[:, 0] = center[:, 0] + toward * radius[0]
    if what in ("camera in glass", "camera on glass", "grazing"):
        alpha[:], ior[:] = 0.8, 1.5
    elif what in ("air", "bubble"):
        alpha[:], ior[:] = 0.8, {"air": 1.000293, "bubble": 1 / 1.5}[what]
    changed = (center, radius, ior, alpha, light)
    where = lambda s: (  # noqa: E731
        s.spheres.center,
        s.spheres.radius,
        s.materials.ior,
        s.materials.alpha,
        s.lights.location,
    )
    return eqx.tree_at(where, scene, tuple(jnp.asarray(x, eye.dtype) for x in changed))


def numbers(values):
    return " ".join(repr(float(value)) for value in values)


def rows_last(image):
    """A picture "3 height width" as float64 (height, width, 3)."""
    return np.moveaxis(np.asarray(image, np.float64), 0, -1)


def scaled_scene(scene, factor, model="classic"):
    """The scene with all lengths multiplied, and what is counted in lengths likewise: its picture is the same."""
    values = {}
    for name, value in list_parameters(scene).items():
        dimension = resolve(scene, name).attribute.quantity.dimension_in(model)
        values[name] = np.asarray(value) * factor**dimension
    return set_parameters(scene, values)


def assert_same_scene(one, other):
    """To the last bit, -0 included."""
    assert jax.tree.structure(one) == jax.tree.structure(other)
    for a, b in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert np.asarray(a).tobytes() == np.asarray(b).tobytes()
