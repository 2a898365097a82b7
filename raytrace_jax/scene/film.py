"""The film: what a camera does to the light of a scene before its numbers are stored, an effect a row of one table.

An effect changes a scene-linear picture. From its row follow the attribute of the block `film`, and with it the name
`film.gain.r` under which it is set, freed, given a prior or stated to be uncertain; what the check of a model suspects;
and what the documentation says. A new effect is a function in `film_effects`, a field of `FilmResponse` and a row of
`FILM_EFFECTS`.
"""

import dataclasses
from collections.abc import Callable, Container
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.scene import limits, nature
from raytrace_jax.scene.film_effects import (
    SUPPORT,
    Frame,
    Picture,
    add,
    darken_corners,
    distort,
    magnify,
    multiply,
    power,
    shift_picture,
    spread_points,
)
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.util.compilation import jit
from raytrace_jax.util.numerics import with_lower_ranks

FILM = "film"
"""The keyword of a film's block, the name of a block that no file names, and the film's field in a scene."""


class FilmResponse(eqx.Module):
    """What the film makes of the light that falls on it; the fields are in the order in which they take effect.

    Args:
        name: the block's name in the file.
        vignetting: the share of the light that is lost in the picture's corners; it grows with the squared distance
            from the picture's middle.
        distortion: the share of its distance from the middle by which a corner moves outwards; other places move by
            their distance cubed.
        magnification: how much larger the picture is, around its middle.
        shift: how far the picture is moved, to the right and down, in pixels.
        blur: standard deviation of a Gaussian point-spread function, in pixels.
        gain: of each channel, a factor.
        offset: what is added to each channel, in units of white.
        gamma: the power of light as it is stored.
    """

    name: str = eqx.field(static=True)
    vignetting: Float[Array, ""]
    distortion: Float[Array, ""]
    magnification: Float[Array, ""]
    shift: Float[Array, "2"]
    blur: Float[Array, ""]
    gain: Float[Array, "3"]
    offset: Float[Array, "3"]
    gamma: Float[Array, ""]


class FilmEffect(NamedTuple):
    """One effect.

    Args:
        attribute: its numbers: names, limits, unit, and its default, at which it does nothing.
        apply: the picture with the effect, of the picture, the effect's value and the frame.
        step: how far a suspected number is moved: so little that what it does grows in proportion, so much that it is
            no rounding.
        start: where it begins when it is free and has no effect yet, None at its default: at a blur of 0 all
            derivatives by it are 0.
        is_squared: whether small effects grow with the square of the number.
        reach: how far away what a pixel sees may come from, in pixels, of the effect's value and the frame; None if it
            is the pixel itself.
        is_linear: whether the picture is linear in the number, once all later effects are: its best value has a closed
            form.
        advice: what to do where a target has more or less of it.
    """

    attribute: Attribute
    apply: Callable[[Picture, Array, Frame], Picture]
    step: float
    advice: str
    start: float | None = None
    is_squared: bool = False
    reach: Callable[[np.ndarray, Frame], Any] | None = None
    is_linear: bool = False

    @property
    def name(self) -> str:
        """The name of its attribute."""
        return self.attribute.name

    @property
    def unit(self) -> str:
        """What an amount of it is told in: percent where it does nothing at 1."""
        short = {"pixel": "px"}
        return "%" if np.all(self.neutral == 1) else short.get(self.attribute.nature.unit, "")

    @property
    def neutral(self) -> np.ndarray:
        """The value at which it does nothing."""
        default = self.attribute.default
        assert isinstance(default, tuple)
        return np.reshape(default, self.attribute.shape)


RGB = ("r", "g", "b")

FILM_EFFECTS = (
    FilmEffect(
        Attribute("vignetting", default=(0.0,), limit=limits.LOST_LIGHT, nature=nature.Nature(ranges=((-1.0, 1.0),))),
        darken_corners,
        step=1e-3,
        advice="free it, or correct the picture",
    ),
    FilmEffect(
        Attribute(
            "distortion", default=(0.0,), limit=limits.SLIGHT_DISTORTION, nature=nature.Nature(ranges=((-0.3, 0.3),))
        ),
        distort,
        step=1e-5,
        advice="free it, or undistort the picture",
        reach=lambda distortion, frame: SUPPORT + abs(distortion) * frame.half_diagonal,
    ),
    FilmEffect(
        Attribute("magnification", default=(1.0,), limit=limits.POSITIVE, nature=nature.AMOUNT),
        magnify,
        step=1e-5,
        advice="free the angle of view, or check the pixel mapping",
        reach=lambda magnification, frame: SUPPORT + abs(magnification - 1) * frame.half_diagonal,
    ),
    FilmEffect(
        Attribute("shift", ("x", "y"), default=(0.0, 0.0), nature=nature.PIXELS),
        shift_picture,
        step=1e-3,
        advice="free it, or check crop and pixel mapping",
        reach=lambda shift, frame: SUPPORT + np.max(np.abs(shift)),
    ),
    FilmEffect(
        Attribute(
            "blur",
            default=(0.0,),
            limit=limits.NOT_NEGATIVE,
            nature=nature.Nature("pixel", ranges=nature.ABOVE_ZERO),
        ),
        spread_points,
        step=0.7,
        advice="free it, or blur as the target is",
        start=0.7,
        is_squared=True,
        reach=lambda blur, frame: 3 * blur,
    ),
    FilmEffect(
        Attribute("gain", RGB, default=(1.0, 1.0, 1.0), limit=limits.POSITIVE, nature=nature.AMOUNT),
        multiply,
        step=1e-3,
        advice="free it",
        is_linear=True,
    ),
    FilmEffect(
        Attribute("offset", RGB, default=(0.0, 0.0, 0.0)),
        add,
        step=1e-3,
        advice="free it",
        is_linear=True,
    ),
    FilmEffect(
        Attribute("gamma", default=(1.0,), limit=limits.POSITIVE, nature=nature.AMOUNT),
        power,
        step=1e-4,
        advice="free it, or state how the colours were stored (--transfer)",
    ),
)
"""All effects, in the order in which they take effect: on the way through the lens, on the sensor, in storage."""


@with_lower_ranks
def develop(image: Picture, film: FilmResponse | None, frame: Frame) -> Picture:
    """The picture that a film makes of a scene's light; differentiable in both.

    Args:
        image: scene-linear RGB.
        film: its response, of which effects that are None do nothing; None leaves the picture as it is.
        frame: which part of the whole picture it is.
    """
    for effect in FILM_EFFECTS:
        value = getattr(film, effect.name, None)
        if value is not None:
            image = effect.apply(image, value, frame)
    return image


develop_compiled = jit(develop, static_argnames="frame")
"""`develop`, compiled once for each frame and choice of effects."""


def neutral_film(dtype: np.dtype) -> FilmResponse:
    """A film that leaves pictures as they are."""
    return FilmResponse(FILM, **{effect.name: jnp.asarray(effect.neutral, dtype) for effect in FILM_EFFECTS})


def without_idle(film: FilmResponse, kept: Container[str] = ()) -> FilmResponse:
    """The film with None for the effects that do nothing, but for those that are kept; its numbers are concrete."""
    idle = [
        e.name for e in FILM_EFFECTS if e.name not in kept and np.all(np.asarray(getattr(film, e.name)) == e.neutral)
    ]
    return dataclasses.replace(film, **dict.fromkeys(idle))


def linear_effects(film: FilmResponse | None) -> tuple[str, ...]:
    """The effects in whose numbers the developed picture is linear: they and all effects after them are linear."""
    found = []
    for effect in () if film is None else reversed(FILM_EFFECTS):
        if getattr(film, effect.name) is not None:
            if not effect.is_linear:
                break
            found.append(effect.name)
    return tuple(found)


def reach(film: FilmResponse | None, frame: Frame) -> float:
    """How far away the light of a pixel may come from, in pixels of the whole picture; 0 if it is the pixel's own."""
    total = 0.0
    for effect in FILM_EFFECTS:
        value = getattr(film, effect.name, None)
        if value is not None and effect.reach is not None:
            total += float(effect.reach(np.asarray(value, np.float64), frame))
    return total
