"""A printed board past and through a tank of a liquid, by POV-Ray: photographs, each of its own tank and camera.

    python experiments/photograph/tanks.py FOLDER [NUMBER ...]

Needs the program `povray` (Debian package `povray`) and the extra `photo`. A tank is drawn by its number; those from 11
to 20 have thin walls or none, and are seen through a wide lens that bends. FOLDER gets
`tank_N.jpg`, its board `tank_board_N.txt`, the truth, `tank_N.json`, and for a calibration tilted pictures of a board
by the same camera, `tank_camera_C_K.jpg`, of which `tank_camera_C.txt` names the board; what is there is not made
again. Nothing of it is the package's but the board's pattern. At the end the corners of squares are looked for in the
photograph, where Snell's law for the truth's tank says that they are seen; what they are off is printed.

Lengths of truths are in millimetres, in the board's frame: x to the right, y up, z towards the viewer, the board's
middle is the origin. `normal` points out of the tank's front, `point` is the middle of its outer front, `axes` are to
the right along it and up, and `half` is half its size along these. `thickness` is from outer front to outer back,
`gap` from the board to the nearest point of the back. A tank is closed, full, and of one thickness of wall all around.
Walls of tanks 21 to 23 are out of parallel: the back is turned about `back`, the middle of what is seen through it, by
`wedge`, two angles in radians by which its normal differs from (x, y, 1) along `normal`.
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np
from povray import PAPERS, SIZE, any_camera, camera, made, pattern_size, pixels, printed, v
from rooms import CAMERAS, Chain, calibrate, take

PAPER = "a4"
"""Markers of an A3 board would have less than twenty pixels."""

VIEWS = CAMERAS[::2]
"""Full horizontal angles of view of the cameras, in degrees; number modulo their count is a photograph's camera."""

WIDE = range(11, 21)
WIDE_VIEW, WIDE_LENS = 52.0, [-0.085, 0.0, 0.005, -0.003]
"""Tanks before a wide lens, and that lens: its angle of view; k1, k2 and the principal point in widths of a picture."""

WITHOUT_WALLS = (3, 6, 9, *WIDE[::2])
TOUCHING = 5
"""A tank that touches the board and is parallel to it tells index and thickness only together."""

WEDGES = {21: 0.3, 22: 0.2, 23: 0.15}
"""By how many degrees the walls of some tanks are out of parallel."""

COVERED = (0.35, 0.6)
"""Share of the paper before which the tank is seen; at least two thirds of it behind both front and back."""


def drawn(number: int) -> dict:
    """The truth of a tank, by its number: drawn until the tank covers as much of the board as it should."""
    random = np.random.default_rng(8000 + number)
    width, height = 10 * np.array(PAPERS[PAPER])
    x, y = np.meshgrid(width * (np.arange(60) / 59 - 0.5), height * (np.arange(42) / 41 - 0.5))
    points = np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    for _ in range(10_000):
        truth = once(number, random)
        tank, faces = (float(which.mean()) for which in hidden(truth, points))
        if COVERED[0] < tank < COVERED[1] and faces > tank * 2 / 3:
            truth |= {"covered": tank}
            return truth | wedged(truth, points) if number in WEDGES else truth
    raise RuntimeError(f"tank {number}: no place was found")


def wedged(truth: dict, points) -> dict:
    """How the back is turned, about any axis."""
    turn = np.random.default_rng(8500 + truth["number"]).uniform(0, 2 * np.pi)
    wedge = np.tan(np.radians(WEDGES[truth["number"]])) * np.array([np.cos(turn), np.sin(turn)])
    _, inside, crossings = seen(truth, points)
    return {"wedge": wedge.tolist(), "back": crossings[3, inside].mean(axis=0).tolist()}


def back_of(truth: dict) -> tuple[np.ndarray, np.ndarray]:
    """A point of the outer back, and the normal of it that points to the front."""
    normal = np.array(truth["normal"])
    if "wedge" not in truth:
        return truth["point"] - truth["thickness"] * normal, normal
    turned = normal / normal[2] + [*truth["wedge"], 0]
    return np.array(truth["back"]), turned / np.linalg.norm(turned)


def once(number: int, random: np.random.Generator) -> dict:
    """One try of a tank and its camera."""
    uniform = random.uniform
    width, height = 10 * np.array(PAPERS[PAPER])
    touches, walled, wide = number == TOUCHING, number not in WITHOUT_WALLS, number in WIDE
    tilt, turn = 0.0 if touches else np.radians(uniform(0, 8)), uniform(0, 2 * np.pi)
    normal = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
    right = np.cross([0, 1, 0], normal)
    right /= np.linalg.norm(right)
    axes = np.stack([right, np.cross(normal, right)])
    half = np.array([uniform(0.15, 0.4) * width, uniform(0.3, 0.6) * height])
    gap, thickness = 0.01 if touches else uniform(1, 40), uniform(40, 120)
    # The corner of the back that comes nearest to the board is as far from it as the gap.
    back = np.array([uniform(-0.4, 0.4) * width, uniform(-0.15, 0.15) * height, gap + half @ np.abs(axes[:, 2])])
    taken_with = len(VIEWS) if wide else number % len(VIEWS)
    aside, rise = np.radians(uniform(0, 30)), np.radians(uniform(0, 60))
    toward = np.sin(aside) * np.array([random.choice([-1, 1]) * np.cos(rise), np.sin(rise), 1 / np.tan(aside)])
    lookat = np.array([uniform(-0.03, 0.03) * width, uniform(-0.03, 0.03) * height, 0.0])
    truth = {
        "number": number,
        "ior": round(float(uniform(1.3, 1.6)), 4),
        "thickness": float(thickness),
        "wall": float(uniform(*((0.5, 2) if wide else (2, 5)))) if walled else 0.0,
        "wall_ior": float(random.choice([1.49, 1.52])) if walled else None,
        "normal": normal.tolist(),
        "point": (back + thickness * normal).tolist(),
        "gap": float(gap),
        "axes": axes.tolist(),
        "half": half.tolist(),
        "lookat": lookat.tolist(),
        "roll": float(uniform(-3, 3)),
        "camera": taken_with,
        "lens": WIDE_LENS if wide else [0.0, 0.0, 0.0, 0.0],
        "fov": WIDE_VIEW if wide else VIEWS[taken_with],
        "paper": PAPER,
        "print_scale": (scale := float(1 + random.normal() * 1e-3)),
        "ruler": 100 * scale,
        "size": SIZE,
        "chain": any_camera(random, number),
    }
    # As near as the whole paper lets it come.
    paper = np.array([[x * width / 2, y * height / 2, 0] for x in (-1, 1) for y in (-1, 1)])
    margin = uniform(0.01, 0.05) * SIZE[0]
    distance = 0.5 * width / np.tan(np.radians(truth["fov"]) / 2)
    while True:
        truth["eye"] = (lookat + distance * toward).tolist()
        if np.all(np.abs(pixels(truth, paper) - (np.array(SIZE) - 1) / 2) < np.array(SIZE) / 2 - margin):
            return truth
        distance *= 1.01


def hidden(truth: dict, points) -> tuple[np.ndarray, np.ndarray]:
    """Which points of the board have the tank before them, on a straight ray, and which both its front and back."""
    frame = np.array([*truth["axes"], truth["normal"]])
    start, end = (np.array(truth["eye"]) - truth["point"]) @ frame.T, (points - truth["point"]) @ frame.T
    sides = np.array([*truth["half"], truth["thickness"] / 2])
    # Where along a ray it enters and leaves the slabs between opposite sides.
    cuts = (np.array([-sides, sides])[:, None] - [0, 0, sides[2]] - start) / (end - start)
    enter, leave = cuts.min(axis=0), cuts.max(axis=0)
    inside = enter.max(axis=-1) < leave.min(axis=-1)
    return inside, inside & (enter.argmax(axis=-1) == 2) & (leave.argmin(axis=-1) == 2)


def scene(truth: dict, board: Path) -> str:
    """The text of a POV-Ray scene, in centimetres."""
    random = np.random.default_rng(9000 + truth["number"])
    uniform = random.uniform
    point, half, wall = np.array(truth["point"]) / 10, np.array(truth["half"]) / 10, truth["wall"] / 10
    matrix = ", ".join(f"{x:.9g}" for x in np.ravel([*truth["axes"], truth["normal"], point]))
    matt = "finish { diffuse 0.8 }"
    table = min(-PAPERS[PAPER][1] / 2, point[1] - 1.2 * half[1] - 2) - 1.5

    frame, (back, turned) = np.array([*truth["axes"], truth["normal"]]), back_of(truth)
    out, behind = -frame @ turned, frame @ (back / 10 - point)

    def box(inset: float, ior: float) -> str:
        low, high = (*(inset - half), inset - truth["thickness"] / 10), (*(half - inset), -inset)
        solid = f"box {{ {v(low)} {v(high)}"
        if "wedge" in truth:
            # A box that is longer is cut by the turned back.
            solid = f"intersection {{ box {{ {v((*low[:2], 2 * low[2]))} {v(high)} }} "
            solid += f"plane {{ {v(out)}, {behind @ out - inset:.9g} }}"
        return (
            f"{solid} matrix <{matrix}> pigment {{ color rgbf 1 }} "
            "finish { ambient 0 diffuse 0 reflection { 0, 1 fresnel on } conserve_energy } "
            f"interior {{ ior {ior} }} no_shadow }}"
        )

    lamps = [
        f"light_source {{ {v((side * uniform(30, 90), uniform(20, 90), uniform(80, 150)))} "
        f"color rgb {v(uniform(0.7, 1.0, 3) * uniform(0.3, 0.8))} "
        "area_light <20,0,0>, <0,20,0>, 4, 4 adaptive 1 jitter fade_distance 150 fade_power 2 }"
        for side in (-1, 1)
    ]
    return "\n".join(
        [
            "#version 3.7; global_settings { assumed_gamma 1.0 max_trace_level 12 }",
            camera(truth, truth["eye"], truth["lookat"], truth["roll"]),
            *lamps,
            # A pale sky, which is what the tank mirrors.
            f"sky_sphere {{ pigment {{ gradient y color_map {{ [0 color rgb {v(uniform(0.1, 0.3, 3))}] "
            f"[1 color rgb {v(uniform(0.3, 0.6, 3))}] }} scale 2 translate -y }} }}",
            f"plane {{ z, {-uniform(8, 40)} pigment {{ color rgb {v(uniform(0.3, 0.8, 3))} }} {matt} }}",
            f"plane {{ y, {table} pigment {{ color rgb {v(uniform(0.2, 0.6, 3))} }} {matt} }}",
            *printed(truth, board),
            *([box(0.0, truth["wall_ior"])] if wall else []),
            box(wall, truth["ior"]),
        ]
    )


def make(number: int, folder: Path) -> None:
    """Make a tank's board, its photograph, the pictures for a calibration and the truth."""
    truth, board = drawn(number), made(folder / f"tank_board_{number}.pdf", PAPER)
    chain = Chain(**{**truth["chain"], "gains": tuple(truth["chain"]["gains"])})
    path = folder / f"tank_{number}.jpg"
    if not path.exists():
        take(scene(truth, board), truth, chain, path)
        path.with_suffix(".json").write_text(json.dumps(truth, indent=1))
    first = WIDE[0] if number in WIDE else truth["camera"] or len(VIEWS)
    board = made(folder / f"tank_board_{first}.pdf", PAPER)
    calibrate(drawn(first), board, chain, folder / f"tank_camera_{truth['camera']}")


def seen(truth: dict, points) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where points of the board are seen through front and back, "n 2", which of them are, and "4 n 3" on the faces."""
    eye, normal, wall = np.array(truth["eye"]), np.array(truth["normal"]), truth["wall"]
    (back, turned), front = back_of(truth), np.array(truth["point"])
    wall_ior = truth["wall_ior"] or truth["ior"]
    faces = (
        (front, normal, 1 / wall_ior),
        (front - wall * normal, normal, wall_ior / truth["ior"]),
        (back + wall * turned, turned, truth["ior"] / wall_ior),
        (back, turned, wall_ior),
    )
    # A ray is aimed at its point, then beside it by what it misses, which is a few times less each time.
    aim, crossings = np.array(points), np.zeros((4, len(points), 3))
    for _ in range(60):
        place, way = eye, (aim - eye) / np.linalg.norm(aim - eye, axis=-1, keepdims=True)
        for k, (on, out, ratio) in enumerate(faces):
            falls = -(way @ out)[:, None]
            crossings[k] = place = place + ((place - on) @ out).reshape(-1, 1) / falls * way
            # Snell's law.
            way = ratio * way + (ratio * falls - np.sqrt(1 - ratio**2 * (1 - falls**2))) * out
        aim = aim + points - (place - place[:, 2:] / way[:, 2:] * way)
    places = (crossings - truth["point"]) @ np.array(truth["axes"]).T
    inside = np.all(np.abs(places) < np.array(truth["half"]) - wall - 2, axis=(0, 2))
    return pixels(truth, aim), inside, crossings


def bent(truth: dict, places: np.ndarray) -> np.ndarray:
    """Where the lens of a truth shows what a pinhole camera sees in these pixels, "n 2"."""
    k1, k2, *offset = truth["lens"]
    focal = SIZE[0] / (2 * np.tan(np.radians(truth["fov"]) / 2))
    straight = (places - (np.array(SIZE) - 1) / 2) / focal
    squared = np.sum(straight**2, axis=-1, keepdims=True)
    middle = (np.array(SIZE) - 1) / 2 + np.array(offset) * SIZE[0]
    return straight * (1 + k1 * squared + k2 * squared**2) * focal + middle


def check(number: int, folder: Path) -> str:
    """How far from their places by the truth the corners of squares are found, in pixels."""
    truth = json.loads((folder / f"tank_{number}.json").read_text())
    image = cv2.imread(str(folder / f"tank_{number}.jpg"), cv2.IMREAD_GRAYSCALE)
    assert image is not None
    size = pattern_size(folder / f"tank_board_{number}.txt")
    x, y = np.meshgrid(*(np.arange(10, whole - 5, 10) - whole / 2 for whole in size))
    points = truth["print_scale"] * np.stack([x, y, 0 * x], -1).reshape(-1, 3)
    words, (through, inside, _) = [f"tank {number}"], seen(truth, points)
    for name, places in (("through", through[inside]), ("beside", pixels(truth, points)[~hidden(truth, points)[0]])):
        places = bent(truth, places)
        found = cv2.cornerSubPix(image, places[:, None].astype(np.float32), (5, 5), (-1, -1), (3, 50, 1e-3))[:, 0]
        off = np.linalg.norm(found - places, axis=-1)
        words.append(f"{name} {len(places)} corners, median {np.median(off):.3f}, 90 % {np.percentile(off, 90):.3f}")
    return ", ".join(words)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("numbers", type=int, nargs="*", default=range(1, 11))
    given = parser.parse_args()
    (folder := given.folder.resolve()).mkdir(parents=True, exist_ok=True)
    for number in given.numbers:
        make(number, folder)
        print(check(number, folder), flush=True)


if __name__ == "__main__":
    main()
