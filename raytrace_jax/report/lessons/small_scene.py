"""A small scene for the lessons about pictures: a glass ball before coloured ones."""

from raytrace_jax.scene.reader import parse_scene
from raytrace_jax.scene.scene import Scene

INDEX = 1.5

BALLS = {
    "red": (-0.6, -0.8, (15, 1, 1)),
    "yellow": (4.2, -1.6, (14, 11, 1)),
    "lime": (9.0, -0.4, (5, 14, 1)),
    "orange": (-1.4, 3.4, (15, 6, 0)),
    "white": (4.4, 3.2, (13, 13, 13)),
    "violet": (9.2, 3.9, (8, 1, 15)),
    "cyan": (-0.2, 7.6, (0, 12, 13)),
    "pink": (3.9, 8.0, (16, 5, 9)),
    "blue": (8.4, 7.3, (1, 3, 17)),
}
"""What stands behind the glass: the matt balls' x and y in world units, and their ambient colour, which falls off with
the length of the path (about 20 world units)."""


def scene_text() -> str:
    """The scene as the text of a `model.txt` file."""
    blocks = [
        "camera eye { pixeldim 160 120 worlddim 8 6 viewpoint 4 3 8 }",
        "light left { location 1 7 4 emissivity 0.7 0.7 0.7 }",
        f"material clear {{ ambient 0.2 0.4 0.5 specular 0.1 0.1 0.1 alpha 0.95 ior {INDEX} }}",
        "material wall { ambient 4 4.6 5.8 diffuse 0.2 0.2 0.3 }",
        "plane back { material wall normal 0 0 1 point 0 0 -14 }",
    ]
    for name, (x, y, (red, green, blue)) in BALLS.items():
        blocks.append(f"material {name}paint {{ ambient {red} {green} {blue} diffuse 0.3 0.3 0.3 }}")
        blocks.append(f"sphere {name} {{ material {name}paint center {x} {y} -11 radius 1.4 }}")
    return "\n".join([*blocks, "sphere glass { material clear center 4 3 -1.5 radius 2.2 }"])


def small_scene() -> Scene:
    """The scene; the ball is called `glass`."""
    return parse_scene(scene_text())
