"""Physical scenes of glass in awkward places, and their pictures with derivatives in both modes."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from physical_scenes import Camera, Checker, Light, Material, Rectangle, Scene, Sphere, direction, scene_text

from raytrace_jax import parse_scene
from raytrace_jax.tracer.rendering import render
from raytrace_jax.tracer.settings import ResolvedSettings

SIZE = (24, 18)
BOUNCES = 5
AWKWARD = (
    "one ball",
    "two balls",
    "apart",
    "nested",
    "concentric",
    "touching",
    "touching inside",
    "overlapping",
    "camera in glass",
    "camera on glass",
    "index of air",
    "just above air",
    "grazing",
    "on the board",
    "tiny",
    "lamp on glass",
)
"""What is awkward about a scene of three balls, a checkered board, a lamp and a sky, all with an Abbe number."""


def awkward_physical(seed, what, size=SIZE):
    """A random scene; all of them have the same structure, so that one program renders them."""
    random = np.random.default_rng(seed)
    eye = np.array([0, 0, 5]) + random.uniform(-0.7, 0.7, 3)
    centers = np.array([[-0.6, 0.1, 0.3], [0.7, -0.1, -0.4], [0.1, 0.6, 0.9]]) + random.uniform(-0.2, 0.2, (3, 3))
    radii, indices = random.uniform([0.6, 0.5, 0.2], [0.9, 0.8, 0.4]), random.uniform(1.1, 2.2, 3)
    toward, far = direction(random), np.array([0, 0, -30])
    if what in ("one ball", "two balls"):  # The others behind the board.
        centers[1 if what == "one ball" else 2 :] += far
    elif what == "nested":
        centers[1], radii[1] = centers[0] + 0.3 * radii[0] * toward, 0.5 * radii[0]
        centers[2], radii[2] = centers[1] + 0.2 * radii[1] * direction(random), 0.6 * radii[1]
    elif what == "concentric":
        centers[1:], radii[1:] = centers[0], radii[0] * np.array([0.6, 0.3])
    elif what == "touching":
        centers[1] = centers[0] + toward * (radii[0] + radii[1])
    elif what == "touching inside":
        radii[1] = 0.5 * radii[0]
        centers[1] = centers[0] + toward * (radii[0] - radii[1])
    elif what == "overlapping":
        centers[1] = centers[0] + toward * 0.8 * (radii[0] + radii[1])
    elif what == "camera in glass":
        centers[0] = eye + toward * 0.5 * radii[0]
    elif what == "camera on glass":
        centers[0] = eye + toward * radii[0]
    elif what == "index of air":
        indices[random.integers(3)] = 1.0
    elif what == "just above air":
        indices[:] = 1 + 10.0 ** random.uniform(-12, -2, 3)
    elif what == "grazing":  # The ray through the middle of a pixel touches the ball.
        across = np.cross(-eye, toward)
        centers[0] = radii[0] * across / np.linalg.norm(across)
    elif what == "on the board":
        centers[0, 2] = -2.5 + radii[0]
    elif what == "tiny":
        radii[2] = 10.0 ** random.uniform(-6, -2)
    lamp = centers[0] + toward * radii[0] if what == "lamp on glass" else random.uniform([-4, 1, 2], [4, 5, 6])
    absorption = random.uniform(0, 1, (3, 3)) * random.integers(0, 2, (3, 1))
    balls = [
        Sphere(
            Material(transmission=1, ior=float(ior), abbe=random.uniform(20, 60), absorption=tuple(a)),
            tuple(center),
            float(radius),
        )
        for center, radius, ior, a in zip(centers, radii, indices, absorption, strict=True)
    ]
    squares = Checker(
        *(tuple(random.uniform(0, 1, 3)) for _ in range(2)), random.uniform(0.3, 1), tuple(random.uniform(-1, 1, 2))
    )
    matt = Material(emission=(1, 1, 1), diffuse=(0.5, 0.5, 0.5), texture=squares)
    board = Rectangle(matt, (0, 0, -2.5), (6, 0, 0), (0, 6, 0))
    lookat = (0.0, 0.0, 0.0) if what == "grazing" else tuple(random.uniform(-0.3, 0.3, 3))
    camera = Camera(size, tuple(eye), lookat, (0, 1, 0), random.uniform(30, 50))
    scene = Scene(camera, [board, *balls], [Light(tuple(lamp), (9, 9, 9))], tuple(random.uniform(0, 1, 3)))
    return parse_scene(scene_text(replace(scene, max_bounces=BOUNCES)))


def both_modes(edges, size=SIZE, rays=64):
    """`in_both_modes` for scenes of `awkward_physical`.

    Of a larger picture fewer pixels lie at edges: it needs room for fewer `rays` a pixel.
    """
    how = ResolvedSettings(size=size, model="physical", mapping="center", max_bounces=BOUNCES, edges=edges)
    return in_both_modes(how, rays)


def in_both_modes(how, rays):
    """A function of scene and direction: picture, its change, and the change of a weighted sum in both modes."""
    (width, height), how = how.size, replace(how, rays_per_pixel=rays, throw=False)

    def pictures(scene, along):
        weight = jnp.sin(jnp.arange(3.0 * width * height)).reshape(3, height, width)

        def picture(scene):
            film = render(scene, how)
            return film.image, film.overflow

        image, change, overflow = jax.jvp(picture, (scene,), (along,), has_aux=True)
        gradient = jax.grad(lambda scene: jnp.sum(weight * picture(scene)[0]))(scene)
        products = jax.tree.map(lambda a, b: a * b, gradient, along)
        reverse = sum(jnp.sum(x) for x in jax.tree.leaves(products))
        terms = sum(jnp.sum(jnp.abs(x)) for x in jax.tree.leaves(products))
        return image, change, jnp.sum(weight * change), reverse, terms, overflow

    return jax.jit(pictures)


def direction_like(scene, seed):
    """A random direction in the space of all numbers of a scene."""
    leaves, structure = jax.tree.flatten(scene)
    random = np.random.default_rng(seed)
    return jax.tree.unflatten(structure, [jnp.asarray(random.normal(size=leaf.shape)) for leaf in leaves])


def faults(program, seed, what, size=SIZE):
    """`faults_of` a scene of `awkward_physical`."""
    return faults_of(program, awkward_physical(seed, what, size), seed)


def faults_of(program, scene, seed, tolerance=1e-6):
    """What is wrong with the pictures of a scene, in words; none where all is finite and both modes agree."""
    image, change, forward, reverse, terms, overflow = program(scene, direction_like(scene, seed))
    found = []
    if int(overflow):
        found.append(f"{int(overflow)} rays found no room")
    for name, values in (("picture", image), ("derivative", change)):
        bad = np.argwhere(~np.isfinite(np.asarray(values)).all(axis=0))
        if len(bad):
            found.append(f"{name} not finite at (row, column) {bad[:4].tolist()}")
    if not np.isfinite(float(reverse)):
        found.append("gradient not finite")
    elif not abs(float(forward) - float(reverse)) <= tolerance * float(terms):
        found.append(f"forward {float(forward):.9g}, reverse {float(reverse):.9g}, terms of {float(terms):.3g}")
    return found
