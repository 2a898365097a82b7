"""Simulation-based calibration: do the error bars of fits hold, counted over pictures of random truths?

    python experiments/calibration/calibration.py run [KIND ...] [--fits 40] [--film] [--results FILE]
    python experiments/calibration/calibration.py table [--results FILE] [--histogram PNG]

The pictures are those of `experiments/physical/independent.py`, a renderer that shares no code with the package: a
glass ball before a board, 96 x 72. Each truth is drawn from its number, so that a run goes on where it stopped: each
fit adds a line to the results at once, and one that is there is not done again.
"""

import argparse
import json
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "physical"))
import independent  # noqa: E402

SIZE = (96, 72)
SAMPLES = 8
REFLECTIONS = 5
"""Inside of the ball, in both programs: more take longer and tell the errors of estimates no better."""


class Kind(NamedTuple):
    """How a target is made of the light.

    Args:
        sampling: of the samples in a pixel: `grid`, `stratified` (anywhere in its cell) or `random`.
        noise: standard deviation of white noise in the light.
        shot: standard deviation of noise at a light of 1, which grows with the light's root.
        bits: of the numbers that are stored as sRGB; None is float32.
        quality: of a JPEG.
    """

    sampling: str = "grid"
    noise: float = 0.0
    shot: float = 0.0
    bits: int | None = None
    quality: int | None = None


KINDS = {
    "grid": Kind(),
    "stratified": Kind("stratified"),
    "random": Kind("random"),
    "white noise": Kind(noise=0.01),
    "shot noise": Kind(shot=0.02),
    "8 bits": Kind(bits=8),
    "16 bits": Kind(bits=16),
    "JPEG 90": Kind(noise=0.004, quality=90),
}


class Truth(NamedTuple):
    """What is drawn for one fit; `gain` and `offset` are those of the film."""

    ior: float
    center: np.ndarray
    start_ior: float
    start_center: np.ndarray
    gain: float = 1.0
    offset: float = 0.0


def draw_truth(name: str, number: int, film: bool) -> tuple[Truth, np.random.Generator]:
    """The truth of one fit of a kind, and the generator for what follows."""
    random = np.random.default_rng([list(KINDS).index(name), number, int(film)])
    ior, center = random.uniform(1.4, 1.65), random.uniform(-0.15, 0.15, 3)
    near = random.uniform(-1, 1, 4)
    gain, offset = (random.uniform(0.6, 0.95), random.uniform(0.0, 0.03)) if film else (1.0, 0.0)
    return Truth(ior, center, ior + 0.02 * near[0], center + 0.03 * near[1:], gain, offset), random


def draw_light(kind: Kind, truth: Truth, random: np.random.Generator) -> np.ndarray:
    """The film's light, "height width 3": means of samples, gain and offset, noise."""
    width, height = SIZE
    case = independent.Case(truth.ior, tuple(truth.center))
    row, column = np.mgrid[:height, :width]
    total = np.zeros((height, width, 3))
    for i in range(SAMPLES):
        for j in range(SAMPLES):
            right, down = random.random((2, height, width)) if kind.sampling != "grid" else (0.5, 0.5)
            if kind.sampling != "random":
                right, down = (i + right) / SAMPLES, (j + down) / SAMPLES
            total += independent.light(case, column + right, row + down, SIZE, REFLECTIONS)
    light = truth.gain * total / SAMPLES**2 + truth.offset
    scatter = np.sqrt(kind.noise**2 + kind.shot**2 * light)
    return light + scatter * random.normal(size=light.shape)


def stored(kind: Kind, light: np.ndarray, folder: Path):
    """The target as it is read back, "3 height width", and the compression of a JPEG."""
    from raytrace_jax import jpeg_storage, read_picture

    if kind.bits is None and kind.quality is None:
        return np.moveaxis(light.astype(np.float32).astype(np.float64), -1, 0), None
    encoded = np.where(light <= 0.0031308, 12.92 * light, 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055)
    most = 2 ** (kind.bits or 8) - 1
    numbers = np.clip(np.rint(most * encoded), 0, most)
    if kind.bits == 16:  # Pillow writes no such colours.
        share = numbers / most
        linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
        return np.moveaxis(linear, -1, 0), None
    path = folder / ("target.jpg" if kind.quality else "target.png")
    quality = {} if kind.quality is None else {"quality": kind.quality}
    Image.fromarray(numbers.astype(np.uint8)).save(path, None, **quality)
    return read_picture(path, transfer="srgb"), jpeg_storage(path) if kind.quality else None


def scene_text(truth: Truth) -> str:
    """The scene at the start of the fit."""
    center = " ".join(repr(float(x)) for x in truth.start_center)
    text = independent.SCENE.format(fov=32.0, ior=float(truth.start_ior), center=center, radius=1.0)
    text = text.replace("pixeldim 160 120", "pixeldim {} {}".format(*SIZE))
    return text.replace("model physical", f"model physical max_bounces {REFLECTIONS + 2}")


def run_fit(name: str, film: bool, number: int) -> dict:
    """One fit: how far each number is off, in total errors."""
    from raytrace_jax import FitOptions, fit, parse_scene

    kind = KINDS[name]
    truth, random = draw_truth(name, number, film)
    with tempfile.TemporaryDirectory() as folder:
        target, storage = stored(kind, draw_light(kind, truth, random), Path(folder))
    begun, cpu = time.monotonic(), time.process_time()
    result = fit(
        parse_scene(scene_text(truth)),
        target,
        ["ball.ior", "ball.center"],
        options=FitOptions(search=False, fit_exposure=film),
        storage=storage,
    )
    right = {"ball.ior": truth.ior, **{f"ball.center.{axis}": x for axis, x in zip("xyz", truth.center, strict=True)}}
    right |= {"film.gain.r": truth.gain, "film.offset.r": truth.offset}
    off = {key: estimate.value - right[key] for key, estimate in result.parameters.items()}
    return {
        "kind": name,
        "film": film,
        "number": number,
        "status": result.status,
        "message": result.message,
        "off": off,
        "error": {key: estimate.error for key, estimate in result.parameters.items()},
        "noise_error": dict(zip(result.names, map(float, result.standard_error), strict=True)),
        "samples": result.target_samples,
        "seconds": round(time.monotonic() - begun, 1),
        "cpu": round(time.process_time() - cpu, 1),
    }


def rows_of(path: Path) -> list[dict]:
    """The rows that were written so far."""
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def scores(rows: list[dict]) -> np.ndarray:
    """The errors of all numbers in error bars, where there is one."""
    z = np.array([off / row["error"][name] for row in rows for name, off in row["off"].items() if row["error"][name]])
    return z[np.isfinite(z)]


def by_kind(rows: list[dict]) -> Iterator[tuple[str, list[dict]]]:
    """The rows of each kind, without and with the film's numbers free."""
    for film in (False, True):
        for name in KINDS:
            some = [row for row in rows if row["kind"] == name and row["film"] == film]
            if some:
                yield name + (", gain and offset free" if film else ""), some


def print_table(rows: list[dict], write: Callable[[str], None] = print) -> None:
    """One line a kind, as Markdown."""
    write("| target | fits | rms of z | above 2 | largest | converged | median error of the index | CPU s |")
    write("|---|---|---|---|---|---|---|---|")
    for name, some in by_kind(rows):
        z = np.abs(scores(some))
        converged = np.mean([row["status"] == "converged" for row in some])
        error = np.median([row["error"]["ball.ior"] for row in some])
        write(
            f"| {name} | {len(some)} | {np.sqrt(np.mean(z**2)):.2f} | {np.mean(z > 2):.1%} | {z.max():.1f} | "
            f"{converged:.0%} | {error:.1e} | {np.median([row['cpu'] for row in some]):.0f} |"
        )


def draw_histogram(rows: list[dict], path: Path) -> None:
    """The z of each kind beside the normal distribution."""
    import matplotlib.pyplot as plt

    kinds = list(by_kind(rows))
    columns = 4
    figure, axes = plt.subplots(-(-len(kinds) // columns), columns, figsize=(11, 1.1 + 1.5 * len(kinds) / columns))
    at = np.linspace(-4, 4, 81)
    for axis in np.ravel(axes)[len(kinds) :]:
        axis.set_axis_off()
    for axis, (name, some) in zip(np.ravel(axes), kinds, strict=False):
        axis.hist(np.clip(scores(some), -4, 4), bins=np.linspace(-4, 4, 25), density=True, color="#7a9cc6")
        axis.plot(at, np.exp(-(at**2) / 2) / np.sqrt(2 * np.pi), color="#333333", linewidth=1)
        axis.set_title(name.replace(", ", "\n", 1), fontsize=8)
        axis.tick_params(labelsize=7)
        axis.set_yticks([])
    figure.supxlabel("(estimate - truth) / error", fontsize=8)
    figure.tight_layout()
    figure.savefig(path, dpi=130)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("action", choices=("run", "table"))
    parser.add_argument("kinds", nargs="*", metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--fits", type=int, default=40, help="of each kind")
    parser.add_argument("--film", action="store_true", help="with the film's gain and offset free")
    parser.add_argument("--results", type=Path, default=HERE / "calibration.jsonl")
    parser.add_argument("--histogram", type=Path, metavar="PNG")
    given = parser.parse_args()
    if given.action == "run":
        import jax

        jax.config.update("jax_enable_x64", True)
        # Numbers go first, so that all kinds have some fits early.
        for number in range(given.fits):
            for name in given.kinds or KINDS:
                done = {(row["kind"], row["film"], row["number"]) for row in rows_of(given.results)}
                if (name, given.film, number) in done:
                    continue
                row = run_fit(name, given.film, number)
                with given.results.open("a") as file:
                    file.write(json.dumps(row) + "\n")
                z = {key: round(float(off / (row["error"][key] or np.nan)), 2) for key, off in row["off"].items()}
                print(f"{name} {number}: {row['status']}, z {z}, {row['seconds']} s, CPU {row['cpu']} s", flush=True)
    print_table(rows_of(given.results))
    if given.histogram:
        draw_histogram(rows_of(given.results), given.histogram)
