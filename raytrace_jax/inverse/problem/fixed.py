"""The fixed numbers of a problem, the uncertainties stated of them, and known offsets of other programs."""

import dataclasses
import math
import warnings
from collections.abc import Container, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from ...errors import ParameterError, RaytraceWarning
from ...scene.parameters import Address, Parameter, blocks, blocks_of, list_parameters, resolve, scalar_names
from ...scene.response import FILM
from ...scene.scene import Scene, map_scenes
from ...util.numerics import on_host
from ...util.text import listed, parse_number, quoted
from ..options import FitOptions
from .problem import Problem
from .unknowns import Unknowns

Spreads = Mapping[str, float]
"""Standard deviations of uncertain numbers by canonical name."""

Correlations = Mapping[tuple[str, str], float]
"""Correlations of uncertain numbers by pairs of canonical names."""


def fixed_numbers(problem: Problem, named: Container[str] = ()) -> dict[str, Parameter]:
    """All numbers that the scene states, the model uses and the fit holds fixed, but for the film's.

    A single number that is 0, such as the transparency of a wall, says that there is nothing: it is left out unless it
    is wanted by name. So is what cannot move alone, such as one component of a rectangle's side.
    """
    scene, moving, numbers = problem.scene, moving_numbers(problem.scene, problem.local), {}
    for name in scalar_names(scene, list_parameters(scene)):
        parameter = resolve(scene, name)
        address = parameter.address
        is_absent = address.component is None and name not in named and float(address.read(scene)) == 0
        is_used = parameter.attribute.is_used_by(problem.base.model) and address.group != FILM
        if is_used and address not in moving and not is_absent and can_move_alone(scene, parameter):
            numbers[name] = parameter
    return numbers


def moving_numbers(scene: Scene, unknowns: Unknowns) -> dict[Address, str]:
    """The names of the numbers that are free or tied to a free one."""
    seen = [name for name in unknowns.names if name not in unknowns.unseen]
    names = [*seen, *(follower for follower, _ in unknowns.ties)]
    return {resolve(scene, name).address: name for name in names}


def number_size(scene: Scene, address: Address) -> float:
    """The size of a number: a single number's magnitude; for a vector's component the vector's length."""
    return float(np.linalg.norm(np.asarray(address.entry.read(scene))))


def can_move_alone(scene: Scene, parameter: Parameter) -> bool:
    """Whether a number may have another value while all others of its block stay as they are."""
    values = {name: np.array(value) for name, value in parameter.block.read_all(scene).items()}
    # A thousandth of the number: much more than the checks allow for rounding.
    step = 1e-3 * (abs(float(parameter.address.read(scene))) or 1.0)
    values[parameter.attribute.name] = entry_with(scene, parameter.address, step)
    return parameter.block.type.complaint(values) is None


def inward_step(scene: Scene, parameter: Parameter, step: float) -> float:
    """A step of a number in a direction in which its value stays valid, as rounded to the scene's precision."""
    address = parameter.address
    if parameter.attribute.violation(entry_with(scene, address, step)):
        step = -step
    change = entry_with(scene, address, step).astype(np.float64) - on_host(address.entry.read(scene))
    return float(np.sum(change))


def entry_with(scene: Scene, address: Address, step: float) -> np.ndarray:
    """The value of a number's attribute, with the number moved by a step."""
    entry = np.array(address.entry.read(scene))
    entry[... if address.component is None else address.component] += np.float64(step)
    return entry


def moved_together(scene: Scene, addresses: Sequence[Address], steps: Float[np.ndarray, "scenes fixed"]) -> Scene:
    """A scene for each row of steps, with the numbers moved by them; stacked as by `map_scenes`."""
    many = map_scenes(lambda x: np.repeat(np.asarray(x)[None], len(steps), axis=0), scene)
    for k, address in enumerate(addresses):
        place = (slice(None), *(i for i in (address.component, address.column) if i is not None))
        getattr(getattr(many, address.group), address.field)[place] += steps[:, k]
    return many


Uncertain = Mapping[str, float | str]
"""A standard deviation, or a share as `0.1%`, by name of a number, a vector, a block or a kind of blocks."""


def stated_uncertainties(scene: Scene, unknowns: Unknowns, uncertain: Uncertain) -> dict[str, float]:
    """The standard deviation of every single number that is stated to be uncertain, by canonical name.

    The name that means fewer numbers wins: `cam1.viewpoint.z` over `cam1`. A share as `0.1%` is one of the number's
    magnitude, and for a vector's component of the vector's length.

    Raises:
        ParameterError: an unknown name, a number that is free or tied, a standard deviation that makes no sense.
    """
    moving, spread_of = moving_numbers(scene, unknowns), dict[str, float]()
    groups = [(name, amount, numbers_of(scene, name)) for name, amount in uncertain.items()]
    for name, amount, addresses in sorted(groups, key=lambda group: -len(group[2])):
        if all(address in moving for address in addresses):
            free = moving[addresses[0]]
            raise ParameterError(f"uncertain {name}: {free} is free; state what is known of it as a prior.")
        spreads = {address: standard_deviation(scene, address, name, amount) for address in addresses}
        if not any(spreads.values()):
            raise ParameterError(f"uncertain {name}={amount}: it is 0, of which a share is nothing; give it in units.")
        spread_of |= {
            canonical_name(scene, address): spreads[address] for address in addresses if address not in moving
        }
    return {name: spread for name, spread in spread_of.items() if spread > 0}


def root_covariance(
    names: Sequence[str], spread: Float[np.ndarray, " numbers"], correlations: Correlations
) -> Float[np.ndarray, "numbers numbers"]:
    """A square root of the covariance of uncertain numbers; its rows are changes that are independent of each other.

    Args:
        correlations: by pairs of names; what is not named does not correlate.

    Raises:
        ParameterError: the correlations cannot be those of these numbers.
    """
    rounding = 1e-6  # Correlations may be rounded to six digits.
    place, matrix = {name: k for k, name in enumerate(names)}, np.eye(len(names))
    for (one, other), value in correlations.items():
        unknown = [name for name in (one, other) if name not in place]
        if unknown:
            words = f"{quoted(unknown[0])} is not stated to be uncertain; there are {listed(names)}"
            raise ParameterError(f"correlations: {words}.")
        if one == other or not abs(value) <= 1 + rounding:
            raise ParameterError(f"correlations: {one}, {other}: {value}; wanted are two numbers, and from -1 to 1.")
        matrix[place[one], place[other]] = matrix[place[other], place[one]] = value
    values, vectors = np.linalg.eigh(matrix)
    if np.any(values < -rounding):
        raise ParameterError("correlations: no numbers can have these: their matrix has a negative eigenvalue.")
    return (np.sqrt(np.maximum(values, 0))[:, None] * vectors.T) * spread


def numbers_of(scene: Scene, name: str) -> list[Address]:
    """The single numbers that a name means; it may be that of a parameter, a block, or a kind of blocks."""
    every = blocks(scene)
    owners = [block for block in every if block.name == name] or [b for b in every if b.type.group == name]
    if not owners and "." not in name:
        raise ParameterError(
            f"uncertain {quoted(name)}: neither a number, as {every[0].name}.{every[0].type.continuous[0].name}, nor a "
            f"block nor a kind of blocks. Blocks are {listed(dict.fromkeys(block.name for block in every))}; kinds are "
            f"{listed(dict.fromkeys(block.type.group for block in every))}."
        )
    names = [f"{block.name}.{a.name}" for block in owners for a in block.type.continuous] or [name]
    return [resolve(scene, scalar).address for scalar in scalar_names(scene, names)]


def standard_deviation(scene: Scene, address: Address, name: str, amount: float | str) -> float:
    """The standard deviation in the number's own unit, from an amount or a share as `0.1%`."""
    text = amount.strip() if isinstance(amount, str) else ""
    try:
        number = parse_number(text.removesuffix("%").strip()) if text else float(amount)
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise ParameterError(
            f"uncertain {name}={amount}: wanted a standard deviation above 0 in its own unit, or a share as 0.1%."
        )
    return number / 100 * number_size(scene, address) if text.endswith("%") else number


def canonical_name(scene: Scene, address: Address) -> str:
    """The name under which a number is listed."""
    place = address.group, address.column, address.view
    block = next(b for b in blocks(scene) if (b.type.group, b.column, b.view) == place)
    attribute = next(each for each in block.type.continuous if each.name == address.field)
    component = [] if address.component is None else [attribute.components[address.component]]
    return ".".join([block.name, address.field, *component])


def with_known_offsets(options: FitOptions, scene: Scene, free: Sequence[str], maker: str) -> FitOptions:
    """The options with what is known of the program that made a target, where nothing was said of the same numbers.

    A ray that enters a ball a little inside of it and leaves it a little outside is refracted as by a ball whose radius
    is off by as much: in pictures by Mitsuba an index is off by 1 to 2e-4, and no residual shows it.

    Args:
        free: canonical names of what is free.
        maker: the program's name, as the target's file has it; empty if it has none.

    Warns:
        RaytraceWarning: something is taken to be uncertain.
    """
    if not maker.startswith("Mitsuba version 3"):
        return options
    said = {address for name in options.uncertain for address in numbers_of(scene, name)}
    said |= {resolve(scene, name).address for name in [*free, *scalar_names(scene, options.ties)]}
    offsets = dict[str, float]()
    for name in [f"{ball.name}.radius" for ball in blocks_of(scene, "sphere")]:
        radius = resolve(scene, name)
        if radius.address not in said:
            # Fraction of one more than a point's largest coordinate by which Mitsuba 3, in float32, starts rays off a
            # surface (`SurfaceInteraction::offset_p` and `math::RayEpsilon`).
            parts = (np.abs(on_host(radius.block.read(scene, part))) for part in ("center", "radius"))
            offsets[name] = float(f"{1500 * 2**-24 * (1 + sum(map(np.max, parts))):.1e}")
    if offsets:
        stated = listed(f"{name}={amount:g}" for name, amount in offsets.items())
        words = f"the target is by {maker}, which starts rays a little off surfaces: taken to be uncertain are {stated}"
        warnings.warn(f"{words}; --uncertain states other amounts.", RaytraceWarning, stacklevel=2)
    return dataclasses.replace(options, uncertain={**options.uncertain, **offsets})
