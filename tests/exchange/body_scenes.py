"""Scenes with bodies of glass before a board, of which POV-Ray made pictures."""

from raytrace_jax import parse_scene

HEAD = """
settings main { model physical mapping center max_bounces 16 least_weight 1e-05 }
background sky { radiance 0.05 0.06 0.08 }
texture squares { kind checker color1 0.1 0.15 0.25 color2 0.9 0.85 0.8 square 0.5 offset 0.13 0.07 }
material board { emission 1 1 1 texture squares }
material glass { transmission 1 ior 1.5 }
material flint { transmission 1 ior 1.7 }
material water { transmission 1 ior 1.33 }
material air { transmission 1 ior 1 }
rectangle backdrop { material board center 0 0 -2.6 right 6 0 0 up 0 6 0 }
camera eye { pixeldim 96 72 lookat 0.1 -0.05 -0.3 up 0.05 1 0.02 fov 37 viewpoint """

OUTSIDE = "1.1 0.8 4.6 }"

WALLS = " ".join(
    f"rectangle wall{axis}{side} {{ material dim center {place[0]} {place[1]} {place[2]} right {right} up {up} }}"
    for axis, right, up in ((0, "0 10 0", "0 0 10"), (1, "10 0 0", "0 0 10"), (2, "10 0 0", "0 10 0"))
    for side in (0, 1)
    for place in [[10 * (2 * side - 1) * (axis == k) for k in range(3)]]
)
"""A room as dim as the sky."""

SCENES = {
    "box": "box body { material glass center 0.1 -0.05 0.2 right 0.8 0.1 0.15 up -0.079 0.6 0.0214 depth 0.5 }",
    "prism": "prism body { material flint point 0.1 0.7 0.2 axis 0.2 0.1 0.7 down 0.2 -1.1 0.1 apex 50 }",
    "rod": "cylinder body { material glass center 0.1 0 0.1 axis 0.9 0.5 -0.3 radius 0.35 }",
    "half_disc": "cylinder body { material glass center 0 0 0.2 axis 0.1 0.2 0.5 radius 0.9 cut 0.2 1 -0.44 }",
    "half_ball": "sphere body { material flint center 0 0 0.2 radius 0.9 cut 0.3 0.2 -1 }",
    "plano_convex": "lens body { material glass center 0.1 0.1 0.3 axis 0.2 0.1 -1 curvature1 0.6 curvature2 0"
    " thickness 0.5 diameter 1.8 }",
    "biconvex": "lens body { material flint center 0.05 0.1 0.3 axis 0.2 0.1 -1 curvature1 0.5 curvature2 -0.35"
    " thickness 0.7 diameter 2 }",
    "bubble": "box body { material glass center 0.1 -0.05 0.2 right 0.8 0.1 0.15 up -0.079 0.6 0.0214 depth 0.5 }"
    " sphere hole { material air center 0.2 0 0.2 radius 0.3 }",
    "tube": "cylinder wall { material glass center 0.1 0 0 axis 0.1 1.2 0.2 radius 0.6 }"
    " cylinder inner { material water center 0.1 0 0 axis 0.0833 1 0.1667 radius 0.45 }",
    "pipe": "cylinder wall { material glass center 0.1 0 0 axis 0.1 1.2 0.2 radius 0.6 }"
    " cylinder inner { material air center 0.1 0 0 axis 0.0833 1 0.1667 radius 0.45 }",
    "tank": "box tank { material water center 0 0 0 right 3 0 0 up 0 3 0 depth 0.9 }"
    " cylinder wall { material glass center 0.1 0 0 axis 0 1.5 0 radius 0.5 }"
    " cylinder inner { material air center 0.1 0 0 axis 0 1.4 0 radius 0.38 }",
    "in_liquid": "box tank { material water center 0 0 1 right 20 0 0 up 0 20 0 depth 20 }"
    f" material dim {{ emission 0.05 0.06 0.08 }} {WALLS}"
    " prism body { material flint point 0.1 0.7 0.2 axis 0.1 0 0.5 down 0 -0.8 0 apex 40 }"
    " box other { material glass center -0.9 0 0 right 0.3 0 0.1 up 0 0.6 0 depth 0.3 }",
    "inside": "box body { material glass center 0.1 0 2 right 2 0 0.3 up 0 1.8 0 depth 3 }"
    " lens hole { material air center 0.05 0.1 0.3 axis 0.2 0.1 -1 curvature1 0.5 curvature2 -0.35"
    " thickness 0.7 diameter 2 }",
}

NESTED = ("tube", "tank", "in_liquid")
"""Those of which POV-Ray takes other media."""

PICTURED = tuple(name for name in SCENES if name not in ("tube", "tank"))
"""Those of which there is a picture; that in liquid is of the same scene in vacuum, with indices of 1 / 1.33."""


def body_scene(name, dtype=None):
    return parse_scene(f"{HEAD}{OUTSIDE}\n{SCENES[name]}\n", dtype=dtype)
