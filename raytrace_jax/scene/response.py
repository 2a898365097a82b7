"""The camera's response to the light of a scene, before its numbers are stored: an effect is a row of one table.

An effect changes a scene-linear picture; it is a function of the picture, of its value and of the frame, differentiable
in picture and value. Its value is a field of `structs.CameraResponse`: a parameter such as `film.gain.r`.
"""

import dataclasses
import itertools
from collections.abc import Callable, Container
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..images.filters import gaussian_blur
from ..util.compilation import jit
from ..util.numerics import with_lower_ranks
from .schema import Attribute, declared_attributes
from .structs import CameraResponse

FILM = "film"
"""The keyword of a response's block, the name of a block that no file names, and the response's field in a scene."""

LEAST_LIGHT = 1e-3
"""Below this fraction of white a power goes on as its tangent, as light of 0 or less has no power."""

Picture = Float[Array, "3 height width"]


class Frame(NamedTuple):
    """The part of a whole picture that a picture is.

    Args:
        left, top: the first column and row, in the picture's own pixels; a crop may begin between two of them.
        binning: how many pixels of the whole picture one of its own is wide.
        width, height: of the whole picture, in pixels.
    """

    left: float
    top: float
    binning: int
    width: int
    height: int


def from_middle(image: Picture, frame: Frame) -> tuple[Float[Array, " width"], Float[Array, "height 1"]]:
    """How far columns are to the right and rows below the whole picture's middle, in halves of its width and height."""
    height, width = image.shape[-2:]

    def halves(count: int, first: float, size: int) -> Float[Array, " count"]:
        return jnp.asarray(2 * frame.binning * (np.arange(count) + first + 0.5) / size - 1, image.dtype)

    return halves(width, frame.left, frame.width), halves(height, frame.top, frame.height)[:, None]


def lit(image: Picture, light: Float[Array, "5"], frame: Frame) -> Picture:
    """Light that is uneven: 1 and a quadratic, whose squares have no mean, so that a gain is no light."""
    u, v = from_middle(image, frame)
    x, y, xx, xy, yy = light
    return image * (1 + x * u + y * v + xx * (u**2 - 1 / 3) + xy * (u * v) + yy * (v**2 - 1 / 3))


def darken_corners(image: Picture, vignetting: Float[Array, ""], frame: Frame) -> Picture:
    """Vignetting: light is lost with the squared distance from the whole picture's middle."""
    u, v = from_middle(image, frame)
    across, along = frame.width**2, frame.height**2
    return image * (1 - vignetting * ((across * u**2 + along * v**2) / (across + along)))


def power(image: Picture, gamma: Float[Array, ""], frame: Frame) -> Picture:
    """The power, and its tangent where there is less light than `LEAST_LIGHT`."""
    enough = image > LEAST_LIGHT
    tangent = LEAST_LIGHT**gamma * (1 + gamma * (image / LEAST_LIGHT - 1))
    return jnp.where(enough, jnp.where(enough, image, 1.0) ** gamma, tangent)


def blurred(image: Picture, blur: Float[Array, ""], frame: Frame) -> Picture:
    return gaussian_blur(image, blur / frame.binning)


class ResponseEffect(NamedTuple):
    """One effect.

    Args:
        apply: the picture with the effect, of the picture, the effect's value and the frame.
        step: how far a suspected number is moved: so little that what it does grows in proportion, so much that it is
            no rounding.
        advice: what to do where a target has more or less of it.
        start: its value where it is free and has no effect yet, None for its default: at a blur of 0 all derivatives by
            it are 0.
        is_squared: whether small effects grow with the square of the number.
        is_linear: whether the picture is linear in the number, once all later effects are: its best value has a closed
            form, together with those of the later ones. So light is not, which a gain multiplies.
    """

    name: str
    apply: Callable[[Picture, Array, Frame], Picture]
    step: float
    advice: str
    start: float | None = None
    is_squared: bool = False
    is_linear: bool = False

    @property
    def attribute(self) -> Attribute:
        return next(attribute for attribute in declared_attributes(CameraResponse) if attribute.name == self.name)

    @property
    def unit(self) -> str:
        """What an amount of it is told in: percent where it does nothing at 1."""
        return "%" if np.all(self.neutral == 1) else {"pixel": "px"}.get(self.attribute.quantity.unit, "")

    @property
    def neutral(self) -> np.ndarray:
        """The value at which it does nothing."""
        default = self.attribute.default
        assert isinstance(default, tuple)
        return np.reshape(default, self.attribute.shape)


RESPONSE_EFFECTS = (
    ResponseEffect("light", lit, 1e-3, "free it and the other numbers of the light"),
    ResponseEffect("vignetting", darken_corners, 1e-3, "free it, or correct the picture"),
    ResponseEffect("blur", blurred, 0.7, "free it, or blur as the target is", start=0.7, is_squared=True),
    ResponseEffect("gain", lambda image, gain, frame: image * gain[:, None, None], 1e-3, "free it", is_linear=True),
    ResponseEffect("offset", lambda image, shift, frame: image + shift[:, None, None], 1e-3, "free it", is_linear=True),
    ResponseEffect("gamma", power, 1e-4, "free it, or state how the colours were stored (--transfer)"),
)
"""All effects, in the order in which they take effect: on what is seen, in the lens, on the sensor, in storage."""


def active_effects(film: CameraResponse | None) -> list[ResponseEffect]:
    """The effects that a response has, in order; none of them is None there."""
    return [effect for effect in RESPONSE_EFFECTS if getattr(film, effect.name, None) is not None]


@with_lower_ranks
def apply_response(image: Picture, film: CameraResponse | None, frame: Frame) -> Picture:
    """The picture that a film makes of a scene's light; differentiable in both. Effects that are None do nothing."""
    for effect in active_effects(film):
        image = effect.apply(image, getattr(film, effect.name), frame)
    return image


apply_response_compiled = jit(apply_response, static_argnames="frame")
"""`apply_response`, compiled once for each frame and choice of effects."""


def neutral_response(dtype: np.dtype) -> CameraResponse:
    """A camera's response that does nothing, under the name `film`."""
    return CameraResponse(FILM, **{effect.name: jnp.asarray(effect.neutral, dtype) for effect in RESPONSE_EFFECTS})


def without_idle(film: CameraResponse, kept: Container[str] = ()) -> CameraResponse:
    """The film with None for the effects that do nothing, but for those that are kept; its numbers are concrete."""
    others = [effect for effect in RESPONSE_EFFECTS if effect.name not in kept]
    idle = [effect.name for effect in others if np.all(np.asarray(getattr(film, effect.name)) == effect.neutral)]
    return dataclasses.replace(film, **dict.fromkeys(idle))


def linear_effects(film: CameraResponse | None) -> tuple[str, ...]:
    """The effects in whose numbers the picture is linear, the last first: so are all effects after them."""
    linear = itertools.takewhile(lambda effect: effect.is_linear, reversed(active_effects(film)))
    return tuple(effect.name for effect in linear)


def light_reach(film: CameraResponse | None) -> float:
    """The distance from which a pixel's light may come, in pixels of the whole picture; 0 if it is the pixel's own."""
    blur = film and film.blur
    return 0.0 if blur is None else 3 * float(blur)
