"""Scenes with all that two programs know, for tests of the exchange with other renderers."""

import numpy as np

from raytrace_jax import build

SIZE = (64, 48)
CAMERA = {"pixeldim": SIZE, "viewpoint": (0.4, 0.3, 4.0), "lookat": (0.1, 0.0, 0.0), "fov": 41.0}


def board(**texture):
    """A glass ball in which a smaller one lies, before a board and beside a matt ball, all of it lit."""
    sky = np.linspace(0.1, 1.3, 3 * 4 * 8).reshape(3, 4, 8).astype(np.float16)
    return build.make_scene(
        build.settings("main", model="physical", max_bounces=6),
        build.camera("eye", **CAMERA),
        build.background("all", radiance=(0.7, 0.7, 0.7), texture="above"),
        build.texture("above", kind="image", file=sky, wrap="repeat"),
        build.texture("lines", **texture),
        build.material("board", emission=(1.0, 1.0, 1.0), texture="lines"),
        build.material("clear", transmission=1.0, ior=1.62, absorption=(0.1, 0.2, 0.3)),
        build.material("air", transmission=1.0, ior=1.1),
        build.material("steel", reflectivity=0.83),
        build.rectangle("back", material="board", center=(0.1, 0.2, -2.3), right=(2.7, 0.3, 0.0), up=(-0.3, 2.7, 0.0)),
        build.sphere("outer", material="clear", center=(0.2, 0.1, 0.3), radius=0.9),
        build.sphere("inner", material="air", center=(0.3, 0.1, 0.4), radius=0.31),
        build.sphere("mirror", material="steel", center=(-1.2, -0.3, -0.4), radius=0.45),
        build.sphere("other", material="steel", center=(1.4, -0.6, -0.6), radius=0.3),
        dtype=np.float64,
    )


CHECKS = {
    "kind": "checker",
    "color1": (0.1, 0.2, 0.3),
    "color2": (0.9, 0.7, 0.4),
    "square": 0.37,
    "offset": (0.1, 0.03),
}
PICTURE = {"kind": "image", "file": np.random.default_rng(3).uniform(size=(3, 6, 8)).astype(np.float16)}


def pane(kind):
    """A board behind flat media, with a bubble in them: a slab, with `walls` of water, two planes, or oil on a sea."""
    rows = {"normal": (0.0, 0.0, 1.0)}
    slab = {"material": "glass", "point": (0.0, 0.0, 0.5), "thickness": 1.5, **rows}
    shapes = {
        "slab": [build.slab("window", **slab)],
        "walls": [build.slab("window", wall=0.25, wall_ior=1.25, **slab)],
        "planes": [
            build.plane("behind", material="air", point=(0.0, 0.0, -1.0), **rows),
            build.plane("front", material="glass", point=(0.0, 0.0, 0.5), **rows),
        ],
        # The surface of both, said by each of them; what lies below the sea's is of no sight.
        "oil": [
            build.plane("sea", material="water", normal=(0.0, 1.0, 0.0), point=(0.0, -0.5, 0.0)),
            build.plane("oil", material="glass", normal=(0.0, -2.0, 0.0), point=(3.0, -0.5, 0.0)),
            build.plane("deep", material="air", normal=(0.0, 1.0, 0.0), point=(0.0, -2.0, 0.0)),
            build.sphere("stone", material="water", center=(-1.0, 0.2, 0.0), radius=0.4),
        ],
    }
    bubble = (0.2, -0.9, 0.0) if kind == "oil" else (0.2, 0.0, -0.2)
    # The board is above the sea.
    board = (0.1, 2.4 if kind == "oil" else 0.2, -2.3)
    return build.make_scene(
        build.settings("main", model="physical", max_bounces=8),
        build.camera("eye", **CAMERA),
        build.texture("lines", **CHECKS),
        build.material("board", emission=(1.0, 1.0, 1.0), texture="lines"),
        build.material("glass", transmission=1.0, ior=1.5, absorption=(0.1, 0.2, 0.3)),
        build.material("water", transmission=1.0, ior=1.25),
        build.material("air", transmission=1.0, ior=1.0),
        build.rectangle("back", material="board", center=board, right=(2.7, 0.0, 0.0), up=(0.0, 2.7, 0.0)),
        *shapes[kind],
        build.sphere("bubble", material="air", center=bubble, radius=0.3),
        dtype=np.float64,
    )
