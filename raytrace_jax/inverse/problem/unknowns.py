"""Free parameters as bounded numbers, and as the unbounded unknowns of a solver."""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from typing import TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Bool, Float, Int

from ...errors import ParameterError
from ...scene.parameters import resolve, response_effects, scalar_names, set_parameters
from ...scene.scene import Scene, world_length
from ...scene.schema import Quantity
from ...scene.setting_words import ModelName
from ...util.compilation import jit
from ...util.numerics import on_device

AnyArray = TypeVar("AnyArray", Array, np.ndarray)

Scalar = Float[Array, ""]

Vector = Float[Array, " parameters"]
"""A number for each free parameter, as the fit's programs take it."""

Values = Float[np.ndarray, " parameters"]
"""A number for each free parameter, on the host."""

Picture = Float[Array, "3 height width"]
"""A picture, as the fit's programs take it."""

PixelIndices = Int[np.ndarray, " pixels"]
"""Columns or rows of some pixels, or numbers of blocks."""

Image = Float[np.ndarray, "3 height width"]
Images = tuple[Float[np.ndarray, "3 _ _"], ...]
"""A picture of each view, in its own size."""

Mask = Bool[np.ndarray, "height width"]
PixelJacobian = Float[np.ndarray, "parameters 3 height width"]
Covariance = Float[np.ndarray, "parameters parameters"]


@dataclasses.dataclass(frozen=True)
class Transform:
    """A parameter with a lower bound, both or none, as a function of its unknown `y`, linear between the ends.

    Without bounds it is `unit * y`, with one `lower + unit * y`, with two it goes from one to the other for y from 0 to
    1. An unknown beyond its reach gives the value of the end, for solvers that do not know the reach.
    """

    lower: float = -math.inf
    upper: float = math.inf
    unit: float = 1.0

    @property
    def width(self) -> float:
        """The change of the value while its unknown changes by 1."""
        return self.unit if math.isinf(self.upper) else self.upper - self.lower

    @property
    def reach(self) -> tuple[float, float]:
        """The least and the largest unknown that a solver may try."""
        # A ball of radius 0 is no ball: no value comes nearer to its bound than this, in units or shares of its range.
        least = -math.inf if math.isinf(self.lower) else 1e-30
        return least, math.inf if math.isinf(self.upper) else 1.0

    def to_value(self, y: Scalar) -> Scalar:
        """The parameter's value; at an end the derivative is that of the inside."""
        if math.isinf(self.lower):
            # Not even multiplied by 1: XLA takes the smallest numbers for 0 where it calculates.
            return y if self.unit == 1 else self.unit * y
        least, most = self.reach
        inside = jnp.where(y < least, least, jnp.where(y > most, most, y))
        return self.lower + self.width * inside

    def to_unknown(self, value: float) -> float:
        """The unknown that gives a value; a value at or beyond a bound is first moved just inside."""
        if math.isinf(self.lower):
            return value / self.unit
        least, most = self.reach
        return min(max((value - self.lower) / self.width, least), most)


def natural_unit(scene: Scene, quantity: Quantity, model: ModelName = "classic", light: float = 1.0) -> float:
    """The size at which a parameter of this quantity counts as 1, scaled with the scene by the quantity's dimension.

    Args:
        light: how large the scene's light is.
    """
    # A scene measures ten units of length; for the course's scenes that is their world unit.
    return (float(world_length(scene)) / 10) ** quantity.dimension_in(model) * (light if quantity.is_light else 1.0)


def natural_scale(scene: Scene, name: str, model: ModelName = "classic", light: float = 1.0) -> float:
    """The size of a large change of a parameter: the step of a search, the measure of an error.

    An index counts from 1, a position in radii of its sphere, anything else by its own size, as its `Quantity` says.
    """
    address, block, attribute, _ = resolve(scene, name)
    value, quantity = float(address.read(scene)), attribute.quantity
    unit = natural_unit(scene, quantity, model, light)
    # A number that is 0, and an index of 1, have no size of their own.
    if quantity.scale == "index":
        return max(abs(value - 1), 0.1)
    if quantity.scale == "block":
        return max(_length(block.read(scene, side)) for side in quantity.sized_by)
    if quantity.scale == "vector":
        return max(_length(address.entry.read(scene)), unit)
    return max(abs(value), 0.1 * unit)


def _length(value: Array | np.ndarray) -> float:
    """The length of a vector, the magnitude of a number."""
    return float(np.linalg.norm(value)) if value.ndim else abs(float(value))


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """The free parameters as functions of the solver's unknowns `y`, and the scene as one of their values.

    Args:
        transforms: the function of each that keeps its value within its bounds.
        ties: (follower, leader) pairs of scalar parameters: the follower always has the leader's value.
        of_film: the names that are the film's; they change the picture only after it is traced.
        unseen: the names that change nothing in a view, since they are another view's.
    """

    names: tuple[str, ...]
    transforms: tuple[Transform, ...]
    ties: tuple[tuple[str, str], ...] = ()
    of_film: tuple[str, ...] = ()
    unseen: tuple[str, ...] = ()

    @property
    def traced(self) -> list[int]:
        """The places of the parameters of what is traced: they are not the film's, and not another view's."""
        return [k for k, name in enumerate(self.names) if name not in (*self.of_film, *self.unseen)]

    @property
    def traced_unknowns(self) -> "Unknowns":
        """The unknowns of what is traced."""
        names = tuple(self.names[place] for place in self.traced)
        transforms = tuple(self.transforms[place] for place in self.traced)
        ties = tuple(pair for pair in self.ties if pair[1] in names)
        return Unknowns(names, transforms, ties)

    def values(self, y: Vector) -> Vector:
        """The values at unknowns `y`."""
        values = [transform.to_value(y[k]) for k, transform in enumerate(self.transforms)]
        return jnp.stack(values) if values else y

    def unknowns(self, values: Values) -> Values:
        """The unknowns that give these values; a value beyond its bound is first moved just inside."""
        return np.array([t.to_unknown(float(v)) for t, v in zip(self.transforms, values, strict=True)])

    @property
    def reach(self) -> Float[np.ndarray, "2 parameters"]:
        """The least and the largest of each unknown that a solver may try."""
        return np.array([transform.reach for transform in self.transforms]).T

    @property
    def limits(self) -> Float[np.ndarray, "2 parameters"]:
        """The least and the largest value of each parameter."""
        return np.array([(transform.lower, transform.upper) for transform in self.transforms]).T

    def scene(self, scene: Scene, values: Vector | Values) -> Scene:
        """The scene with these values, ties followed."""
        value: Mapping[str, ArrayLike] = {
            name: values[k] for k, name in enumerate(self.names) if name not in self.unseen
        }
        return set_parameters(scene, {**value, **{follower: value[leader] for follower, leader in self.ties}})

    def seen_in(self, scene: Scene) -> "Unknowns":
        """The same unknowns as the camera of a scene of several views knows them.

        What is another view's, or of a shape that the camera is not shown, is unseen; where a number of this view
        follows it, that one stands in its place.
        """

        def is_here(name: str) -> bool:
            with contextlib.suppress(ParameterError):
                return not resolve(scene, name).address.is_elsewhere
            return False

        names, ties, unseen = [], [], []
        for name in self.names:
            followers = [follower for follower, leader in self.ties if leader == name and is_here(follower)]
            own = name if is_here(name) or not followers else followers.pop(0)
            names.append(own)
            ties += [(follower, own) for follower in followers]
            unseen += [] if is_here(own) else [own]
        of_film = response_effects(scene, [name for name in names if name not in unseen])
        of_film = tuple(name for name in names if name in of_film)
        return Unknowns(tuple(names), self.transforms, tuple(ties), of_film, tuple(unseen))

    def moved(self, scene: Scene, y: Vector) -> Scene:
        """The scene at unknowns `y`."""
        return self.scene(scene, self.values(y))

    def initial(self, scene: Scene) -> Values:
        """The values in a scene."""
        return np.array([float(resolve(scene, name).address.read(scene)) for name in self.names])


def make_unknowns(
    scene: Scene,
    free: Sequence[str],
    ties: Mapping[str, str] | None = None,
    *,
    model: ModelName = "classic",
    light: float = 1.0,
) -> Unknowns:
    """The unknowns of a fit.

    Args:
        free: names of parameters, `vitreous.ior`, or of whole vectors, `vitreous.center`.
        ties: leader by follower, both scalars or both vectors; the leader is free, the follower is not.
        model: the surfaces' model, from which the units of what they send out follow.
        light: how large the scene's light is.

    Raises:
        ParameterError: unknown names, none at all, one twice, a number that cannot move alone or means nothing to the
            model, or a tie that is none.
    """
    names = scalar_names(scene, free)
    if not names:
        raise ParameterError("there is nothing to fit: name at least one free parameter, such as sphere.center")
    # Ties, number by number: vectors are tied to vectors.
    pairs = []
    for follower, leader in (ties or {}).items():
        followers, leaders = scalar_names(scene, [follower]), scalar_names(scene, [leader])
        if len(followers) != len(leaders):
            raise ParameterError(
                f"tie {follower}={leader}: {follower} has {len(followers)} numbers, {leader} has {len(leaders)}."
            )
        pairs += zip(followers, leaders, strict=True)
    pairs = [(follower, spelled(scene, names, leader, "leader of a tie")) for follower, leader in pairs]
    # Refuses a follower that is free itself, also under another spelling.
    scalar_names(scene, [*names, *(follower for follower, _ in pairs)])
    of_film = all_response_effects(scene, [*names, *(follower for follower, _ in pairs)])
    for follower, leader in pairs:
        if (follower in of_film) != (leader in of_film):
            raise ParameterError(f"tie {follower}={leader}: one is the film's and the other is not.")
    transforms = tuple(_transform(scene, name, model, light) for name in names)
    return Unknowns(tuple(names), transforms, tuple(pairs), tuple(name for name in names if name in of_film))


def all_response_effects(scene: Scene, names: Sequence[str]) -> dict[str, str]:
    """The effect of each of the names that are numbers of a camera's film, of all cameras."""
    return {k: v for camera in scene.cameras for k, v in response_effects(scene.seen_by(camera), names).items()}


def _transform(scene: Scene, name: str, model: ModelName, light: float) -> Transform:
    """The transform of a free number. Raises ParameterError where the number cannot move alone."""
    address, block, attribute, _ = resolve(scene, name)
    if not attribute.is_used_by(model):
        raise ParameterError(f"{name} cannot be free: {attribute.name} means nothing to the {model} model.")
    values = {other: np.array(value) for other, value in block.read_all(scene).items()}
    # A hundredth of the natural scale is more than sides that have to be orthogonal allow.
    component = ... if address.component is None else address.component
    values[attribute.name][component] += 0.01 * natural_scale(scene, name, model, light)
    complaint = block.type.complaint(values)
    if complaint:
        raise ParameterError(f"{name} cannot be free: where it moves alone, {complaint[1]}.")
    unit = natural_unit(scene, attribute.quantity, model, light)
    return Transform(*attribute.quantity.range_at(float(address.read(scene))), unit)


def spelled(scene: Scene, names: Sequence[str], name: str, role: str) -> str:
    """A free number as `names` spell it: `vitreous.ior` and `cyan.ior` may be one.

    Raises:
        ParameterError: there is no such number, it is several, or it is not free.
    """
    if name in names:
        return name
    scalars = scalar_names(scene, [name])
    if scalars != (name,):
        raise ParameterError(f"{role} {name}: it has several numbers; name one, such as {scalars[0]}.")
    for free in names:
        if resolve(scene, free).address == resolve(scene, name).address:
            return free
    raise ParameterError(f"{role} {name}: it is not free; free are {', '.join(names)}.")


@functools.partial(jit, static_argnames="unknowns")
def values_and_slopes(y: Vector, unknowns: Unknowns) -> tuple[Vector, Vector]:
    """The values at unknowns, and the derivative of each by its unknown, as one program."""
    slopes = [jax.grad(transform.to_value)(y[k]) for k, transform in enumerate(unknowns.transforms)]
    return unknowns.values(y), jnp.stack(slopes) if slopes else y


@functools.partial(jit, static_argnames="unknowns")
def moved_scene(scene: Scene, values: Vector, unknowns: Unknowns) -> Scene:
    """The scene with these values, as one program."""
    return unknowns.scene(scene, values)


@functools.partial(jit, static_argnames="unknowns")
def moved_scenes(scene: Scene, values: Float[Array, "scenes parameters"], unknowns: Unknowns) -> Scene:
    """A scene for each row of values; every array has the rows as another first axis."""
    return jax.vmap(lambda row: unknowns.scene(scene, row))(values)


Priors = Mapping[str, tuple[float, float]]
"""Mean and standard deviation by name of a free scalar parameter."""


class Prior(eqx.Module):
    """Independent Gaussian priors on the values of the free parameters.

    Args:
        precision: one over the standard deviation; 0 where there is no prior.
    """

    mean: Vector
    precision: Vector


def make_prior(priors: Priors, unknowns: Unknowns, dtype: jnp.dtype) -> Prior:
    """The priors as arrays; they are given by names of `unknowns`.

    Raises:
        ParameterError: a mean or standard deviation that makes no sense.
    """
    mean, precision = np.zeros((2, len(unknowns.names)))
    for name, (middle, deviation) in priors.items():
        if not np.isfinite(middle) or not (np.isfinite(deviation) and deviation > 0):
            raise ParameterError(
                f"prior on {name}: {middle:g}+-{deviation:g}; wanted a finite mean and a standard deviation above 0."
            )
        place = unknowns.names.index(name)
        mean[place], precision[place] = middle, 1 / deviation
    return Prior(on_device(mean, dtype), on_device(precision, dtype))
