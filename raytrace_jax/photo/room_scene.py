"""Scenes of photographs: the camera, the board that shines by itself, and the ball or the tank."""

import itertools
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

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
from ..util.numerics import root_diagonal
from .boards import CharucoBoard
from .flattened import Flattened
from .geometry import Camera, Setup, Tank
from .locate import Located
from .photograph import PixelGrid

HELD = (
    *(f"eye.{what}.{axis}" for what in ("viewpoint", "lookat") for axis in "xyz"),
    *("eye.fov", "eye.distortion.k1", "eye.distortion.k2", "eye.center.x", "eye.center.y", "ball.radius"),
)
"""What corners and ruler have told, and a fit holds; their errors and the correlations of these are known."""


GLASSES = 4
"""The index and the three coordinates of a ball's centre."""


class RoomScene(NamedTuple):
    """A scene to fit flattened photographs with.

    Args:
        scene: as the corners have it.
        shown: by the camera what it sees of it, where there are several.
        free: what a fit finds: the glass, its place, what is left of exposure and white balance, the camera's blur, and
            the room that the ball reflects, whose share follows Fresnel's equations.
        glass: the parameters that corners and light both tell, the index first.
        held: the parameters that corners alone tell.
        told: the values of `glass` by the corners.
        uncertain: standard deviations of those of `held` that are not exact, by name.
        correlations: of the same parameters, by pairs of names.
        covariance: of `glass` and `held` together, by the corners.
    """

    scene: Scene
    shown: dict[str, Scene]
    free: tuple[str, ...]
    glass: tuple[str, ...]
    held: tuple[str, ...]
    told: Float[np.ndarray, " glass"]
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


def room_scene(
    located: Sequence[Located], flats: Sequence[Flattened], chains: Sequence[Float[np.ndarray, "numbers joint"]],
    covariance: Float[np.ndarray, "joint joint"],
) -> RoomScene:  # fmt: skip
    """The scene of flattened photographs, in the board's frame and unit of length.

    Each of several photographs has its own board and ball, for somebody may have moved it; they stand so far apart
    that no camera sees another one's. The glass and the room that it reflects are common.

    Args:
        chains: as `Adjusted` has them, of these photographs.
        covariance: of all that was adjusted.
    """
    ends = [""] if len(located) == 1 else [str(k + 1) for k in range(len(located))]
    parts, free, glass, held, slopes = list[list[Description]](), list[str](), list[str](), list[str](), []
    for k, (view, flat, chain) in enumerate(zip(located, flats, chains, strict=True)):
        end, ball = ends[k], view.setup.glass
        aside = np.array([100 * k * view.board.half[0], 0.0, 0.0])
        sphere = build.sphere(f"ball{end}", material="glass", center=ball.center + aside, radius=float(ball.radius))
        parts.append([*_photograph(view, flat.grid, flat.field.ink, end, aside), sphere])
        index, film = ("glass.ior", f"eye{end}") if end else ("ball.ior", "film")
        center = [f"ball{end}.center.{axis}" for axis in "xyz"]
        common = [] if k else [index]
        free += [*common, f"ball{end}.center", f"{film}.gain", f"{film}.blur"]
        glass += [*common, *center]
        held += [name.replace("eye.", f"eye{end}.").replace("ball.", f"ball{end}.") for name in HELD]
        slopes.append(np.asarray(_slope(view.setup, view.size, flat.grid)) @ chain)
    first = located[0].setup
    room = _room(build.material("glass", transmission=1, ior=float(first.glass.ior)))
    if (liquid := first.liquid) is not None:
        room += [
            build.material("liquid", transmission=1, ior=float(liquid.ior)),
            build.plane("surface", material="liquid", normal=(0, 0, 1), point=(0, 0, float(liquid.depth))),
        ]

    # The covariance of the scene's numbers, from that of cameras and balls. What is held in the fit has errors and
    # correlations of these.
    of_glass = [slope[bool(k) : GLASSES] for k, slope in enumerate(slopes)]
    slope = np.concatenate([*of_glass, *(slope[GLASSES:] for slope in slopes)])
    whole = slope @ covariance @ slope.T
    own = whole[len(glass) :, len(glass) :]
    spread = root_diagonal(own)
    known = [k for k in range(len(held)) if spread[k] > 0]
    pairs = {(held[i], held[j]): float(own[i, j] / (spread[i] * spread[j])) for i in known for j in known if i < j}
    scene, shown = make_scene(*room, *itertools.chain(*parts)), {}
    if len(parts) > 1:  # Each pixel would ask all shapes, and each derivative have all centres.
        shown = dict(zip(scene.cameras, (make_scene(*room, *part) for part in parts), strict=True))
    told = np.array([float(scene[name]) for name in glass])
    uncertain = {held[k]: float(spread[k]) for k in known}
    return RoomScene(scene, shown, (*free, "sky.radiance"), tuple(glass), tuple(held), told, uncertain, pairs, whole)


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
    liquid, grid = build.material("liquid", transmission=1, ior=float(glass.ior)), PixelGrid.of(located.size, 1)
    return make_scene(*_room(liquid), *_photograph(located, grid, np.zeros(3)), tank)


def _room(*blocks: Description) -> list[Description]:
    """What is common to photographs."""
    # Light that has been reflected within a ball three times is left out: of a glass of 1.8 it is 6e-4, of one of 1.5
    # 6e-5.
    settings = build.settings("main", model="physical", mapping="center", max_bounces=4)
    return [settings, build.background("sky", radiance=(0.05, 0.05, 0.05)), *blocks]


def _photograph(
    located: Located,
    grid: PixelGrid,
    ink: Float[np.ndarray, "3"],
    end: str = "",
    aside: Any = (0, 0, 0),
) -> list[Description]:
    """The camera, and the board with ink of this brightness.

    Args:
        end: of the names.
        aside: by how much both are moved.
    """
    eye = {name: np.asarray(x) for name, x in _eye(located.setup.camera, located.size, grid).items()}
    eye |= {name: eye[name] + aside for name in ("viewpoint", "lookat")}
    half = located.board.half
    return [
        build.camera(f"eye{end}", pixeldim=grid.size, **eye),
        build.film(f"eye{end}" if end else "film", blur=max(located.blur / grid.binning, 0.2)),
        build.texture(f"print{end}", kind="image", file=_texture(located.board, ink)),
        build.material(f"paper{end}", emission=(1, 1, 1), texture=f"print{end}"),
        build.rectangle(f"board{end}", material=f"paper{end}", center=aside, right=(half[0], 0, 0), up=(0, half[1], 0)),
    ]


@jit
def _slope(setup: Setup, size, grid) -> Float[Array, "scene numbers"]:
    """The derivative by the set-up's numbers of the ball's index and centre, `GLASSES`, then of what `HELD` names."""
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
