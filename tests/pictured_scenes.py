"""The scenes of `physical_pictures`, which other programs rendered (see the README there)."""

import numpy as np
from physical_scenes import Camera, Checker, Image, Light, Material, Plane, Rectangle, Scene, Sphere

EYE = Camera((96, 72), (0.4, 0.5, 5), (0.05, -0.1, 0), (0.05, 1, 0), 40)
SQUARES = Checker((0.1, 0.15, 0.25), (0.9, 0.85, 0.8), 0.8, (0.13, 0.07))
BOARD = Rectangle(Material(emission=(1, 1, 1), texture=SQUARES), (0.2, 0.1, -2.5), (4, 0, 0.4), (0, 4, 0))
TEXELS = np.random.default_rng(1).uniform(0.1, 0.9, (8, 8, 3)).astype(np.float32)
PAINTED = Rectangle(
    Material(emission=(1, 1, 1), texture=Image(TEXELS, "board.exr")), BOARD.center, BOARD.right, BOARD.up
)
RADIANCE = (0.05, 0.06, 0.08)


def glass(ior, **more):
    return Material(transmission=1, ior=ior, **more)


def nested():
    """A glass ball with a bubble and a core of denser glass that holds a bubble; another ball beside it."""
    balls = [
        Sphere(glass(1.0), (-0.75, 0.3, 0.1), 0.25),
        Sphere(glass(1.5), (-0.3, 0, 0), 1.1),
        Sphere(glass(1.8), (0.1, -0.2, 0.1), 0.5),
        Sphere(glass(1.0), (0.2, -0.25, 0.15), 0.2),
        Sphere(glass(1.33), (1.6, 0.6, -0.5), 0.55),
    ]
    return Scene(EYE, [PAINTED, *balls], radiance=RADIANCE, max_bounces=12, least_weight=1e-5)


def lights():
    """Matt and mirroring surfaces under two lights; glass casts no shadow, the rest does."""
    floor = Checker((0.8, 0.7, 0.3), (0.2, 0.3, 0.6), 0.6, (0.1, 0.2))
    shapes = [
        Plane(Material(diffuse=(1, 1, 1), texture=floor), (0.1, -1, 0.2), (0.05, 1, 0.1)),
        Sphere(Material(diffuse=(0.5, 0.2, 0.1), reflectivity=0.4), (-0.9, -0.2, 0), 0.7),
        Sphere(glass(1.5), (0.5, -0.3, 0.6), 0.5),
        Sphere(Material(reflectivity=0.8), (0.9, 0.5, -1), 0.7),
        Rectangle(Material(diffuse=(0.6, 0.7, 0.7), reflectivity=0.2), (0, 0.3, -2), (2, 0.2, 0.5), (-0.2, 2, 0)),
    ]
    lamps = [Light((2, 3, 2.5), (7, 6, 4)), Light((-2.5, 2, 3), (1, 3, 5))]
    return Scene(EYE, shapes, lamps, RADIANCE, max_bounces=12, least_weight=1e-7)


def dispersion():
    """Two balls of flint glass, one by its Abbe number and one by three indices."""
    balls = [
        Sphere(glass(1.7174, abbe=29.5), (-0.5, 0.1, 0), 0.9),
        Sphere(glass((1.6146, 1.6222, 1.6331)), (1.2, -0.4, -0.3), 0.7),
    ]
    return Scene(EYE, [BOARD, *balls], radiance=RADIANCE, max_bounces=12, least_weight=1e-7)


def absorption():
    """Two balls of tinted glass before a picture."""
    balls = [
        Sphere(glass(1.5, absorption=(0.1, 0.4, 1)), (-0.5, 0.1, 0), 0.9),
        Sphere(glass(1.3, absorption=(0.8, 0.3, 0.05)), (1.2, -0.4, -0.3), 0.7),
    ]
    return Scene(EYE, [PAINTED, *balls], radiance=RADIANCE, max_bounces=24, least_weight=1e-7)


def sky():
    """A glass ball and a mirror in the open, under a sky of few texels."""
    texels = np.random.default_rng(2).uniform(0.1, 0.9, (8, 16, 3)).astype(np.float32)
    balls = [Sphere(glass(1.5), (-0.5, 0.1, 0), 0.9), Sphere(Material(reflectivity=0.9), (1.2, -0.4, -0.3), 0.7)]
    return Scene(EYE, balls, radiance=(1, 0.9, 0.8), sky=Image(texels, "sky.exr"), max_bounces=24)


def squares():
    """One ball before a board of squares, 640 x 480."""
    camera = Camera((640, 480), (0, 0, 5), (0, 0, 0), (0, 1, 0), 40)
    board = Rectangle(Material(emission=(1, 1, 1), texture=SQUARES), (0, 0, -2.5), (6, 0, 0), (0, 6, 0))
    ball = Sphere(glass(1.5168), (0.12, -0.07, 0.15), 1)
    return Scene(camera, [board, ball], radiance=RADIANCE, max_bounces=24)
