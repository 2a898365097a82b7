"""Is a right model believed? Targets by POV-Ray, and photographs of some, each with the scene that made it.

    python experiments/physical/last_word.py FOLDER [CASE ...]

Needs the program `povray` (Debian package `povray`). FOLDER gets the pictures, and `last_word.json` with each row at
once; a case that is in there is not done again. Then the table is printed. A case is `BOARD, SIZE, SAMPLES`, with an
index and a place of the ball that are drawn by its number, or the same with `photo`, through the camera of
`experiments/camera`.
"""

import argparse
import itertools
import json
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE.parent / "camera"))
import pictures  # noqa: E402
from chain import CAMERA, photograph  # noqa: E402

SIZES, SAMPLES = {"320": (320, 240), "512": (512, 384)}, (8, 6)
BOARDS = {
    "checker": pictures.View(1.5, (0, 0, 0)),
    "image": pictures.View(1.5, (0, 0, 0), texture=f"{pictures.PAINTED} wrap repeat")._replace(**pictures.DIM),
    "two balls": pictures.View(1.5, (0, 0, 0), more=pictures.FLINT, texture=pictures.GREEN),
}
TARGETS = [
    f"{board}, {size}, {samples} x {samples}" for board, size, samples in itertools.product(BOARDS, SIZES, SAMPLES)
]
PHOTOS = [f"{name}, photo" for name in TARGETS if ", 320, " in name]
CASES = [*TARGETS, *PHOTOS]

BALL, FILM = ["ball0.ior", "ball0.center"], ["film.gain", "film.blur", "film.vignetting"]


def view_of(name: str) -> tuple[pictures.View, int]:
    """What a case shows, and the samples of its pixels a side."""
    target = name.removesuffix(", photo")
    board, size, samples = target.split(", ")
    random = np.random.default_rng(TARGETS.index(target))
    center = tuple(random.uniform(-0.2, 0.2, 3).round(3).tolist())
    view = BOARDS[board]._replace(ior=round(random.uniform(1.3, 1.9), 4), center=center, size=SIZES[size])
    return view, int(samples.split()[0])


def run(name: str, folder: Path) -> dict:
    """A row: errors, total errors, the last word."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import raytrace_jax as rt

    rt.enable_compile_cache()
    view, samples = view_of(name)
    place = folder / name.removesuffix(", photo").replace(", ", "_").replace(" ", "")
    truth = place.with_suffix(".txt")
    for file, picture in ((pictures.PAINT, pictures.paint), (pictures.SKY, pictures.soft_sky)):
        if not (folder / file).exists():
            rt.write_exr(folder / file, picture(), half=True)
    truth.write_text(pictures.scene_text(view, name))
    if not place.with_suffix(".exr").exists():
        pictures.SAMPLES = samples
        rt.write_exr(place.with_suffix(".exr"), pictures.render(truth, view.size))
    scene = rt.load_scene(truth)
    exact = {"ball0.ior": view.ior} | dict(
        zip(("ball0.center.x", "ball0.center.y", "ball0.center.z"), view.center, strict=True)
    )
    guess = rt.set_parameters(scene, {"ball0.ior": view.ior + 0.02, "ball0.center": np.add(view.center, 0.03)})
    light, free, storage = rt.read_picture(place.with_suffix(".exr")), BALL, None
    if name.endswith("photo"):
        photo = place.with_suffix(".jpg")
        photograph(light, CAMERA._replace(seed=CASES.index(name)), photo)
        light, free, storage = rt.read_picture(photo), [*BALL, *FILM], rt.jpeg_storage(photo)
    begun = time.monotonic()
    found = rt.fit(guess, light, free, options=rt.FitOptions(search=False), storage=storage)
    off = {name: float(found.value[found.names.index(name)] - value) for name, value in exact.items()}
    error = dict(zip(found.names, map(float, found.total_error), strict=True))
    return {
        "off": off,
        "error": error,
        "status": found.status,
        "grid": found.target_samples,
        "causes": [cause.words for cause in found.check.causes],
        "message": found.message,
        "seconds": round(time.monotonic() - begun),
    }


def table(rows: dict[str, dict]) -> None:
    """How far off the index is, and the worst number in total errors."""
    print("| case | index off by | total errors | grid | last word | s |\n|---|---|---|---|---|---|")
    good = 0
    for name, row in rows.items():
        worst = max(abs(off) / row["error"][key] for key, off in row["off"].items())
        good += row["status"] == "converged" and worst < 3
        off, word = row["off"]["ball0.ior"], row["status"]
        print(f"| {name} | {off:.1e} | {worst:.1f} | {row['grid']} | {word} | {row['seconds']} |")
    print(f"\n{good} of {len(rows)} converged and within three total errors")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("cases", nargs="*", metavar="CASE", help="; ".join(CASES))
    parser.add_argument("--one", action="store_true", help="run one case in this process and print its row")
    given = parser.parse_args()
    if given.one:
        warnings.simplefilter("ignore")
        print(json.dumps(run(given.cases[0], given.folder)))
        return
    given.folder.mkdir(parents=True, exist_ok=True)
    path = given.folder / "last_word.json"
    rows = json.loads(path.read_text()) if path.exists() else {}
    for name in given.cases or CASES:
        if name in rows:
            continue
        command = [sys.executable, __file__, str(given.folder), name, "--one"]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
        if done.returncode:
            print(f"{name}: {done.stderr[-2000:]}", file=sys.stderr)
            continue
        rows[name] = json.loads(done.stdout.splitlines()[-1])
        path.write_text(json.dumps(rows, indent=1))
        print(name, rows[name]["status"], rows[name]["off"]["ball0.ior"], rows[name]["seconds"], flush=True)
    table(rows)


if __name__ == "__main__":
    main()
