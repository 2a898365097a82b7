"""Pictures, derivatives and rays of a scene whose numbers move: each kind is compiled once."""

import dataclasses
import io
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from jaxtyping import Array, Float
from PIL import Image

from raytrace_jax.images.options import Transfer
from raytrace_jax.images.png import ENCODERS
from raytrace_jax.report.ray_figure import draw_tree
from raytrace_jax.scene.parameters import get_parameter, set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.ray_tree import trace_tree
from raytrace_jax.tracer.renderer import make_renderer
from raytrace_jax.tracer.resolved_settings import ResolvedSettings

ROOM = 2.5
"""Room for more rays than the scene at the start has, as a factor: a ball that moves nearer needs it."""

SHOWN = 99.5
"""Percentile of a derivative's magnitude at which its colours end: a few pixels at rims are far larger."""


class Slider(NamedTuple):
    """A number that moves, from `start` to `stop`."""

    name: str
    start: float
    stop: float


class Studio:
    """Shows one scene.

    Args:
        scene: concrete values.
        settings: what is rendered.
        sliders: what moves.
        transfer: of the pictures.
        edges: whether derivatives see edges move; those that do take ten times as long.
    """

    def __init__(
        self,
        scene: Scene,
        settings: ResolvedSettings,
        sliders: tuple[Slider, ...],
        transfer: Transfer,
        edges: EdgeMode = "point",
    ):
        self.scene, self.settings, self.sliders = scene, settings, sliders
        self.transfer: Transfer = transfer
        self.edges: EdgeMode = edges
        self.renderer = make_renderer(scene, settings, ROOM)
        derived = dataclasses.replace(settings, edges=edges)
        self.derived = self.renderer if derived == settings else make_renderer(scene, derived, ROOM)
        self.derive = self._compile()

    def _compile(self):
        """The picture, its derivative along a tangent of the scene, and the rays that found no room.

        One program serves all sliders; `picture_derivatives` would compile one for each.
        """

        def along(scene: Scene, tangent: Scene):
            def picture(scene: Scene):
                film = self.derived(scene)
                return film.image, film.overflow

            return jax.jvp(picture, (scene,), (tangent,), has_aux=True)

        return jax.jit(along)

    @property
    def values(self) -> dict[str, float]:
        """Where the sliders begin."""
        return {slider.name: float(get_parameter(self.scene, slider.name)) for slider in self.sliders}

    def moved(self, values: Mapping[str, float]) -> Scene:
        """The scene with other values. Raises ParameterError for a value that cannot be."""
        return set_parameters(self.scene, values)

    def picture(self, values: Mapping[str, float]) -> bytes:
        """The picture as PNG."""
        image = np.asarray(self.renderer(self.moved(values)).image)
        return as_png(np.moveaxis(ENCODERS[self.transfer](image), 0, -1))

    def derivative(self, values: Mapping[str, float], name: str) -> bytes:
        """The derivative by a number as PNG: the mean of R, G and B, red where it is positive, blue where negative."""
        scene = self.moved(values)
        number = jnp.asarray(get_parameter(scene, name))
        _, tangent = jax.jvp(lambda x: set_parameters(scene, {name: x}), (number,), (jnp.ones_like(number),))
        while True:
            _, columns, overflow = self.derive(scene, tangent)
            if not int(overflow):
                break
            # The rays of this scene want more room than the program has that was traced.
            self.derived.grow(scene)
            self.derive = self._compile()
        return as_png(signed_colours(columns.mean(axis=0)))

    def rays(self, values: Mapping[str, float], column: int, row: int) -> bytes:
        """The rays of a pixel as SVG."""
        scene, settings = self.moved(values), dataclasses.replace(self.settings, edges="point", samples=1)
        tree = trace_tree(scene, (column, row), settings)
        with io.BytesIO() as file:
            figure = draw_tree(tree, scene, f"pixel {column} {row}", settings)
            figure.savefig(file, format="svg", bbox_inches="tight", metadata={"Date": None})
            return file.getvalue()


def signed_colours(values: Float[Array, "height width"]) -> np.ndarray:
    """8-bit colours "height width 3" of signed values, symmetric about zero, white."""
    numbers = np.nan_to_num(np.asarray(values, np.float64))
    limit = float(np.percentile(np.abs(numbers), SHOWN)) or 1.0
    return matplotlib.colormaps["RdBu_r"]((numbers / limit + 1) / 2, bytes=True)[..., :3]


def as_png(pixels: np.ndarray) -> bytes:
    """8-bit pixels "height width 3" as a PNG, quickly compressed."""
    with io.BytesIO() as file:
        Image.fromarray(np.ascontiguousarray(pixels)).save(file, "png", compress_level=1)
        return file.getvalue()
