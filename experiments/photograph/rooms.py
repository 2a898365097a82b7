"""Rooms that nobody describes to the program, by POV-Ray: a printed board, a ball of glass, lamps, a window, a table.

    python experiments/photograph/rooms.py FOLDER [NUMBER ...]

Needs the program `povray` (Debian package `povray`) and the extra `photo`. A room is drawn by its number; those from
13 to 16 are seen through a lens that bends, and in those from 21 to 30 posts, tripods and hands hold the ball. FOLDER
gets `room_N.jpg`, below 21 the same ball at two other places, `room_N_2.jpg` and `room_N_3.jpg`, its board
`board_N.txt`, the truth, `room_N.json` with that of the other places beside it, and for a calibration tilted pictures
of the board by the same camera, `camera_C_K.jpg`, without a ball and without radiosity; what is there is not made
again. Nothing of it is the package's but the board's pattern. Lengths of the rooms are in centimetres, those of boards
and truths in millimetres.
"""

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from povray import MARGIN, PAPERS, SIZE, any_camera, camera, made, printed, rendered, through_lens, v

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "camera"))
from chain import Chain, photograph  # noqa: E402

CALIBRATIONS = 5
CAMERAS = (29.3, 38.6, 46.9, 61.7)
"""Full horizontal angles of view, in degrees."""

PLAIN = 12
"""Rooms up to this number are seen through a lens without distortion, whose principal point is the picture's middle."""

WHITE = 0.8
"""Of saturation: how bright the brightest fiftieth of a photograph is."""

HELD = {
    21: ("post", 0.5, WHITE), 22: ("post", 0.35, WHITE), 23: ("tripod", 0.7, WHITE), 24: ("hand", 0.0, WHITE),
    25: ("shadow", 0.5, WHITE), 26: ("post", 0.4, 1.15), 27: ("tripod", 0.5, 0.2), 28: ("hand", 0.0, 0.5),
    29: ("ring", 0.85, WHITE), 30: ("shadow", 0.5, 1.0),
}  # fmt: skip
"""What holds the ball in rooms above 20, half its width in radii, and how bright the photograph is, as `WHITE`."""


def drawn(number: int) -> dict:
    """The truth of a room, by its number."""
    random = np.random.default_rng(1000 + number)
    uniform = random.uniform
    paper = "a4" if number % 3 else "a3"
    radius = uniform(2.0, 3.2) if paper == "a4" else uniform(3.0, 4.5)
    ior = round(float(uniform(1.33, 1.9)), 4)
    width, height = PAPERS[paper]
    # Twice as far from the board as its focus the ball shows several squares, upside down.
    gap = radius * ior / (2 * (ior - 1)) * uniform(1.7, 2.5)
    center = np.array([uniform(-0.1, 0.1) * width, uniform(-0.08, 0.05) * height, gap])
    camera = number % len(CAMERAS)
    fov = CAMERAS[camera]
    distance = 0.5 * width * uniform(1.05, 1.25) / np.tan(np.radians(fov) / 2) + 0.5 * gap
    side, rise = np.radians(uniform(-14, 14)), np.radians(uniform(-4, 12))
    eye = distance * np.array([np.sin(side) * np.cos(rise), np.sin(rise), np.cos(side) * np.cos(rise)])
    target = np.array([uniform(-0.04, 0.04) * width, uniform(-0.04, 0.04) * height, 0.3 * gap])
    return {
        "number": number,
        "ior": ior,
        "radius": float(10 * radius),
        "center": (10 * center).tolist(),
        "eye": (10 * eye).tolist(),
        "lookat": (10 * target).tolist(),
        "roll": float(uniform(-3, 3)),
        "camera": camera + len(CAMERAS) if PLAIN < number < min(HELD) else camera,
        "lens": lens_of(camera) if PLAIN < number < min(HELD) else [0.0, 0.0, 0.0, 0.0],
        "fov": fov,
        "paper": paper,
        "print_scale": float(1 + random.normal() * 1e-3),
        "size": SIZE,
        "chain": any_camera(random, number),
    }


def elsewhere(truth: dict, place: int) -> dict:
    """The same ball and camera at another place: 2 is nearer to the board than the first, 3 is farther away from it."""
    random = np.random.default_rng(6000 + 10 * truth["number"] + place)
    uniform = random.uniform
    width, height = PAPERS[truth["paper"]]
    radius, ior = truth["radius"] / 10, truth["ior"]
    gap = radius * ior / (2 * (ior - 1)) * (uniform(1.5, 1.7) if place == 2 else uniform(2.6, 3.0))
    distance = 0.5 * width * uniform(1.0, 1.2) / np.tan(np.radians(truth["fov"]) / 2) + 0.5 * gap
    side, rise = np.radians(uniform(8, 20) * (-1) ** place), np.radians(uniform(-4, 15))
    eye = distance * np.array([np.sin(side) * np.cos(rise), np.sin(rise), np.cos(side) * np.cos(rise)])
    lookat = np.array([uniform(-0.04, 0.04) * width, uniform(-0.04, 0.04) * height, 0.3 * gap])
    center = np.array([uniform(-0.1, 0.1) * width, uniform(-0.08, 0.05) * height, gap])
    roll = float(uniform(-3, 3))
    return truth | {
        "center": (10 * center).tolist(),
        "eye": (10 * eye).tolist(),
        "lookat": (10 * lookat).tolist(),
        "roll": roll,
    }


def lens_of(camera: int) -> list[float]:
    """k1 and k2 of OpenCV, and how far the principal point is to the right of and below the middle, in widths."""
    random = np.random.default_rng(5000 + camera)
    return [*random.uniform((-0.15, -0.05), (0.1, 0.05)).tolist(), *random.normal(0, 0.01, 2).tolist()]


def room(truth: dict, board: Path, eye, lookat, roll: float, ball: bool) -> str:
    """The text of a POV-Ray scene, with ball and radiosity or without both; the board's middle is the origin, it faces
    +z, y is up.
    """
    random = np.random.default_rng(2000 + truth["number"])
    uniform = random.uniform
    width, height = PAPERS[truth["paper"]]
    table = -height / 2 - 1.5
    warm, cool = (1.0, 0.86 + 0.1 * uniform(), 0.7 + 0.2 * uniform()), (0.8 + 0.1 * uniform(), 0.92, 1.0)
    window, lamp = uniform(-70, 70), np.array([uniform(-60, 60), uniform(40, 80), uniform(50, 120)])
    walls = [tuple(uniform(0.25, 0.85, 3)) for _ in range(4)]
    holder, wide, _ = HELD.get(truth["number"], ("ring", uniform(0.4, 0.6), WHITE))
    hand = np.array([uniform(-1.2, 1.2) * width, uniform(0.8, 1.4) * height, uniform(20, 40)])
    parts = [
        f"#version 3.7; global_settings {{ assumed_gamma 1.0 max_trace_level 12 {RADIOSITY if ball else AMBIENT} }}",
        camera(truth, eye, lookat, roll),
        # A window at one side, with the light of the sky, and a lamp above and behind the camera.
        f"light_source {{ {v((window, 60, 150))} color rgb {v(np.multiply(cool, uniform(0.5, 0.8)))} "
        "area_light <40,0,0>, <0,40,0>, 5, 5 adaptive 1 jitter }",
        f"light_source {{ {v(lamp)} color rgb {v(np.multiply(warm, uniform(0.2, 0.5)))} "
        "area_light <8,0,0>, <0,0,8>, 4, 4 adaptive 1 jitter }",
        f"box {{ {v((window - 25, 30, 199))} {v((window + 25, 90, 199.5))} pigment {{ color rgb {v(cool)} }} "
        "finish { emission 2.5 ambient 0 diffuse 0 } no_shadow }",
        *(
            f"plane {{ {v(normal)}, {offset} pigment {{ color rgb {v(color)} }} finish {{ diffuse 0.8 ambient 0 }} }}"
            for (normal, offset), color in zip(
                (((1, 0, 0), -160), ((-1, 0, 0), -170), ((0, 0, 1), -uniform(8, 60)), ((0, 0, -1), -200)),
                walls,
                strict=True,
            )
        ),
        "plane { <0,-1,0>, -180 pigment { color rgb 0.9 } finish { diffuse 0.8 ambient 0 } }",
        f"plane {{ <0,1,0>, {table} pigment {{ wood color_map {{ [0 color rgb {v(uniform(0.25, 0.5, 3))}] "
        f"[1 color rgb {v(uniform(0.4, 0.6, 3))}] }} scale 3 rotate 88*x }} finish {{ diffuse 0.7 ambient 0 }} }}",
        *printed(truth, board),
        # A book that leans somewhere, and something above that throws a soft shadow.
        f"box {{ {v((-7, 0, -2))} {v((7, 18, 2))} pigment {{ color rgb {v(uniform(0.1, 0.8, 3))} }} "
        f"finish {{ diffuse 0.8 ambient 0 }} rotate {uniform(0, 90)}*y "
        f"translate {v((uniform(0.8, 1.3) * width * random.choice([-1, 1]), table, uniform(5, 40)))} }}",
        f"sphere {{ {v(hand)}, {uniform(3, 7)} pigment {{ color rgb <0.8,0.6,0.5> }} "
        "finish { diffuse 0.8 ambient 0 } }",
    ]
    if ball:
        radius, center = truth["radius"] / 10, np.array(truth["center"]) / 10
        parts += [
            f"sphere {{ {v(center)}, {radius} pigment {{ color rgbf <1,1,1,1> }} "
            f"finish {{ ambient 0 diffuse 0 reflection {{ 0, 1 fresnel on }} conserve_energy }} "
            f"interior {{ ior {truth['ior']} }} }}",
            *held(holder, wide * radius, radius, center, table, lamp),
        ]
    return "\n".join(parts)


def held(holder: str, wide: float, radius: float, center, table: float, lamp) -> list[str]:
    """What holds the ball, `wide` to each side of its middle, or throws a shadow beside it."""
    foot = center - np.array([0, np.sqrt(max(radius**2 - wide**2, 0)), 0])
    ground = np.array([center[0], table, center[2]])

    def rod(start, end, thick: float, color: float) -> str:
        return (
            f"cylinder {{ {v(start)} {v(end)}, {thick} pigment {{ color rgb {color} }} "
            "finish { diffuse 0.7 ambient 0 } }"
        )

    if holder == "post":
        return [rod(ground, foot, wide, 0.7)]
    if holder == "tripod":
        turns = 2 * np.pi * (np.arange(3) / 3 + 0.1)
        legs = wide * np.stack([np.sin(turns), 0 * turns, np.cos(turns)], -1)
        return [rod(ground + 2 * leg, foot + leg, 0.2, 0.15) for leg in legs]
    if holder == "hand":
        # Fingers and a thumb at both sides, and an arm that comes from below.
        skin = "pigment { color rgb <0.75,0.55,0.45> } finish { diffuse 0.8 ambient 0 }"
        reach = radius + 0.6
        tips = [
            center + reach * np.array([side * np.sin(turn), -np.cos(turn), 0.0]) for side, turn in
            ((-1, 1.3), (-1, 0.8), (-1, 0.3), (1, 1.1))
        ]  # fmt: skip
        palm = center - np.array([0, radius + 2.5, 0])
        fingers = [f"cylinder {{ {v(palm)} {v(tip)}, 0.7 {skin} }} sphere {{ {v(tip)}, 0.7 {skin} }}" for tip in tips]
        return [*fingers, f"cylinder {{ {v(palm)} {v(palm + np.array([6, -25, 8]))}, 2.5 {skin} }}"]
    # A ring on a rod behind it; what throws a shadow hangs between the lamp and the board beside the ball.
    torus = (
        f"torus {{ {wide}, 0.15 translate {v(foot)} pigment {{ color rgb 0.25 }} finish {{ diffuse 0.7 ambient 0 }} }}"
    )
    back = np.array([0, 0, wide])
    parts = [torus, rod(ground - back, foot - back, 0.15, 0.25)]
    if holder == "shadow":
        beside = np.array([center[0] + 1.8 * radius, center[1], 0.0])
        where = beside + 0.5 * (lamp - beside)
        parts += [
            f"sphere {{ {v(where)}, {0.6 * radius} pigment {{ color rgb 0.6 }} finish {{ diffuse 0.8 ambient 0 }} }}"
        ]
    return parts


RADIOSITY = (
    "radiosity { pretrace_start 0.08 pretrace_end 0.01 count 60 nearest_count 6 error_bound 0.7 recursion_limit 2 "
    "low_error_factor 0.6 gray_threshold 0 minimum_reuse 0.015 brightness 1 }"
)

AMBIENT = "ambient_light rgb 0.3"


def make(number: int, folder: Path) -> None:
    """Make a room's board, its photograph, the pictures for a calibration and its truth."""
    folder = folder.resolve()
    truth, board = drawn(number), board_of(number, folder)
    chain = Chain(**{**truth["chain"], "gains": tuple(truth["chain"]["gains"])})
    path = folder / f"room_{number}.jpg"
    if not path.exists():
        take(room(truth, board, truth["eye"], truth["lookat"], truth["roll"], ball=True), truth, chain, path)
        path.with_suffix(".json").write_text(json.dumps(truth, indent=1))
    for k in (2, 3) if number < min(HELD) else ():
        path = folder / f"room_{number}_{k}.jpg"
        if not path.exists():
            there = elsewhere(truth, k)
            lens = chain._replace(seed=10_000 * k + number)
            take(room(there, board, there["eye"], there["lookat"], there["roll"], ball=True), there, lens, path)
            path.with_suffix(".json").write_text(json.dumps(there, indent=1))
    # The same camera before the board of the first room that was taken with it, from elsewhere.
    taken_with = truth["camera"]
    first = (taken_with % len(CAMERAS) or len(CAMERAS)) + (PLAIN if taken_with >= len(CAMERAS) else 0)
    calibrate(drawn(first), board_of(first, folder), chain, folder / f"camera_{taken_with}")


def calibrate(truth: dict, board: Path, chain: Chain, stem: Path) -> None:
    """Take tilted pictures of a board by the camera of a truth, `stem_K.jpg`; `stem.txt` names the board."""
    random = np.random.default_rng(3000 + truth["camera"])
    distance = np.linalg.norm(truth["eye"])
    for k in range(CALIBRATIONS):
        path = stem.with_name(f"{stem.name}_{k}.jpg")
        side, rise = np.radians(random.uniform(25, 40) * (-1) ** k), np.radians(random.uniform(-10, 35))
        toward = np.array([np.sin(side) * np.cos(rise), np.sin(rise), np.cos(side) * np.cos(rise)])
        eye, roll = distance * random.uniform(0.9, 1.1) * toward, float(random.uniform(-20, 20)) + 90 * (k % 2)
        if not path.exists():
            stem.with_suffix(".txt").write_text(f"{board.name}\n")
            scene = room(truth, board, eye, (0, 0, 0), roll, ball=False)
            take(scene, truth, chain._replace(seed=100 * truth["number"] + k), path)


def board_of(number: int, folder: Path) -> Path:
    """The board of a room, which is made if it is missing."""
    return made(folder / f"board_{number}.pdf", drawn(number)["paper"])


def take(text: str, truth: dict, chain: Chain, path: Path) -> None:
    """Render a scene and photograph it."""
    white = HELD.get(truth["number"], ("ring", 0.0, WHITE))[2]
    bends = any(truth["lens"])
    light = rendered(text, (round(MARGIN * SIZE[0]), round(MARGIN * SIZE[1])) if bends else SIZE)
    if bends:
        light = through_lens(light, truth["fov"], truth["lens"])
    photograph(white / np.percentile(light, 98) * light, chain, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("numbers", type=int, nargs="*", default=range(1, PLAIN + 5))
    given = parser.parse_args()
    given.folder.mkdir(parents=True, exist_ok=True)
    for number in given.numbers:
        make(number, given.folder)
        print(f"room {number}", flush=True)


if __name__ == "__main__":
    main()
