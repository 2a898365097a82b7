"""How well is an index read off a photograph? The rooms of `rooms.py`, by corners alone and with the fit.

    python experiments/photograph/lab.py FOLDER [--numbers 1 2 ...] [--cases quick exact alone three fit]

FOLDER has the rooms. `lab.json` there gets each row at once, and a row that is in there is not made again; then the
table is printed. Cases: `quick`, by corners, radius known to 0.1 % and off by as much, the board printed 0.1 % wrong,
which nobody knows, the lens calibrated; `exact`, the same with radius and print known to 0.01 %; `alone`, as `exact`,
the lens from the photograph itself; `three`, as `exact`, of the ball's three places together; `fit`, as `exact`, then
the fit of the light, and both joined.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from raytrace_jax import RenderSettings, enable_compile_cache, fit, read_picture  # noqa: E402
from raytrace_jax.errors import RaytraceError  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.find_camera import calibrate  # noqa: E402
from raytrace_jax.photo.flattened import flatten  # noqa: E402
from raytrace_jax.photo.lens import read_lens, uncalibrated, write_lens  # noqa: E402
from raytrace_jax.photo.locate import locate_together  # noqa: E402
from raytrace_jax.photo.opinions import combine  # noqa: E402
from raytrace_jax.photo.photograph import photograph_of  # noqa: E402
from raytrace_jax.photo.room_scene import light_options, room_scene  # noqa: E402
from raytrace_jax.util.digits import with_error  # noqa: E402

CASES = ("quick", "exact", "alone", "three", "fit")
KNOWN, EXACT = 1e-3, 1e-4


def run(number: int, case: str, folder: Path) -> dict:
    """A row: the index, its error and the truth."""
    truth = json.loads((folder / f"room_{number}.json").read_text())
    begun = time.monotonic()
    board = read_board(folder / f"board_{number}.txt")
    names = [f"room_{number}{place}.jpg" for place in (("", "_2", "_3") if case == "three" else ("",))]
    images = [read_picture(folder / name) for name in names]
    photographs = [photograph_of(image, name) for image, name in zip(images, names, strict=True)]
    share, scale = (KNOWN, 1.0) if case == "quick" else (EXACT, truth["print_scale"])
    drawn = np.random.default_rng(4000 + number).normal()
    radius = truth["radius"] * (1 + share * drawn) / scale
    # Both the ruler of the radius and the printer err.
    known = (radius, radius * share * np.sqrt(2))
    lens = uncalibrated() if case == "alone" else lens_of(truth["camera"], photographs[0].size, folder)
    together = locate_together(photographs, board, {"radius": known}, lens)
    left_out = [result.reason for result in together.photographs if result.reason]
    if not together.located:
        return {"refused": left_out[0]}
    located = together.located[0]
    index, error = located.ior
    row = {"truth": truth["ior"], "index": index, "error": error, "scatter": located.sigma, "left_out": left_out}
    row |= {
        "single": [result.index_alone for result in together.photographs if result.located],
        "fov": float(located.setup.camera.fov - truth["fov"]),
    }
    row["corners"] = [len(located.direct.pixels), len(located.through.pixels)]
    if case == "fit":
        flat = flatten(images[0], located)
        room = room_scene([located], [flat], [np.eye(len(located.covariance))], located.covariance)
        options = light_options(room)
        settings = RenderSettings(crop=flat.grid.window)
        result = fit(room.scene, flat.image, room.free, settings, options=options, weights=flat.counts.astype(float))
        found = result["ball.ior"]
        row |= {"by_corners": (index, error), "index": found.value, "error": found.error, "status": result.status}
        both = combine(room, result)
        row |= {"both": both.ior, "apart": both.apart, "causes": [cause.words for cause in result.check.causes]}
    return row | {"seconds": time.monotonic() - begun}


def lens_of(camera: int, size, folder: Path):
    """The lens of a camera, calibrated once."""
    path = folder / f"camera_{camera}.toml"
    if not path.exists():
        board = read_board(folder / (folder / f"camera_{camera}.txt").read_text().strip())
        pictures = sorted(folder.glob(f"camera_{camera}_*.jpg"))
        found = calibrate([photograph_of(read_picture(one), one.name) for one in pictures], board)
        write_lens(path, found.lens, found.size, f"camera {camera}")
    return read_lens(path, size)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--numbers", type=int, nargs="+", default=list(range(1, 13)))
    parser.add_argument("--cases", nargs="+", choices=CASES, default=["quick", "exact"])
    given = parser.parse_args()
    enable_compile_cache()
    path = given.folder / "lab.json"
    rows = json.loads(path.read_text()) if path.exists() else {}
    for case in given.cases:
        for number in given.numbers:
            key = f"{number} {case}"
            if key in rows:
                continue
            try:
                rows[key] = run(number, case, given.folder)
            except RaytraceError as reason:
                rows[key] = {"refused": str(reason)}
            path.write_text(json.dumps(rows, indent=1))
            print(line(key, rows[key]), flush=True)
    print("\n| room | case | truth | index | off | in its errors | s | fit |\n|---|---|---|---|---|---|---|---|")
    for key, row in rows.items():
        print(line(key, row))


def line(key: str, row: dict) -> str:
    """A row of the table."""
    head = "| " + " | ".join(key.split())
    if "refused" in row:
        return f"{head} | {row['refused']} |" + " |" * 5
    off = row["index"] - row["truth"]
    fitted = f"{len(row['left_out'])} left out" if row["left_out"] else ""
    if "apart" in row:
        by_corners, both = (with_error(*row[name]) for name in ("by_corners", "both"))
        fitted = f"{row['status']}, apart by {row['apart']:.1f}; corners {by_corners}, both {both}"
    return (
        f"{head} | {row['truth']} | {with_error(row['index'], row['error'])} | {off:+.5f} | "
        f"{abs(off) / row['error']:.1f} | {row['seconds']:.0f} | {fitted} |"
    )


if __name__ == "__main__":
    main()
