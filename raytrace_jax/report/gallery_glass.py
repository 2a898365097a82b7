"""The scenes of the gallery `glass`: a ball before a board, and what else glass can be; free of JAX."""

_BEFORE_A_BOARD = """
settings main {{ model physical samples 4 least_weight 1e-4 }}
camera eye {{ pixeldim 480 360 viewpoint 0 0.35 5.2 lookat 0 -0.02 0 up 0 1 0 fov 30 }}
background sky {{ radiance 1 1 1 texture evening }}
texture evening {{ kind image file sky.exr wrap repeat }}
texture squares {{ kind checker color1 0.05 0.10 0.16 color2 0.72 0.68 0.60 square 0.4 offset 0.13 0.07 }}
material board {{ emission 1 1 1 texture squares }}
material glass {{ transmission 1 {glass} }}
{board}
sphere ball {{ material glass center {center} radius {radius} }}
{more}
"""

_BOARD = "rectangle backdrop { material board center 0 0 -2.2 right 4 0 0 up 0 3 0 }"


def _scene(glass: str, more: str = "", board: str = _BOARD, center: str = "0 0 0", radius: str = "1") -> str:
    return _BEFORE_A_BOARD.format(glass=glass, more=more, board=board, center=center, radius=radius)


GLASS_SCENES = {
    "clear": _scene("ior 1.5168"),
    "tinted": _scene("ior 1.5168 absorption 0.75 0.22 0.10"),
    "dispersive": _scene("ior 1.78 abbe 8"),
    "bubble": _scene(
        "ior 1.5168",
        "material air { transmission 1 ior 1 }\nsphere bubble { material air center 0.3 0.12 0.3 radius 0.42 }",
    ),
    "two_balls": _scene(
        "ior 1.31",
        "material flint { transmission 1 ior 1.85 }\nsphere far { material flint center 0.75 -0.1 -0.85 radius 0.72 }",
        center="-0.5 0.1 0.35",
        radius="0.72",
    ),
    "environment": _scene("ior 1.5168", board=""),
}
"""Texts of scene files, by the names of their pictures; `sky.exr` lies with the scenes that come with the package."""
