"""Pictures, derivatives and rays of a scene whose numbers move: each kind is compiled once."""

import dataclasses
import io
import math
from collections.abc import Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import matplotlib.colors
import matplotlib.ticker
import numpy as np
from jaxtyping import Float
from PIL import Image

from raytrace_jax.images.options import Transfer
from raytrace_jax.report.gradient_figure import scale_limit
from raytrace_jax.report.panels import SIGNED, as_pixels, signed_pixels
from raytrace_jax.report.ray_figure import draw_tree
from raytrace_jax.scene.parameters import get_parameter, resolve, set_parameters
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import EdgeMode
from raytrace_jax.tracer.pure import make_renderer
from raytrace_jax.tracer.ray_tree import trace_tree
from raytrace_jax.tracer.resolved_settings import ResolvedSettings
from raytrace_jax.util.text import format_number

ROOM = 2.5
"""Room for more rays than the scene at the start has, as a factor: a ball that moves nearer needs it."""


class Slider(NamedTuple):
    """A number that moves, from `start` to `stop`."""

    name: str
    start: float
    stop: float

    @property
    def decimals(self) -> int:
        """The digits after the point of a step: 0.001, or a finer power of ten where that is needed for 1000 steps."""
        return max(3, -math.floor(math.log10((self.stop - self.start) / 1000)))

    @property
    def step(self) -> float:
        """How far the number moves at least."""
        return float(f"1e-{self.decimals}")

    def widened(self) -> "Slider":
        """The slider whose ends lie on whole steps, so that all its numbers are short."""
        ten = 10.0**self.decimals
        start, stop = math.floor(self.start * ten) / ten, math.ceil(self.stop * ten) / ten
        return self._replace(start=start, stop=stop)


class Scale(NamedTuple):
    """What the colours of a derivative mean.

    Args:
        limit: the value of the last colour; minus this is that of the first.
        ticks: round values within.
        unit: of the parameter, for people.
        beyond: the share of the pixels that exceed the scale, of those that depend on the parameter.
    """

    limit: float
    ticks: tuple[float, ...]
    unit: str
    beyond: float


class Studio:
    """Shows one scene.

    Args:
        scene: concrete values.
        settings: what is rendered.
        sliders: what moves.
        transfer: of the pictures.
        edges: whether derivatives see edges move; those that do take ten times as long.

    Attributes:
        compiled: what has been made before: "picture", "derivative", "rays". Anything else is compiled first.
    """

    def __init__(
        self,
        scene: Scene,
        settings: ResolvedSettings,
        sliders: tuple[Slider, ...],
        transfer: Transfer,
        edges: EdgeMode = "point",
    ):
        # The picture itself is not differentiated: its renderer needs no room for a derivative.
        settings = dataclasses.replace(settings, edges=settings.edges or "point")
        self.scene, self.settings, self.sliders = scene, settings, sliders
        self.transfer: Transfer = transfer
        self.edges: EdgeMode = edges
        self.renderer = make_renderer(scene, settings, ROOM)
        derived = dataclasses.replace(settings, edges=edges)
        self.derived = self.renderer if derived == settings else make_renderer(scene, derived, ROOM)
        self.derive = self._compile()
        self.compiled: set[str] = set()

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

    def values(self, scene: Scene) -> dict[str, str]:
        """What a scene has of the numbers that move, written so that reading it gives the same bits."""
        numbers = {slider.name: np.asarray(get_parameter(scene, slider.name)) for slider in self.sliders}
        return {name: format_number(number.dtype.type(number)) for name, number in numbers.items()}

    def moved(self, values: Mapping[str, float]) -> Scene:
        """The scene with other values. Raises ParameterError for a value that cannot be."""
        return set_parameters(self.scene, values)

    def picture(self, scene: Scene) -> bytes:
        """The picture as PNG."""
        image = np.asarray(self.renderer(scene).image)
        self.compiled.add("picture")
        return as_png(as_pixels(image, self.transfer))

    def derivative(self, scene: Scene, name: str) -> tuple[bytes, Scale]:
        """The derivative by a number as PNG, the mean of R, G and B, and what its colours mean."""
        number = jnp.asarray(get_parameter(scene, name))
        _, tangent = jax.jvp(lambda x: set_parameters(scene, {name: x}), (number,), (jnp.ones_like(number),))
        _, columns, overflow = self.derive(scene, tangent)
        slack = ROOM
        while int(overflow):
            # The rays of this scene want more room than the program has that was traced.
            slack *= 1.5
            self.derived = make_renderer(scene, self.derived.settings, slack)
            self.derive = self._compile()
            _, columns, overflow = self.derive(scene, tangent)
        self.compiled.add("derivative")
        mean = np.nan_to_num(np.asarray(columns.mean(axis=0), np.float64))
        scale = scale_of(mean, resolve(scene, name).attribute.unit)
        return as_png(signed_pixels(mean, scale.limit)), scale

    def rays(self, scene: Scene, column: int, row: int) -> bytes:
        """The rays of a pixel of the whole picture as SVG."""
        settings = dataclasses.replace(self.settings, edges="point", samples=1)
        tree = trace_tree(scene, (column, row), settings)
        with io.BytesIO() as file:
            figure = draw_tree(tree, scene, f"pixel {column} {row}", settings)
            figure.savefig(file, format="svg", bbox_inches="tight", metadata={"Date": None})
            self.compiled.add("rays")
            return file.getvalue()


def scale_of(mean: Float[np.ndarray, "height width"], unit: str) -> Scale:
    """The colour scale of a derivative, with the limit of `gradient_figure`; 1 where nothing depends on the number."""
    limit = scale_limit(mean[None]) or 1.0
    ticks = matplotlib.ticker.MaxNLocator(6, steps=[1, 2, 2.5, 5, 10]).tick_values(-limit, limit)
    changed = np.abs(mean[mean != 0])
    beyond = float(np.mean(changed > limit)) if changed.size else 0.0
    return Scale(limit, tuple(float(tick) + 0.0 for tick in ticks if abs(tick) <= limit), unit, beyond)


def scale_colours(count: int = 33) -> list[str]:
    """Colours of the scale from its first to its last, as CSS writes them."""
    return [matplotlib.colors.to_hex(colour) for colour in SIGNED(np.linspace(0, 1, count))]


def as_png(pixels: np.ndarray) -> bytes:
    """8-bit pixels "height width 3" as a PNG, quickly compressed."""
    with io.BytesIO() as file:
        Image.fromarray(np.ascontiguousarray(pixels)).save(file, "png", compress_level=1)
        return file.getvalue()
