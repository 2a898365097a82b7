"""Scenes of photographs: the camera, the board that shines by itself, and the ball or the tank."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ..inverse.options import FitOptions
from ..scene import build
from ..scene.build import make_scene
from ..scene.rows import Description
from ..scene.scene import Scene
from ..util.compilation import jit
from .boards import CharucoBoard
from .flattened import Flattened
from .geometry import Ball, Camera, Setup, Tank
from .locate import Located
from .photograph import PixelGrid

FREE = ("ball.ior", "ball.center", "film.gain", "film.blur", "sky.radiance")
"""What a fit finds: the glass, its place, what is left of exposure and white balance, the camera's blur, and the room
that the ball reflects, whose share follows Fresnel's equations."""

UNCERTAIN = (
    *(f"eye.{what}.{axis}" for what in ("viewpoint", "lookat") for axis in "xyz"),
    *("eye.fov", "eye.distortion.k1", "eye.distortion.k2", "eye.center.x", "eye.center.y", "ball.radius"),
)
"""Parameters that corners and ruler have told; their errors and the correlations of these are known."""

GLASS = ("ball.ior", *(f"ball.center.{axis}" for axis in "xyz"))
"""What corners and light both tell."""


class RoomScene(NamedTuple):
    """A scene to fit a flattened photograph with.

    Args:
        scene: as the corners have it.
        uncertain: standard deviations of parameters that are not free, by name.
        correlations: of the same parameters, by pairs of names.
        covariance: of `GLASS` and `UNCERTAIN` together, by the corners.
    """

    scene: Scene
    uncertain: Mapping[str, float]
    correlations: Mapping[tuple[str, str], float]
    covariance: Float[np.ndarray, "numbers numbers"]


def light_options(room: RoomScene) -> FitOptions:
    """The options of a fit of the light.

    It starts unblurred, for the corners have led it near the answer. Edge-aware pixels are taken as they are: the rim,
    where they err, does not count.
    """
    return FitOptions(
        loss="cauchy",
        target_sampling="aware",
        search=False,
        blur=(0.0,),
        uncertain=room.uncertain,
        correlations=room.correlations,
    )


def room_scene(located: Located, flat: Flattened) -> RoomScene:
    """The scene of a flattened photograph, in the board's frame and unit of length."""
    grid, setup = flat.grid, located.setup
    # The board shines by itself, for the photograph was divided by the light on it.
    glass: Ball = setup.glass
    shapes = [
        build.material("glass", transmission=1, ior=float(glass.ior)),
        build.sphere("ball", material="glass", center=glass.center, radius=float(glass.radius)),
    ]
    if (liquid := setup.liquid) is not None:
        shapes += [
            build.material("liquid", transmission=1, ior=float(liquid.ior)),
            build.plane("surface", material="liquid", normal=(0, 0, 1), point=(0, 0, float(liquid.depth))),
        ]
    scene = _scene(located, grid, flat.field.ink, shapes)

    # The covariance of the scene's numbers, from that of camera and ball. What is held still in the fit has errors and
    # correlations of these.
    slope = np.asarray(_slope(setup, located.size, grid))
    whole = slope @ located.covariance @ slope.T
    covariance = whole[len(GLASS) :, len(GLASS) :]
    spread = np.sqrt(np.diagonal(covariance))
    known = [k for k in range(len(UNCERTAIN)) if spread[k] > 0]
    uncertain = {UNCERTAIN[k]: float(spread[k]) for k in known}
    pairs = {
        (UNCERTAIN[i], UNCERTAIN[j]): float(covariance[i, j] / (spread[i] * spread[j]))
        for i in known for j in known if i < j
    }  # fmt: skip
    return RoomScene(scene, uncertain, pairs, whole)


def wedge_comment(located: Located) -> str:
    """What the file of a tank's scene says where walls are out of parallel, for its slab has parallel ones."""
    if not np.any(located.setup.glass.wedge):
        return ""
    x, y = np.rad2deg(located.setup.glass.wedge)
    return (
        f"# The walls of the tank were found out of parallel, by a wedge of {x:.3f} and {y:.3f} degrees.\n"
        "# This slab has parallel walls, so that the scene shows the board a little beside the photograph.\n"
    )


def tank_scene(located: Located) -> Scene:
    """The scene of a photograph of a tank, in the board's frame and unit of length; where the tank is means nothing.

    Its walls are parallel: see `wedge_comment`.
    """
    glass: Tank = located.setup.glass
    before = 1.1 * float(glass.thickness) + np.linalg.norm(glass.tilt) * np.linalg.norm(located.board.half)
    tank = build.slab(
        "tank", material="liquid", point=(0, 0, before), normal=(*glass.tilt, 1), thickness=float(glass.thickness),
        wall=float(glass.wall), wall_ior=max(float(glass.wall_index), 1.0),
    )  # fmt: skip
    liquid = build.material("liquid", transmission=1, ior=float(glass.ior))
    return _scene(located, PixelGrid.of(located.size, 1), np.zeros(3), [liquid, tank])


def _scene(located: Located, grid: PixelGrid, ink: Float[np.ndarray, "3"], glass: Sequence[Description]) -> Scene:
    """The camera, the board with ink of this brightness, and what is before it."""
    eye = _eye(located.setup.camera, located.size, grid)
    half = located.board.half
    # Light that has been reflected within a ball three times is left out: of a glass of 1.8 it is 6e-4, of one of 1.5
    # 6e-5.
    return make_scene(
        build.settings("main", model="physical", mapping="center", max_bounces=4),
        build.camera("eye", pixeldim=grid.size, **{name: np.asarray(x) for name, x in eye.items()}),
        build.background("sky", radiance=(0.05, 0.05, 0.05)),
        build.film("film", blur=max(located.blur / grid.binning, 0.2)),
        build.texture("print", kind="image", file=_texture(located.board, ink)),
        build.material("paper", emission=(1, 1, 1), texture="print"),
        build.rectangle("board", material="paper", center=(0, 0, 0), right=(half[0], 0, 0), up=(0, half[1], 0)),
        *glass,
    )


@jit
def _slope(setup: Setup, size, grid) -> Float[Array, "scene numbers"]:
    """The derivative of what `GLASS` and `UNCERTAIN` name by the set-up's numbers."""
    numbers, setup_of = ravel_pytree(setup)

    def of_scene(numbers):
        setup = setup_of(numbers)
        ball, eye = setup.glass, _eye_of(setup.camera, size, grid)
        camera = [eye[name] for name in ("viewpoint", "lookat", "fov", "distortion", "center")]
        return jnp.hstack([ball.ior, ball.center, *camera, ball.radius])

    return jax.jacfwd(of_scene)(numbers)


def _eye_of(seen_by: Camera, size, grid) -> dict[str, Float[Array, "..."]]:
    """The camera of the cut and binned picture, as a scene says it."""
    camera = seen_by.of_scene
    reach = jnp.tan(jnp.deg2rad(seen_by.fov) / 2) * (grid.size[0] * grid.binning / size[0])
    return {
        "viewpoint": camera.viewpoint,
        "lookat": camera.lookat,
        "up": camera.up,
        "fov": jnp.rad2deg(2 * jnp.arctan(reach)),
        "center": (seen_by.principal_point(size) - jnp.asarray(grid.left, float) + 0.5) / grid.binning - 0.5,
        "distortion": camera.distortion,
    }


_eye = jit(_eye_of)


def _texture(board: CharucoBoard, ink: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 rows columns"]:
    """The board's picture: 1 is paper, ink as it is given; a mean of texels where there are many."""
    texture = board.texture
    rows, columns = texture.shape
    # A square keeps about 32 texels a side, or more where that does not divide the picture.
    by = max(1, int(columns / (2 * board.half[0] / board.square) / 32))
    while rows % by or columns % by:
        by -= 1
    small = texture.reshape(rows // by, by, columns // by, by).mean(axis=(1, 3))
    return np.asarray(ink[:, None, None] + (1 - ink[:, None, None]) * small)
