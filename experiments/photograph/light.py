"""What spoils an index by the light of a photograph: its camera, its light field, its mask, or the room in the ball?

    python experiments/photograph/light.py FOLDER [--numbers 1 2 3] [--cases ...]

FOLDER has the rooms of `rooms.py`. Each is fitted as `raytrace-jax photo --fit` does, and then again with one thing as
it truly is: `camera`, the camera and the ball's radius; `field`, the light on the board, from a picture by POV-Ray of
a white board behind a ball and a holder that the camera does not see; `mask`, the pixels that show the holder; `veil`,
a ball in a black room before a board that shines evenly, so that nothing is reflected and there is no field; `all`, a
true camera and mask in that room. FOLDER's `light.json` gets each row at once; then the table is printed.
"""

import argparse
import dataclasses
import json
import re
import sys
from pathlib import Path
from unittest import mock

import jax
import numpy as np
from scipy import ndimage
from scipy.spatial.transform import Rotation

jax.config.update("jax_enable_x64", True)
sys.path.insert(0, str(Path(__file__).parent.parent / "camera"))

from chain import Chain, exposure, falloff, noisy  # noqa: E402
from lab import EXACT, lens_of  # noqa: E402
from rooms import SIZE, WHITE, board_of, rendered, room  # noqa: E402

from raytrace_jax import RenderSettings, enable_compile_cache, fit, read_picture  # noqa: E402
from raytrace_jax.photo import flattened  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.geometry import Camera, Setup  # noqa: E402
from raytrace_jax.photo.locate import locate_together  # noqa: E402
from raytrace_jax.photo.opinions import combine  # noqa: E402
from raytrace_jax.photo.photograph import photograph_of  # noqa: E402
from raytrace_jax.photo.room_scene import light_options, room_scene  # noqa: E402
from raytrace_jax.util.digits import with_error  # noqa: E402

CASES = ("as it is", "camera", "field", "mask", "veil", "all")
SHOWN = "pigment { color rgb 1 } finish { emission 1 diffuse 0 ambient 0 }"


def pictures(truth: dict, board: Path, folder: Path) -> dict[str, np.ndarray]:
    """The light of a white board, of the holder alone, and of a shining board in a black room, by POV-Ray."""
    path = folder / f"light_{truth['number']}.npz"
    if not path.exists():
        text = room(truth, board, truth["eye"], truth["lookat"], truth["roll"], ball=True)
        lines = text.split("\n")
        first = next(k for k, line in enumerate(lines) if "rgbf" in line)
        print_line = next(k for k, line in enumerate(lines) if "image_map" in line)
        unseen = [line.rstrip()[:-1] + "no_image }" for line in lines[first:]]
        paper = re.sub(r"pigment \{ image_map \{.*?\} \} finish", "pigment { color rgb 1 } finish", lines[print_line])
        shines = re.sub(r"finish \{.*?\}", "finish { emission 1 diffuse 0 ambient 0 }", lines[print_line])
        camera = ["#version 3.7; global_settings { assumed_gamma 1.0 max_trace_level 12 }", lines[1]]
        holder = [re.sub(r"pigment \{.*?\} finish \{.*?\}", SHOWN, line) for line in lines[first + 1 :]]
        scenes = {
            "field": [*lines[:print_line], paper, *lines[print_line + 1 : first], *unseen],
            "holder": [*camera, lines[first], *holder],
            "black": [*camera, shines, lines[first]],
        }
        found = {name: rendered("\n".join(scene), SIZE) for name, scene in scenes.items()}
        with path.open("wb") as file:
            np.savez_compressed(file, allow_pickle=False, **found)
    return dict(np.load(path))


class TrueField:
    """The light on the board as a picture of a white board has it, where each place of the board is seen directly."""

    def __init__(self, white: np.ndarray, located, like):
        self.white, self.sight, self.ink, self.rest = white, located.sight, like.ink, like.rest

    def at(self, place):
        where = self.sight.where(place.reshape(-1, 2)).T[::-1]
        planes = [ndimage.map_coordinates(plane, where, order=1, mode="nearest") for plane in self.white]
        return np.stack(planes).reshape(3, *place.shape[:-1])


def truly(located, truth: dict):
    """What was located, with the camera and the radius as they truly are."""
    eye, lookat = np.array(truth["eye"]), np.array(truth["lookat"])
    forward = (lookat - eye) / np.linalg.norm(lookat - eye)
    right = np.cross(forward, [0, 1, 0])
    right /= np.linalg.norm(right)
    up, turn = np.cross(right, forward), np.radians(truth["roll"])
    right, up = np.cos(turn) * right + np.sin(turn) * up, np.cos(turn) * up - np.sin(turn) * right
    matrix = np.stack([right, -up, forward])
    camera = Camera(
        rotation=Rotation.from_matrix(matrix).as_rotvec(),
        translation=-matrix @ eye / truth["print_scale"],
        fov=truth["fov"],
        distortion=np.array(truth["lens"][:2]),
        principal_offset=np.array(truth["lens"][2:]),
    )
    ball = dataclasses.replace(located.setup.glass, radius=truth["radius"] / truth["print_scale"])
    setup = Setup(camera, ball)
    told = setup.places("index", "center")
    covariance, glass = np.zeros_like(located.covariance), np.ix_(told, told)
    covariance[glass] = located.covariance[glass]
    return dataclasses.replace(located, setup=setup, covariance=covariance)


def run(number: int, case: str, folder: Path) -> dict:
    """A row: the index by corners, by light and by both."""
    truth = json.loads((folder / f"room_{number}.json").read_text())
    text = board_of(number, folder)
    board, image = read_board(text), read_picture(folder / f"room_{number}.jpg")
    radius = truth["radius"] * (1 + EXACT * np.random.default_rng(4000 + number).normal()) / truth["print_scale"]
    lens = lens_of(truth["camera"], SIZE, folder)
    known = {"radius": (radius, radius * EXACT * 2**0.5)}
    (photograph,) = locate_together([photograph_of(image, f"room {number}")], board, known, lens).photographs
    located = photograph.located
    assert located is not None, photograph.reason
    by_corners = located.ior
    made = pictures(truth, text, folder) if case in CASES[2:] else {}
    chain = Chain(**{**truth["chain"], "gains": tuple(truth["chain"]["gains"])})
    if case in ("camera", "all"):
        located = truly(located, truth)
    if case in ("veil", "all"):
        image = np.clip(noisy(exposure(WHITE * made["black"], chain), chain), 0, 1)
    find_light = flattened.find_light
    if case == "field":
        # The vignetting is the pixel's, not that of where the board is seen directly.
        like = find_light(image, located)
        image = image / falloff(SIZE[::-1], chain.vignetting)
        white = made["field"] * np.reshape(chain.gains, (3, 1, 1))
        field = TrueField(white, located, like)
        middle = np.zeros((1, 2))
        field.white = float((find_light(image, located).at(middle) / field.at(middle)).mean()) * white
        find_light = lambda *_: field  # noqa: E731
    how = {"disagrees": np.inf} if case in ("mask", "all") else {}
    with mock.patch.object(flattened, "find_light", find_light):
        flat = flattened.flatten(image, located, **how)
    if case in ("mask", "all"):
        hides = flat.grid.parts(made["holder"]).max(axis=(0, 3)) > 0.01
        counts = flat.counts & ~np.asarray(ndimage.binary_dilation(hides, iterations=2), bool)
        flat = flat._replace(counts=counts, image=np.where(counts, flat.image, 0.0), through=flat.through & counts)
    scene = room_scene([located], [flat], [np.eye(len(located.covariance))], located.covariance)
    options = light_options(scene)
    weights = flat.counts.astype(float)
    result = fit(
        scene.scene, flat.image, scene.free, RenderSettings(crop=flat.grid.window), options=options, weights=weights
    )
    found, both = result["ball.ior"], combine(scene, result)
    place = result.names.index("ball.ior")
    noise = float(np.sqrt(result.uncertainty.covariance[place, place]))
    return {
        "truth": truth["ior"], "corners": by_corners, "light": (found.value, found.error), "noise": noise,
        "both": both.ior, "status": result.status, "causes": [cause.words for cause in result.check.causes],
    }  # fmt: skip


def line(key: str, row: dict) -> str:
    """A row of the table."""
    cells = [f"{with_error(*row[by])} ({row[by][0] - row['truth']:+.5f})" for by in ("corners", "light", "both")]
    noise = f"{row['noise']:.1g}"
    return f"| {' | '.join([*key.split(' ', 1), str(row['truth']), *cells, noise, row['status']])} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--numbers", type=int, nargs="+", default=[1, 2, 3])
    parser.add_argument("--cases", nargs="+", choices=CASES, default=list(CASES))
    given = parser.parse_args()
    enable_compile_cache()
    path = given.folder / "light.json"
    rows = json.loads(path.read_text()) if path.exists() else {}
    for number in given.numbers:
        for case in given.cases:
            if (key := f"{number} {case}") not in rows:
                rows[key] = run(number, case, given.folder)
                path.write_text(json.dumps(rows, indent=1))
                print(line(key, rows[key]), flush=True)
    print("\n| room | true | truth | corners | light | both | noise | status |\n|---|---|---|---|---|---|---|---|")
    for key, row in rows.items():
        print(line(key, row))


if __name__ == "__main__":
    main()
