"""How well fixed numbers are known: from what a user states to a standard deviation of each number."""

import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from raytrace_jax.errors import ParameterError
from raytrace_jax.inverse.problem.fixed_numbers import number_size
from raytrace_jax.inverse.problem.unknowns import Unknowns
from raytrace_jax.scene.parameters import Address, blocks, resolve, scalar_names
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.text import parse_number
from raytrace_jax.util.words import listed, quoted

Uncertain = Mapping[str, float | str]
"""A standard deviation, or a share as `0.1%`, by name of a number, a vector, a block or a kind of blocks."""


def stated_uncertainties(scene: Scene, unknowns: Unknowns, uncertain: Uncertain) -> dict[str, float]:
    """The standard deviation of every single number that is stated to be uncertain, by canonical name.

    The name that means fewer numbers wins: `cam1.viewpoint.z` over `cam1`. A share as `0.1%` is one of the number's
    magnitude, and for a vector's component of the vector's length.

    Raises:
        ParameterError: an unknown name, a number that is free or tied, a standard deviation that makes no sense.
    """
    moving = (*unknowns.names, *(follower for follower, _ in unknowns.ties))
    taken = {resolve(scene, name).address: name for name in moving}
    by_address: dict[Address, float] = {}
    groups = [(name, amount, numbers_of(scene, name)) for name, amount in uncertain.items()]
    for name, amount, addresses in sorted(groups, key=lambda group: -len(group[2])):
        both = [taken[address] for address in addresses if address in taken]
        if len(both) == len(addresses):
            raise ParameterError(f"uncertain {name}: {both[0]} is free; state what is known of it as a prior.")
        spreads = {address: standard_deviation(scene, address, name, amount) for address in addresses}
        if not any(spreads.values()):
            raise ParameterError(f"uncertain {name}={amount}: it is 0, of which a share is nothing; give it in units.")
        by_address |= {address: spread for address, spread in spreads.items() if address not in taken}
    return {canonical_name(scene, address): spread for address, spread in by_address.items() if spread > 0}


def root_covariance(
    names: Sequence[str], spread: Float[np.ndarray, " numbers"], correlations: Mapping[tuple[str, str], float]
) -> Float[np.ndarray, "numbers numbers"]:
    """A square root of the covariance of uncertain numbers; its rows are changes that are independent of each other.

    Args:
        names: names of the numbers.
        spread: their standard deviations.
        correlations: by pairs of names; what is not named does not correlate.

    Raises:
        ParameterError: the correlations cannot be those of these numbers.
    """
    # Correlations may be rounded to six digits.
    rounding = 1e-6
    place, matrix = {name: k for k, name in enumerate(names)}, np.eye(len(names))
    for (one, other), value in correlations.items():
        for name in (one, other):
            if name not in place:
                raise ParameterError(
                    f"correlations: {quoted(name)} is not stated to be uncertain; there are {listed(names)}."
                )
        if one == other or not abs(value) <= 1 + rounding:
            raise ParameterError(
                f"correlations: {one}, {other}: {value}; two numbers and a value from -1 to 1 are wanted."
            )
        matrix[place[one], place[other]] = matrix[place[other], place[one]] = value
    values, vectors = np.linalg.eigh(matrix)
    if np.any(values < -rounding):
        raise ParameterError(
            "correlations: no numbers can have these correlations: their matrix has a negative eigenvalue."
        )
    return (np.sqrt(np.maximum(values, 0))[:, None] * vectors.T) * spread


def numbers_of(scene: Scene, name: str) -> list[Address]:
    """The single numbers that a name means; it may be that of a parameter, a block, or a kind of blocks."""
    owners = [block for block in blocks(scene) if block.name == name]
    owners = owners or [block for block in blocks(scene) if block.type.group == name]
    if not owners and "." not in name:
        names = dict.fromkeys(block.name for block in blocks(scene))
        kinds = dict.fromkeys(block.type.group for block in blocks(scene))
        raise ParameterError(
            f"uncertain {quoted(name)}: neither a number, as {owner_example(scene)}, nor a block nor a kind of blocks. "
            f"Blocks are {listed(names)}; kinds are {listed(kinds)}."
        )
    wanted = [f"{block.name}.{a.name}" for block in owners for a in block.type.continuous] if owners else [name]
    return [resolve(scene, scalar).address for scalar in scalar_names(scene, wanted)]


def owner_example(scene: Scene) -> str:
    """The name of some number of the scene, as an example."""
    block = blocks(scene)[-1]
    return f"{block.name}.{block.type.continuous[0].name}"


def standard_deviation(scene: Scene, address: Address, name: str, amount: float | str) -> float:
    """The standard deviation in the number's own unit, from an amount or a share as `0.1%`."""
    text = amount.strip() if isinstance(amount, str) else None
    try:
        number = float(amount) if text is None else parse_number(text.removesuffix("%").strip())
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0):
        raise ParameterError(
            f"uncertain {name}={amount}: wanted a standard deviation above 0 in its own unit, or a share as 0.1%."
        )
    if text is None or not text.endswith("%"):
        return number
    return number / 100 * number_size(scene, address)


def canonical_name(scene: Scene, address: Address) -> str:
    """The name under which a number is listed."""
    block = next(b for b in blocks(scene) if (b.type.group, b.column) == (address.group, address.column))
    attribute = block.type.find(address.field)
    assert attribute is not None
    component = "" if address.component is None else f".{attribute.components[address.component]}"
    return f"{block.name}.{address.field}{component}"
