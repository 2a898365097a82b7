"""Fits of targets that are not quite what the scene says: does the fit notice, name it, and do its errors hold?

    python experiments/estimates/mismatch.py [cases] [--only NAME ...] [--scene assignment|pebbles] [--size 160 120]
    python experiments/estimates/mismatch.py tolerances [--targets 40] [--sampling point]

`cases` fits targets in each of which one thing differs, with noise of 1/255 unless said otherwise. `tolerances` draws
radius, viewpoint, colours and lights at random around what the scene says, tells the fit how uncertain they are, and
compares its total errors with the scatter of the estimates.
"""

import argparse
import dataclasses
import io
import sys
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import NamedTuple

import jax
import numpy as np
from basin import CASES as SCENES
from PIL import Image
from scipy import ndimage

from raytrace_jax import FitOptions, RenderSettings, fit, list_parameters, load_scene, render, set_parameters
from raytrace_jax.inverse.options import TargetSampling
from raytrace_jax.scene.setting_words import PixelConvention

SIZE = (160, 120)
SIGMA = 1 / 255
FREE = ["vitreous.ior", "vitreous.center"]
ROLES = {
    "assignment": {
        "ball": "vitreous",
        "glass": "cyan",
        "camera": "cam1",
        "light": "topright",
        "other": "central",
        "wall": "rightwall.point.x",
    },
    "pebbles": {
        "ball": "ball",
        "glass": "glass",
        "camera": "camera1",
        "light": "left",
        "other": "pebble34",
        "wall": "back.point.z",
    },
}
"""What things are called in each scene."""
TOLERANCES = {"vitreous.radius": "0.2%", "cam1.viewpoint": "0.1%", "cyan": "0.5%", "lights": "0.3%"}
ELLIPSE_95 = 9.488
"""95 % quantile of the chi-square distribution with four degrees of freedom."""


class Case(NamedTuple):
    """A target.

    Args:
        factors, shifts: of parameters, from what the scene says; their blocks are named by `ROLES`.
        samples: a pixel and side.
        noise: its standard deviation.
        after: what happens to the picture.
        correlated: over how many pixels the noise goes together.
        mapping: where its pixels are.
    """

    factors: Mapping[str, float] = MappingProxyType({})
    shifts: Mapping[str, float] = MappingProxyType({})
    samples: int = 16
    noise: float = SIGMA
    after: Callable[[np.ndarray], np.ndarray] = lambda image: image
    correlated: float = 0.0
    mapping: PixelConvention = "corner"


def jpeg(image: np.ndarray) -> np.ndarray:
    """Through a JPEG of quality 85."""
    stream = io.BytesIO()
    pixels = (np.clip(image, 0, 1).transpose(1, 2, 0) * 255).round().astype("u1")
    Image.fromarray(pixels).save(stream, "JPEG", quality=85)
    return np.asarray(Image.open(stream)).transpose(2, 0, 1) / 255


def eight_bits(image: np.ndarray) -> np.ndarray:
    """Rounded to 8 bits."""
    return np.round(np.clip(image, 0, 1) * 255) / 255


def vignetting(image: np.ndarray) -> np.ndarray:
    """A fiftieth darker at the middle of the left and right border."""
    row, column = np.mgrid[: image.shape[1], : image.shape[2]]
    height, width = image.shape[1:]
    return image * (1 - 0.08 * (((column - width / 2) / width) ** 2 + ((row - height / 2) / width) ** 2))


RADIUS = "{ball}.radius"
CASES = {
    "nothing": Case(),
    "nothing, without noise, 8 x 8 samples": Case(noise=0, samples=8),
    "nothing, 8 bits": Case(noise=0, after=eight_bits),
    "radius +0.2 %": Case({RADIUS: 1.002}),
    "radius +5 %": Case({RADIUS: 1.05}),
    "radius +0.01 %, without noise": Case({RADIUS: 1.0001}, noise=0),
    "radius +0.01 %, points without noise": Case({RADIUS: 1.0001}, noise=0, samples=1),
    "radius +0.01 %, points of 8 bits": Case({RADIUS: 1.0001}, noise=0, samples=1, after=eight_bits),
    "pixel mapping": Case(mapping="center"),
    "viewpoint z +0.5 %": Case({"{camera}.viewpoint.z": 1.005}),
    "viewpoint z +0.3 %": Case({"{camera}.viewpoint.z": 1.003}),
    "image plane +0.1 %": Case({"{camera}.worlddim": 1.001}),
    "alpha 0.01 less": Case(shifts={"{glass}.alpha": -0.01}),
    "a light 0.1 away": Case(shifts={"{light}.location.x": 0.1}),
    "another ball 0.02 away": Case(shifts={"{other}.center.x": 0.02}),
    "a wall 0.02 away": Case(shifts={"{wall}": 0.02}),
    "JPEG of quality 85": Case(noise=0, after=jpeg),
    "point-spread of 1 px": Case(after=lambda image: ndimage.gaussian_filter(image, (0, 1, 1))),
    "noise correlated over 1 px": Case(correlated=1.0),
    "exposure +1 %": Case(after=lambda image: 1.01 * image),
    "offset 0.01": Case(after=lambda image: image + 0.01),
    "gamma 1.01": Case(after=lambda image: np.clip(image, 0, None) ** 1.01),
    "vignetting of 2 %": Case(after=vignetting),
    "a shift of 0.1 px": Case(after=lambda image: ndimage.shift(image, (0, 0, 0.1), order=1, mode="nearest")),
}


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", nargs="?", choices=("cases", "tolerances"), default="cases")
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES), metavar="NAME")
    parser.add_argument("--scene", choices=ROLES, default="assignment")
    parser.add_argument("--size", nargs=2, type=int, default=SIZE, metavar=("W", "H"))
    parser.add_argument("--targets", type=int, default=40)
    parser.add_argument("--sampling", choices=("point", "box"), default="point")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_num_cpu_devices", 2)
    scene = load_scene(SCENES[arguments.scene].path)
    how = RenderSettings(size=tuple(arguments.size))
    if arguments.what == "tolerances":
        if arguments.scene != "assignment":
            parser.error("the tolerances are those of the assignment's scene")
        tolerances(scene, how, arguments.targets, arguments.sampling, arguments.seed)
        return
    print("| the target differs by | status | error / standard error | error / total error | looks like |")
    print("|---|---|---|---|---|", flush=True)
    for name in arguments.only:
        print(f"| {name} | {row(scene, how, CASES[name], ROLES[arguments.scene])} |", flush=True)


def row(scene, how: RenderSettings, case: Case, roles: Mapping[str, str]) -> str:
    """The cells of one case; errors are the worst of the four numbers."""
    factors, shifts = ({k.format(**roles): v for k, v in each.items()} for each in (case.factors, case.shifts))
    wrong = {
        name: np.asarray(scene[name]) * factors.get(name, 1.0) + shifts.get(name, 0.0) for name in {*factors, *shifts}
    }
    free = [f"{roles['ball']}.ior", f"{roles['ball']}.center"]
    seen = dataclasses.replace(how, samples=case.samples, mapping=case.mapping)
    image = case.after(np.asarray(render(set_parameters(scene, wrong), seen).image))
    noise = np.random.default_rng(0).normal(0, 1, image.shape)
    if case.correlated:
        noise = ndimage.gaussian_filter(noise, (0, case.correlated, case.correlated))
    target = image + case.noise * noise / noise.std()
    options = FitOptions(search=False, target_sampling="point" if case.samples == 1 else "box")
    result = fit(scene, target, free, how, options=options)
    errors = np.abs(result.value - truth(scene, result.names))
    worst = [f"{np.max(errors / bar):.1f}" for bar in (result.standard_error, result.total_error)]
    causes = ", ".join(cause.words for cause in result.check.causes)
    return " | ".join((result.status, *worst, causes or "–"))


def truth(scene, names) -> np.ndarray:
    """What the scene says of some numbers."""
    return np.array([float(scene[name]) for name in names])


def tolerances(scene, how: RenderSettings, targets: int, sampling: TargetSampling, seed: int) -> None:
    """Total errors against scatter, where what is uncertain is said to be."""
    random, errors, totals, alone, inside, statuses = np.random.default_rng(seed), [], [], [], 0, []
    names, sampled = (), dataclasses.replace(how, samples=1 if sampling == "point" else 16)
    spreads = fit_spreads(scene)
    for _ in range(targets):
        moved = {
            name: value + random.normal(size=value.shape) * spreads[name] for name, value in parameters(scene, spreads)
        }
        target = np.asarray(render(set_parameters(scene, moved), sampled).image)
        target = target + random.normal(0, SIGMA, target.shape)
        options = FitOptions(search=False, target_sampling=sampling, uncertain=TOLERANCES)
        result = fit(scene, target, FREE, how, options=options)
        names = result.names
        error, total = result.value - truth(scene, names), result.total_error
        covariance = result.total_correlation * np.outer(total, total)
        inside += bool(error @ np.linalg.solve(covariance, error) <= ELLIPSE_95)
        errors.append(error)
        totals.append(total)
        alone.append(result.standard_error)
        statuses.append(result.status)
    print("| number | sd of the errors | total error / sd | standard error alone / sd |\n|---|---|---|---|")
    spread = np.std(errors, axis=0)
    for k, name in enumerate(names):
        ratio = np.sqrt(np.mean(np.array(totals)[:, k] ** 2)) / spread[k]
        print(f"| {name} | {spread[k]:.1e} | {ratio:.2f} | {alone[-1][k] / spread[k]:.2f} |")
    words = ", ".join(f"{statuses.count(word)} {word}" for word in sorted(set(statuses)))
    print(f"\n{inside} of {targets} in the 95 % ellipse; {words}")


def fit_spreads(scene) -> dict[str, np.ndarray]:
    """The standard deviation of each number that `TOLERANCES` says is uncertain, by parameter."""
    found = {}
    lights = ["centerback", "backleft", "topright"]
    blocks = {"lights": lights, "cyan": ["cyan"]}
    for name, share in TOLERANCES.items():
        amount = float(share.removesuffix("%")) / 100
        whole = [p for block in blocks.get(name, []) for p in list_parameters(scene) if p.partition(".")[0] == block]
        for parameter in whole or [name]:
            value = np.asarray(scene[parameter])
            if parameter != "cyan.ior":
                found[parameter] = amount * np.linalg.norm(value)
    return found


def parameters(scene, names) -> list[tuple[str, np.ndarray]]:
    """The values of some parameters."""
    return [(name, np.asarray(scene[name])) for name in names]


if __name__ == "__main__":
    sys.exit(main())
