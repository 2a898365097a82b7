"""One accelerator: is it right, and how fast? `on_gpu.py OUT.json [TASK ...]`; `--expect` stores what the CPU gives.

The picture, the derivative and the fit are those of the assignment's scene, the first two at some pixels of a small
picture whose numbers `on_gpu_expected.json` has from a CPU in float64. `on_gpu.sh` runs this on a bare machine.
"""

import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from programs import FREE, SCENE, build, seconds, set_up

import raytrace_jax as rt

EXPECTED = Path(__file__).with_name("on_gpu_expected.json")
TARGET = SCENE.with_name("course_schlick_moved.exr")
TRUTH = (1.45, 4.15, 2.45, -1.25)
"""Index and centre of the target's glass ball (data/README.md)."""

SETTINGS = rt.RenderSettings(size=(80, 60), edges="aware")
SHOWN = np.index_exp[:, 3::9, 4::9]
"""The pixels whose numbers are kept."""

BOUNDS = {"64": (1e-9, 1e-6, 1e-6), "32": (2e-3, 2e-2, 1e-3)}
"""How far picture, derivatives (by their root mean square) and fitted values may be off, by the bits of a float."""

SHARE = {"64": 1.0, "32": 0.95}
"""Of the numbers this share is within the bound: in float32 a few pixels at edges are rounded to the other side."""

REPEATS = 5


def numbers(bits: str) -> dict[str, np.ndarray]:
    """A picture and its derivatives by the free numbers, at the pixels that are kept."""
    with jax.enable_x64(bits == "64"):
        scene = rt.load_scene(SCENE)
        found = rt.picture_derivatives(scene, FREE, SETTINGS)
        pictures = {"picture": found.image, **dict(zip(found.names, found.values, strict=True))}
        return {name: np.asarray(array, np.float64)[SHOWN] for name, array in pictures.items()}


def compare(bits: str) -> dict[str, object]:
    """How far the numbers of a precision are from the expected ones."""
    expected = {name: np.array(array) for name, array in json.loads(EXPECTED.read_text()).items()}
    found = numbers(bits)
    size = {name: 1.0 if name == "picture" else float(np.sqrt(np.mean(a**2))) for name, a in expected.items()}
    off = {name: np.abs(found[name] - array) / size[name] for name, array in expected.items()}
    worst = {name: float(np.quantile(array, SHARE[bits])) for name, array in off.items()}
    picture, derivative, _ = BOUNDS[bits]
    right = all(value <= (picture if name == "picture" else derivative) for name, value in worst.items())
    return {"off": worst, "right": bool(right)}


def fit(bits: str) -> dict[str, object]:
    """A fit of a picture by another program, twice: the second has its programs."""
    with jax.enable_x64(bits == "64"):
        scene, target = rt.load_scene(SCENE), rt.read_picture(TARGET)
        began = time.perf_counter()
        result = rt.fit(scene, target, FREE)
        first = time.perf_counter() - began
        again = time.perf_counter()
        rt.fit(scene, target, FREE)
        second = time.perf_counter() - again
    off = np.abs(np.asarray(result.value) - TRUTH)
    right = bool(result.status == "converged" and off.max() <= BOUNDS[bits][2])
    return {"status": result.status, "off": off.tolist(), "right": right, "first_s": first, "second_s": second}


def measure(name: str, bits: str) -> dict[str, float]:
    """First call of a program, and the median of some more."""
    with jax.enable_x64(bits == "64"):
        began = time.perf_counter()
        program = build(name)
        program()
        first = time.perf_counter() - began
        return {"first_s": first, "ms": 1e3 * statistics.median(seconds(program) for _ in range(REPEATS))}


def tasks() -> dict[str, Callable[[], dict]]:
    """By name what is done, in order: what is right first, then the speeds."""
    found: dict[str, Callable[[], dict]] = {}
    for bits in ("64", "32"):
        found[f"numbers, float{bits}"] = lambda bits=bits: compare(bits)
    for bits in ("64", "32"):
        for name in ("render", "jacobian", "gradient"):
            found[f"{name}, float{bits}"] = lambda name=name, bits=bits: measure(name, bits)
    for bits in ("64", "32"):
        found[f"fit, float{bits}"] = lambda bits=bits: fit(bits)
    return found


def main() -> int:
    set_up()
    if sys.argv[1:] == ["--expect"]:
        expected = {name: np.round(array, 13).tolist() for name, array in numbers("64").items()}
        EXPECTED.write_text(json.dumps(expected) + "\n")
        return 0
    out, *only = sys.argv[1:]
    device = jax.devices()[0]
    found: dict[str, object] = {"device": f"{jax.device_count()} x {device.device_kind}", "jax": jax.__version__}
    code = 0
    for name, task in tasks().items():
        if only and name not in only:
            continue
        try:
            found[name] = task()
        except KeyboardInterrupt:
            found[name] = "no time left"
        except Exception as reason:  # The others are still worth their time.
            found[name] = f"{type(reason).__name__}: {reason}"
        answer = found[name]
        code |= not isinstance(answer, dict) or not answer.get("right", True)
        print(f"{name}: {answer}", flush=True)
        Path(out).write_text(json.dumps(found, indent=1) + "\n")
        if answer == "no time left":
            break
    return int(code)


if __name__ == "__main__":
    sys.exit(main())
