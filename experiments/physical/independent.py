"""Fits of 8-bit pictures by a renderer that shares no code with the package: is each answer within its error?

    python experiments/physical/independent.py [CASE ...]

The renderer is the NumPy below: a glass ball before a checkered board, exact Fresnel, 15 internal reflections. Each
case writes its picture as a PNG and fits it by the command, as a user would; its row goes to `independent.json` at
once, and a case that is there already is not done again.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from PIL import Image

HERE = Path(__file__).parent
SIZE = (160, 120)
EYE = np.array([0.3, 0.4, 6.0])
SKY = np.array([0.2, 0.25, 0.3])
DARK, BRIGHT, SQUARE = np.array([0.12, 0.18, 0.3]), np.array([0.9, 0.85, 0.75]), 0.6
BOARD_Z, HALF_WIDTH, HALF_HEIGHT = -3.0, 2.6, 2.0
SCENE = """settings main {{ model physical }}
camera eye {{ pixeldim 160 120 viewpoint 0.3 0.4 6 lookat 0 0 0 fov {fov} }}
background sky {{ radiance 0.2 0.25 0.3 }}
texture squares {{ kind checker color1 0.12 0.18 0.3 color2 0.9 0.85 0.75 square 0.6 }}
material board {{ emission 1 1 1 texture squares }}
material glass {{ transmission 1 ior {ior} }}
rectangle backdrop {{ material board center 0 0 -3 right 2.6 0 0 up 0 2 0 }}
sphere ball {{ material glass center {center} radius {radius} }}
"""


class Case(NamedTuple):
    """A truth, how its picture is sampled, and what the user says of it.

    Args:
        ior, center, radius, fov: the truth.
        samples: a pixel and side.
        jitter: each sample lies anywhere in its cell.
        gain: of the picture before it is stored.
        noise: standard deviation of white noise, in steps of the stored numbers.
        free: what is fitted.
        start: of the fit, where it is not the truth.
        options: of the command.
    """

    ior: float
    center: tuple[float, float, float]
    radius: float = 1.0
    fov: float = 32.0
    samples: int = 8
    jitter: bool = False
    gain: float = 1.0
    noise: float = 0.0
    free: tuple[str, ...] = ("ball.ior", "ball.center")
    start: MappingProxyType = MappingProxyType({"ior": 1.5, "center": (0, 0, 0)})
    options: tuple[str, ...] = ("--no-search",)


EXACT = ("--no-search", "--uncertain", "ball.radius=0.1%")
FOV = ("ball.ior", "ball.center", "eye.fov")
RADIUS = ("ball.ior", "ball.center", "ball.radius")
NEAR_ONE = ("--no-search", "--prior", "ball.radius=1+-0.001")
CROPPED = (*EXACT, "squares.square=0.05%", "--fit-exposure", "--crop", "20", "10", "130", "105")
CASES = {
    "regular": Case(1.43, (-0.08, 0.12, 0.1)),
    "field of view": Case(1.52, (0.1, 0.05, -0.15), fov=32.3, free=FOV, options=EXACT),
    "field of view, 6 x 6": Case(1.46, (-0.14, -0.06, 0.22), fov=31.8, samples=6, free=FOV, options=EXACT),
    "exposure, stratified": Case(1.49, (0.12, -0.08, 0.15), jitter=True, gain=0.85, options=CROPPED),
    "exposure, stratified, dim": Case(1.55, (-0.1, 0.09, 0.05), jitter=True, gain=0.6, options=CROPPED),
    "radius": Case(1.45, (0.07, 0.11, -0.1), radius=1.0005, free=RADIUS, options=NEAR_ONE),
    "radius, stratified": Case(1.58, (-0.12, 0.03, 0.18), radius=0.9993, jitter=True, free=RADIUS, options=NEAR_ONE),
    "searched, noise of two steps": Case(1.62, (0.2, -0.15, 0.1), noise=2.0, options=()),
}
WEAK = [np.random.default_rng(seed).uniform(-1, 1, 5) for seed in range(20)]
CASES |= {
    f"weak {k}": Case(
        1.47 + 0.05 * u[0], tuple(0.2 * u[1:4]), radius=1 + 0.001 * u[4], free=RADIUS, options=NEAR_ONE,
        start=MappingProxyType({"ior": 1.48, "center": tuple(0.1 * u[1:4])}),
    )
    for k, u in enumerate(WEAK)
}  # fmt: skip


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def outside(origin, direction):
    """Light that comes to a ray which meets no ball: the board's, or the sky's."""
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (BOARD_Z - origin[..., 2]) / direction[..., 2]
        x, y = (origin[..., k] + t * direction[..., k] for k in (0, 1))
        odd = (np.floor(x / SQUARE) + np.floor(y / SQUARE)) % 2 == 1
        hit = (t > 0) & (np.abs(x) <= HALF_WIDTH) & (np.abs(y) <= HALF_HEIGHT)
    return np.where(hit[..., None], np.where(odd[..., None], BRIGHT, DARK), SKY)


def fresnel(cos_i, eta):
    """The reflectance of unpolarised light and the cosine of the refracted ray; eta is inside over outside."""
    square = 1 - (1 - cos_i**2) / eta**2
    cos_t = np.sqrt(np.maximum(square, 0))
    s = (cos_i - eta * cos_t) / (cos_i + eta * cos_t)
    p = (eta * cos_i - cos_t) / (eta * cos_i + cos_t)
    return np.where(square > 0, (s**2 + p**2) / 2, 1.0), cos_t


def light(case, x, y, size=SIZE, reflections=15):
    """What comes to the points of a film of this size, in pixels from its left and upper border."""
    width, height = size
    ahead = unit(-EYE)
    right = unit(np.cross(ahead, [0.0, 1.0, 0.0]))
    up = np.cross(right, ahead)
    half = np.tan(np.radians(case.fov) / 2)
    u, v = (2 * x / width - 1) * half, (1 - 2 * y / height) * half * height / width
    d = unit(ahead + u[..., None] * right + v[..., None] * up)
    o = np.broadcast_to(EYE, d.shape)
    to = np.asarray(case.center) - o
    along = np.sum(to * d, -1)
    root = case.radius**2 - (np.sum(to * to, -1) - along**2)
    picture = outside(o, d)
    hit = root > 0
    d, p = d[hit], (o + (along - np.sqrt(np.maximum(root, 0)))[..., None] * d)[hit]
    n = (p - case.center) / case.radius
    cos_i = -np.sum(n * d, -1)
    share, cos_t = fresnel(cos_i, case.ior)
    total = share[:, None] * outside(p, d + 2 * cos_i[:, None] * n)
    d = d / case.ior + (cos_i / case.ior - cos_t)[:, None] * n
    share = 1 - share
    for _ in range(reflections + 1):  # The way out, and so many reflections inside.
        p = p - 2 * np.sum(d * (p - case.center), -1)[:, None] * d  # Along the chord.
        n = unit(p - case.center)
        cos_i = np.sum(n * d, -1)
        back, cos_t = fresnel(cos_i, 1 / case.ior)
        out = case.ior * d + (cos_t - case.ior * cos_i)[:, None] * n
        total += (share * (1 - back))[:, None] * outside(p, out)
        share, d = share * back, unit(d - 2 * cos_i[:, None] * n)
    picture[hit] = total
    return picture


def draw(case, path):
    """Write the picture of a case, 8 bits and sRGB."""
    random = np.random.default_rng(int(case.ior * 1e6))
    width, height = SIZE
    row, column = np.mgrid[:height, :width]
    total = np.zeros((height, width, 3))
    for i in range(case.samples):
        for j in range(case.samples):
            a, b = random.random((2, height, width)) if case.jitter else (0.5, 0.5)
            total += light(case, column + (i + a) / case.samples, row + (j + b) / case.samples)
    linear = case.gain * total / case.samples**2
    stored = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
    stored += case.noise * random.normal(size=stored.shape)
    Image.fromarray(np.clip(np.rint(stored), 0, 255).astype(np.uint8)).save(path)


def run(case, folder):
    """The row of a case: how far each number is off in total errors and in those of noise, the status, the seconds."""
    draw(case, folder / "target.png")
    numbers = {"ior": case.ior, "center": case.center, "fov": case.fov, "radius": case.radius}
    guess = {"ior": case.ior, "center": case.center, "fov": 32, "radius": 1} | dict(case.start)
    text = SCENE.format(**guess | {"center": " ".join(str(float(x)) for x in guess["center"])})
    (folder / "scene.txt").write_text(text)
    command = [sys.executable, "-m", "raytrace_jax", "fit", folder / "scene.txt", folder / "target.png"]
    command += ["--transfer", "srgb", "--free", *case.free, *case.options, "-o", folder / "fit"]
    begun = time.monotonic()
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, cwd=HERE.parents[1])
    summary = json.loads((folder / "fit" / "result.json").read_text())
    truth = {f"ball.center.{axis}": value for axis, value in zip("xyz", case.center, strict=True)}
    truth |= {
        "ball.ior": numbers["ior"],
        "ball.radius": case.radius,
        "eye.fov": case.fov,
        "film.gain.r": case.gain,
        "film.offset.r": 0.0,
    }
    found = {
        name: [one["value"], one["standard_error"], one["total_error"]] for name, one in summary["parameters"].items()
    }
    off = {name: value - truth.get(name, np.nan) for name, (value, *_) in found.items()}
    return {
        "status": summary["status"],
        "off": {name: round(off[name] / total, 2) for name, (_, _, total) in found.items()},
        "off_by_noise": {name: round(off[name] / noise, 2) for name, (_, noise, _) in found.items()},
        "found": found,
        "seconds": round(time.monotonic() - begun, 1),
        "exit": done.returncode,
    }


def rows_of(path):
    return json.loads(path.read_text()) if path.exists() else {}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--results", type=Path, default=HERE / "independent.json", help="where the rows are kept")
    given = parser.parse_args()
    for name in given.cases or CASES:
        if name not in rows_of(given.results):
            with tempfile.TemporaryDirectory() as folder:
                row = run(CASES[name], Path(folder))
            given.results.write_text(json.dumps({**rows_of(given.results), name: row}, indent=1))
        row = rows_of(given.results)[name]
        errors = f"in total errors {row['off']}, of noise {row['off_by_noise']}"
        print(f"{name}: {row['status']}, {errors}, {row['seconds']:.0f} s", flush=True)
