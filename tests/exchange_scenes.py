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
