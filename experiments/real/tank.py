"""The index of water in a real tank, from published corners of three boards behind it.

    python experiments/real/tank.py

Prints, for each way in which the published thickness of 260 mm may be meant, the index with its error. README.md says
where the numbers are from.
"""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from raytrace_jax.photo.geometry import LOST, Camera, Setup, Tank, inverse_of

jax.config.update("jax_enable_x64", True)

CORNERS = np.genfromtxt(Path(__file__).parent / "tank_corners.csv", delimiter=",", names=True)
SIZE = np.array([3456.0, 2304.0])
FOCAL, PRINCIPAL = 2856.2129, np.array([1782.5502, 1171.3751])
"""The published camera, in pixels; its two focal lengths differ by 3.5e-4 and are taken for their mean."""

TURN = np.array(
    [
        [0.10334112, 0.65915920, 0.74486896],
        [0.99441638, -0.05237952, -0.09161029],
        [-0.02136989, 0.75017711, -0.66089164],
    ]
)
SHIFT = np.array([-237.58343, -128.85148, 455.79838])
"""From the boards' frame, in millimetres, to the camera's: x to the right, y down, z forward."""

THICKNESS = 260.0


def boards() -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """For each board its axes in columns, its middle, its corners in its plane, and the pixels that show them."""
    found = []
    for number in range(3):
        mine = CORNERS[CORNERS["board"] == number]
        points = np.stack([mine[f"{axis}_mm"] for axis in "xyz"], axis=-1)
        middle = points.mean(axis=0)
        right, _, normal = np.linalg.svd(points - middle)[2]
        if (TURN @ normal) @ (TURN @ middle + SHIFT) > 0:  # The board's normal is towards the camera.
            normal = -normal
        axes = np.stack([right, np.cross(normal, right), normal], axis=1)
        found.append((axes, middle, (points - middle) @ axes[:, :2], np.stack([mine["column"], mine["row"]], axis=-1)))
    return found


BOARDS = boards()


@jax.jit
def misses(setup: Setup, size, pixels, places):
    """How far pixels are from where places of the board are seen: the error there, carried back by the local map."""
    seen, inverse = setup.see(size, pixels), inverse_of(setup.local_map(size, pixels))
    return jnp.where(seen.valid[:, None], jnp.einsum("nij,nj->ni", inverse, seen.place - places), LOST)


def off(x: Float[np.ndarray, "9"], thickness: float, wall: float, pose: tuple[float, float]) -> np.ndarray:
    """Misses of all corners in pixels, then those of the pose in standard deviations.

    `x` is a turn in mrad and a shift in millimetres of the camera, the tank's tilt, and the index.
    """
    axes_of_all = Rotation.from_rotvec(1e-3 * x[:3]).as_matrix() @ TURN
    rows = [x[:3] / (1e3 * pose[0]), x[3:6] / pose[1]]
    for axes, middle, places, pixels in BOARDS:
        # The tank's normal is towards the camera; in the board's frame its last component is 1.
        normal = axes.T @ axes_of_all.T @ np.array([x[6], x[7], -1.0])
        camera = Camera(
            rotation=Rotation.from_matrix(axes_of_all @ axes).as_rotvec(),
            translation=axes_of_all @ middle + SHIFT + x[3:6],
            fov=np.degrees(2 * np.arctan(SIZE[0] / (2 * FOCAL))),
            principal_offset=(PRINCIPAL - (SIZE - 1) / 2) / SIZE[0],
        )
        tank = Tank(ior=x[8], tilt=normal[:2] / normal[2], thickness=thickness, wall=wall, wall_index=1.5)
        rows.append(np.asarray(misses(Setup(camera, tank), SIZE, pixels, places)).ravel())
    return np.concatenate(rows[2:] + rows[:2])


def read(thickness: float, wall: float, pose: tuple[float, float]) -> tuple[float, float, float]:
    """Index, its standard deviation by the corners' scatter, and that scatter in pixels."""
    scatter, count = 0.5, 2 * len(CORNERS)

    def rows(x: Float[np.ndarray, "9"], scatter: float) -> np.ndarray:
        found = off(x, thickness, wall, pose)
        return np.append(found[:count] / scatter, found[count:])

    def solve(x: Float[np.ndarray, "9"], scatter: float):
        scale = np.array([1.0] * 6 + [0.01] * 3)
        return least_squares(rows, x, x_scale=scale, diff_step=1e-6, args=(scatter,))

    # The scatter follows from the misses, and the misses a little from the scatter.
    found = solve(np.array([0.0] * 8 + [1.33]), scatter)
    for _ in range(2):
        scatter *= float(np.sqrt(np.mean(found.fun[:count] ** 2)))
        found = solve(found.x, scatter)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    return float(found.x[8]), float(np.sqrt(covariance[8, 8])), scatter


if __name__ == "__main__":
    print("| pose known to | 260 mm are | index of water | scatter [px] |\n|---|---|---|---|")
    for radians, shift in ((1e-3, 0.5), (2e-3, 2.0)):
        for words, thickness, wall in (
            ("without walls", THICKNESS, 0.0),
            *((f"outside, walls {w} mm", THICKNESS, w) for w in (5.0, 10.0)),
            *((f"inside, walls {w} mm", THICKNESS + 2 * w, w) for w in (5.0, 10.0)),
        ):
            index, error, scatter = read(thickness, wall, (radians, shift))
            known = f"{1e3 * radians:g} mrad, {shift} mm"
            print(f"| {known} | {words} | {index:.4f} ± {error:.4f} | {scatter:.2f} |", flush=True)
