"""How well is the index of a liquid read off a photograph of its tank? The tanks of `tanks.py`.

    python experiments/photograph/tank_lab.py FOLDER [NUMBER ...] [--wedge DEGREES]

The lens is calibrated from FOLDER's pictures. Thickness, walls and ruler are stated as a caliper and a ruler tell them,
to .02, .02 and .01 mm, and off by random draws of as much. By how much walls are out of parallel has a standard
deviation before of .2 degrees; 0 takes them as parallel, in rows of its own. `tanks_read.json` in FOLDER gets each row
at once, and a row that is in there is not made again; then the table is printed.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np

jax.config.update("jax_enable_x64", True)

from raytrace_jax import enable_compile_cache, read_picture  # noqa: E402
from raytrace_jax.errors import RaytraceError  # noqa: E402
from raytrace_jax.photo.boards import read_board  # noqa: E402
from raytrace_jax.photo.find_camera import calibrate  # noqa: E402
from raytrace_jax.photo.lens import LensPrior, read_lens, write_lens  # noqa: E402
from raytrace_jax.photo.locate import locate_together  # noqa: E402
from raytrace_jax.photo.opinions import budget  # noqa: E402
from raytrace_jax.photo.photograph import Photograph, photograph_of  # noqa: E402
from raytrace_jax.util.digits import with_error  # noqa: E402

CALIPER = {"thickness": 0.02, "wall": 0.02, "ruler": 0.01}
"""Standard deviations of what is measured, in millimetres; the ruler is 100 mm long."""


def taken(path: Path) -> Photograph:
    return photograph_of(read_picture(path), path.name)


def lens_of(camera: int, size: tuple[int, int], folder: Path) -> LensPrior:
    """The camera's lens, calibrated once."""
    kept = folder / f"tank_camera_{camera}.toml"
    if not kept.exists():
        board = read_board(folder / (folder / f"tank_camera_{camera}.txt").read_text().strip())
        found = calibrate([taken(path) for path in sorted(folder.glob(f"tank_camera_{camera}_?.jpg"))], board)
        write_lens(kept, found.lens, found.size, "By tank_lab.py.")
    return read_lens(kept, size)


def run(number: int, folder: Path, wedge: float) -> dict:
    """A row: the index, its error, the parts of that, and the truth."""
    truth = json.loads((folder / f"tank_{number}.json").read_text())
    board, photograph = read_board(folder / f"tank_board_{number}.txt"), taken(folder / f"tank_{number}.jpg")
    off = np.random.default_rng(5000 + number).normal(size=3)
    stated = {name: truth[name] + CALIPER[name] * by for name, by in zip(CALIPER, off, strict=True)}
    # On the board the ruler is 100 mm long.
    share = 100 / stated["ruler"]
    spread = {name: np.hypot(CALIPER[name] * share, stated[name] * share * 1e-4) for name in ("thickness", "wall")}
    measured = {"thickness": (stated["thickness"] * share, spread["thickness"])}
    measured["wedge"] = (0.0, np.radians(wedge))
    if truth["wall"]:
        measured |= {"wall": (stated["wall"] * share, spread["wall"]), "wall_index": (truth["wall_ior"], 0.0)}
    lens, begun = lens_of(truth["camera"], photograph.size, folder), time.monotonic()
    try:
        together = locate_together([photograph], board, measured, lens)
    except RaytraceError as refusal:
        return {"refused": str(refusal)}
    if together.adjusted is None:
        return {"refused": together.photographs[0].reason}
    (located,) = together.located
    index, error = located.ior
    corners = [len(located.direct.pixels), len(located.through.pixels)]
    return {
        "truth": truth["ior"], "index": index, "error": error, "parts": budget(together.adjusted).parts,
        "wedge": np.degrees(located.setup.glass.wedge).tolist(), "gap": float(located.setup.glass.center[2]),
        "corners": corners, "scatter": located.sigma, "seconds": time.monotonic() - begun,
    }  # fmt: skip


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("numbers", type=int, nargs="*", default=range(1, 11))
    parser.add_argument("--wedge", type=float, default=0.2)
    given = parser.parse_args()
    enable_compile_cache()
    kept = given.folder / "tanks_read.json"
    rows = json.loads(kept.read_text()) if kept.exists() else {}
    for number in given.numbers:
        row = f"{number}" if given.wedge else f"{number}="
        if row not in rows:
            rows[row] = run(number, given.folder, given.wedge)
            kept.write_text(json.dumps(rows, indent=1))
    print("tank  truth   read         off    errors  of corners  of sizes  corners   seconds")
    for number, row in rows.items():
        if "refused" in row:
            print(f"{number:4s}  {row['refused']}")
            continue
        off, parts = row["index"] - row["truth"], row["parts"]
        sizes = np.hypot(parts["thickness and ruler"], parts.get("walls", 0.0))
        told = f"{number:4s}  {row['truth']:.4f}  {with_error(row['index'], row['error']):11s}  {1e3 * off:+.2f}e-3"
        told += f"  {off / row['error']:+.1f}  {parts['corners']:10.1e}  {sizes:8.1e}  {row['corners']}"
        print(f"{told}  {row['seconds']:.0f}")


if __name__ == "__main__":
    main()
