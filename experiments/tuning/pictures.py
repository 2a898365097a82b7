"""What the tracer's numbers are for: edge-aware pictures and their derivatives, beside supersampled ones."""

import dataclasses
import inspect
import pathlib
from collections.abc import Iterator

import jax
import jax.numpy as jnp
import numpy as np
from replacing import replaced

from raytrace_jax import RenderSettings, load_scene, render, set_parameters
from raytrace_jax.report.differences import correlation, finite_differences, relative_error
from raytrace_jax.tracer.integrator import RAYS_A_PLACE, Wavefront, trace
from raytrace_jax.tracer.level import trace_level
from raytrace_jax.tracer.pixels import picture_pixels
from raytrace_jax.tracer.settings import resolve_settings
from raytrace_jax.tracer.world import prepare_world
from raytrace_jax.util.compilation import forget_programs, jit

EXPERIMENTS = pathlib.Path(__file__).resolve().parent.parent
HEAD = ("scene", "number", "value", "picture RMS, 1/1000", "d/d index", "corr", "d/d position", "corr", "rays a pixel")
SAMPLES = 48
ROOM = 32
"""Rays a pixel that find room: enough for all values, so that one program serves them."""

INSIDE = np.s_[..., 1:-1]
"""The first and the last column show where two planes of the course's scenes end exactly: rounding decides them."""


@dataclasses.dataclass(frozen=True)
class Case:
    """A scene, two of its parameters, and how far each moves to either side in the reference."""

    path: pathlib.Path
    steps: dict[str, float]


CASES = {
    "assignment": Case(EXPERIMENTS.parent / "data" / "vitreous.txt", {"vitreous.ior": 2e-3, "vitreous.center.x": 8e-3}),
    "bubble in glass": Case(
        EXPERIMENTS / "edge_gradients" / "scenes" / "bubble.txt", {"glass.ior": 4e-3, "glass.center.x": 8e-3}
    ),
}

TRACED: dict[str, tuple[float, ...]] = {
    "tracer.geometry.shapes:FADE_COS": (0.4, 0.2, 0.8),
    "tracer.geometry.shapes:GRAZING": (1e-3, 1e-4, 1e-2),
    "tracer.geometry.footprints:LEAST_SPREAD": (0.002, 0.0005, 0.001, 0.004, 0.008),
}
"""Numbers of which a program can be told while it runs, with their values, the usual one first."""

SUBDIVISIONS = (2, 0, 1, 3)
"""Values of `SUBDIVISIONS`, for each of which programs are made anew, the usual one first."""


class Bench:
    """One scene with its references, ready to be rendered with any values of the numbers.

    Args:
        case: the scene.
        size: of the picture.
    """

    def __init__(self, case: Case, size: tuple[int, int]):
        self.size = size
        self.scene, self.names = load_scene(case.path), tuple(case.steps)
        how = RenderSettings(size=size, samples=SAMPLES)
        self.reference = np.asarray(render(self.scene, how).image)[INSIDE]
        self.differences = [
            finite_differences(self.scene, [name], how, step=step, samples=SAMPLES)[0][INSIDE]
            for name, step in case.steps.items()
        ]
        self.values = jnp.stack([self.scene[name] for name in self.names])
        self.settings = resolve_settings(self.scene, RenderSettings(size=size, edges="aware"))
        self.prepare()

    def prepare(self) -> None:
        """Make the program anew."""
        forget_programs()
        points, step = picture_pixels(self.scene, self.settings)
        pixels = points.shape[1]
        # As many places as whole chunks of a queue with that room have.
        places = -(-ROOM * pixels // RAYS_A_PLACE // 512) * 512
        padded = jnp.pad(points, ((0, 0), (0, places - pixels)))

        @jit
        def program(numbers, values, direction, scene):
            def image(values):
                moved = set_parameters(scene, {name: values[k] for k, name in enumerate(self.names)})
                world = prepare_world(moved, self.settings)
                front = Wavefront(world, moved.camera, padded, jnp.asarray(step), jnp.int32(pixels))
                traced = trace(front)
                return traced.color[:, :pixels].reshape(3, *self.size[::-1]), traced.traced

            # A jitted level would keep the numbers of its first trace.
            plain = {"tracer.integrator:trace_level": inspect.unwrap(trace_level)}
            with replaced({**numbers, **plain}):
                return jax.jvp(image, (values,), (direction,), has_aux=True)

        self.program = program

    def row(self, numbers: dict[str, float]) -> list[str]:
        """Error of the picture, relative errors of the derivatives, rays a pixel."""
        usual = {address: values[0] for address, values in TRACED.items()} | numbers
        arrays = {address: jnp.asarray(value) for address, value in usual.items()}
        errors, image, rays = [], None, 0.0
        for direction, difference in zip(np.eye(len(self.names)), self.differences, strict=True):
            image, derivative, traced = self.program(arrays, self.values, jnp.asarray(direction), self.scene)
            rays = int(traced) / (self.size[0] * self.size[1])
            if rays > ROOM:
                return ["no room"]
            derivative = np.asarray(derivative)[INSIDE]
            errors += [relative_error(derivative, difference), correlation(derivative, difference)]
        error = float(np.sqrt(np.mean((np.asarray(image)[INSIDE] - self.reference) ** 2)))
        return [f"{1e3 * error:.3f}", *(f"{error:.3f}" for error in errors), f"{rays:.2f}"]


def rows(name: str, size: tuple[int, int]) -> Iterator[list[str]]:
    """The table's rows for one scene."""
    bench = Bench(CASES[name], size)
    for address, values in TRACED.items():
        for value in values:
            yield [name, f"`{address.split(':')[1]}`", f"{value:g}", *bench.row({address: value})]
    for value in SUBDIVISIONS:
        with replaced({"tracer.settings:SUBDIVISIONS": value}):
            bench.prepare()
            yield [name, "`SUBDIVISIONS`", str(value), *bench.row({})]
