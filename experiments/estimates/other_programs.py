"""Fit a picture that another program rendered, as OpenEXR and as an 8-bit PNG, from several starts.

    python experiments/estimates/other_programs.py [--kinds OpenEXR "8-bit PNG"] [--starts NAME ...]
        [--crop LEFT TOP WIDTH HEIGHT]

The picture is data/course_schlick_moved.exr, 640 x 480, made with index 1.45 and center 4.15 2.45 -1.25.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

import jax
import numpy as np
from basin import CASES

from raytrace_jax import RenderSettings, fit, load_scene, read_picture, set_parameters
from raytrace_jax.images.png import write_png

FREE = ["vitreous.ior", "vitreous.center"]
TRUTH = np.array([1.45, 4.15, 2.45, -1.25])
KINDS = ("OpenEXR", "8-bit PNG")
STARTS = {
    "the scene's": (1.337, (4.3, 2.3, -1.0)),
    "index 1.1, center 0.5 away": (1.1, (4.45, 2.15, -1.51)),
    "index 2.2, center 0.5 away": (2.2, (3.9, 2.8, -1.0)),
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kinds", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--starts", nargs="+", choices=STARTS, default=list(STARTS), metavar="NAME")
    crop = {"nargs": 4, "type": int, "metavar": ("LEFT", "TOP", "WIDTH", "HEIGHT"), "default": (0, 0, 640, 480)}
    parser.add_argument("--crop", **crop, help="what is fitted of the picture; default: all of it")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    path = CASES["assignment"].path
    scene, exact = load_scene(path), read_picture(path.parent / "course_schlick_moved.exr")
    left, top, width, height = crop = tuple(arguments.crop)
    exact = exact[:, top : top + height, left : left + width]
    with tempfile.TemporaryDirectory() as folder:
        write_png(Path(folder) / "target.png", exact)
        quantized = read_picture(Path(folder) / "target.png")
    print("| target | start | status | error of ior | of center | standard errors | minima | seconds |\n|" + "---|" * 8)
    for kind, target in zip(KINDS, (exact, quantized), strict=True):
        if kind not in arguments.kinds:
            continue
        for name in arguments.starts:
            ior, center = STARTS[name]
            began = time.perf_counter()
            start = set_parameters(scene, {"vitreous.ior": ior, "vitreous.center": center})
            result = fit(start, target, FREE, RenderSettings(crop=crop))
            error = result.value - TRUTH
            print(
                f"| {kind} | {name} | {result.status} | {error[0]:+.1e} | {np.max(np.abs(error[1:])):.1e} "
                f"| {result.standard_error[0]:.1e}, {np.max(result.standard_error[1:]):.1e} "
                f"| {1 + len(result.runner_ups)} | {time.perf_counter() - began:.0f} |",
                flush=True,
            )


if __name__ == "__main__":
    sys.exit(main())
