"""Fits of photographs: POV-Ray's light through the camera of chain.py, with that camera's numbers free, and fixed.

    python experiments/camera/fits.py FOLDER [NAME ...] [--cases "camera free" "camera fixed"] [--binning 1]
        [--output FOLDER]

FOLDER has the pictures of pictures.py, and gets the photographs. Each result is written to fits.json beside this file
as soon as it is there; a case that is in it is not run again. With `--output` both are written to that folder instead.
"""

import argparse
import json
import time
import warnings
from pathlib import Path

import jax
import numpy as np
from chain import CAMERA, photograph

import raytrace_jax as rt
from raytrace_jax.images.pictures import read_picture
from raytrace_jax.util.digits import with_error

RESULTS = Path(__file__).with_name("fits.json")
BALL = ["ball0.ior", "ball0.center"]
FREE = {
    "camera free": [*BALL, "film.gain", "film.blur", "film.vignetting"],
    "camera fixed": BALL,
}


def numbers_of(truth):
    """What the fit should find, by name."""
    found = {"ball0.ior": float(truth["ball0.ior"])}
    found |= dict(
        zip(("ball0.center.x", "ball0.center.y", "ball0.center.z"), map(float, truth["ball0.center"]), strict=True)
    )
    found |= dict(zip(("film.gain.r", "film.gain.g", "film.gain.b"), CAMERA.gains, strict=True))
    return found | {"film.blur": CAMERA.psf, "film.vignetting": CAMERA.vignetting}


def run(folder, name, case, seed, binning, photographs):
    """One fit, as a row."""
    picture = photographs / f"{name}.jpg"
    light = read_picture(folder / f"{name}.exr")
    light = light.reshape(3, light.shape[1] // binning, binning, -1, binning).mean((2, 4))
    photograph(light, CAMERA._replace(seed=seed), picture)
    truth, guess = (rt.load_scene(folder / f"{name}_{which}.txt") for which in ("truth", "guess"))
    start = time.monotonic()
    result = rt.fit(
        guess, read_picture(picture), FREE[case], rt.RenderSettings(binning=binning), storage=rt.jpeg_storage(picture)
    )
    wanted = numbers_of(truth)
    rows = list(zip(result.names, result.value, result.total_error, strict=True))
    return {
        "status": result.status,
        "seconds": round(time.monotonic() - start),
        "off": {name: float(value - wanted[name]) for name, value, _ in rows},
        "error": dict(zip(result.names, map(float, result.total_error), strict=True)),
        "causes": [cause.words for cause in result.check.causes],
    }


def main():
    """Run what is not in the file yet."""
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="FOLDER")
    parser.add_argument("names", nargs="*", metavar="NAME", help="default: all that the folder has")
    parser.add_argument("--cases", nargs="+", choices=FREE, default=list(FREE))
    parser.add_argument(
        "--binning", type=int, default=1, help="so many pixels of the picture a side are one of the camera"
    )
    parser.add_argument("--output", type=Path, metavar="FOLDER")
    given = parser.parse_args()
    folder, photographs = given.folder, given.output or given.folder
    names = given.names or sorted(path.name[: -len("_truth.txt")] for path in folder.glob("*_truth.txt"))
    results = given.output / RESULTS.name if given.output else RESULTS
    done = json.loads(results.read_text()) if results.exists() else {}
    for case in given.cases:
        for seed, name in enumerate(names):
            key = f"{name}, {case}" + (f", binned by {given.binning}" if given.binning > 1 else "")
            if key in done:
                continue
            done[key] = row = run(folder, name, case, seed, given.binning, photographs)
            results.write_text(json.dumps(done, indent=1) + "\n")
            off, error = row["off"]["ball0.ior"], row["error"]["ball0.ior"]
            worst = max(np.abs(row["off"][n]) / row["error"][n] for n in row["off"])
            print(
                f"{key}: {row['status']}, index off {with_error(off, error)}, worst {worst:.1f}, {row['seconds']} s; ",
                *row["causes"],
                flush=True,
            )


if __name__ == "__main__":
    main()
