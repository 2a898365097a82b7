"""The numbers of a scene that a fit takes for granted, and scenes in which some of them are others."""

from collections.abc import Container, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from raytrace_jax.inverse.problem.problem import Problem
from raytrace_jax.scene.parameters import Address, Parameter, list_parameters, resolve, scalar_names
from raytrace_jax.scene.response import FILM
from raytrace_jax.scene.scene import Scene, map_scenes


class FixedNumbers(NamedTuple):
    """Single numbers of a scene that are neither free nor tied to a free one.

    Args:
        names: canonical names.
        parameters: what they name.
        value: their values in the scene.
        size: how large each is: a single number's magnitude; for a vector's component the vector's length.
    """

    names: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    value: Float[np.ndarray, " fixed"]
    size: Float[np.ndarray, " fixed"]

    def followed_by(self, names: Sequence[str], values: Sequence[float]) -> "FixedNumbers":
        """These numbers, and others that are not traced: without a parameter, as large as their magnitude."""
        value, size = np.concatenate([self.value, values]), np.concatenate([self.size, np.abs(values)])
        return FixedNumbers((*self.names, *names), self.parameters, value, size)

    def where(self, chosen: Bool[np.ndarray, " fixed"]) -> "FixedNumbers":
        """The chosen numbers."""
        places = np.flatnonzero(chosen)
        names, parameters = tuple(self.names[k] for k in places), tuple(self.parameters[k] for k in places)
        return FixedNumbers(names, parameters, self.value[places], self.size[places])


def fixed_numbers(problem: Problem, wanted: Container[str] = ()) -> FixedNumbers:
    """All numbers that the scene states, the model uses and the fit holds fixed; `judge.suspects` has the film's.

    A single number that is 0, such as the transparency of a wall, says that there is nothing: it is left out unless it
    is wanted by name. So is what cannot move alone, such as one component of a rectangle's side.
    """
    scene, unknowns = problem.scene, problem.unknowns
    moving = [*unknowns.names, *(follower for follower, _ in unknowns.ties)]
    taken = {resolve(scene, name).address for name in moving}
    found = []
    for name in scalar_names(scene, list_parameters(scene)):
        parameter = resolve(scene, name)
        value = float(parameter.address.read(scene))
        is_absent = value == 0 and parameter.address.component is None and name not in wanted
        if not parameter.attribute.is_used_by(problem.base.model) or parameter.address.group == FILM:
            continue
        if parameter.address not in taken and not is_absent and can_move_alone(scene, parameter):
            found.append((name, parameter, value, number_size(scene, parameter.address)))
    names, parameters, values, sizes = zip(*found, strict=True) if found else ((), (), (), ())
    return FixedNumbers(names, parameters, np.array(values), np.array(sizes))


def number_size(scene: Scene, address: Address) -> float:
    """How large a number is: a single number's magnitude; for a vector's component the vector's length."""
    return float(np.linalg.norm(np.asarray(address.entry.read(scene))))


def can_move_alone(scene: Scene, parameter: Parameter) -> bool:
    """Whether a number may have another value while all others of its block stay as they are."""
    block, component = parameter.block, parameter.address.component
    values = {name: np.array(value) for name, value in block.read_all(scene).items()}
    entry = values[parameter.attribute.name]
    place = ... if component is None else component
    # A thousandth of the number: much more than the checks allow for rounding.
    entry[place] += 1e-3 * (np.abs(entry[place]) or 1.0)
    return block.type.complaint(values) is None


def inward_steps(numbers: FixedNumbers, scene: Scene, share: float) -> Float[np.ndarray, " fixed"]:
    """A step of each number: a share of its size, in a direction in which its value stays valid.

    The steps returned are those that are left after rounding to the scene's precision.
    """
    steps = share * np.where(numbers.size > 0, numbers.size, 1.0)
    for k, parameter in enumerate(numbers.parameters):
        entry = np.array(parameter.address.entry.read(scene))
        place = ... if parameter.address.component is None else parameter.address.component
        before = float(entry[place])
        entry[place] += steps[k]
        if parameter.attribute.violation(entry):
            entry[place] = before - steps[k]
        steps[k] = float(entry[place]) - before
    return steps


def moved_together(scene: Scene, numbers: FixedNumbers, steps: Float[np.ndarray, "scenes fixed"]) -> Scene:
    """A scene for each row of steps, with the numbers moved by them; stacked as by `map_scenes`."""
    many = map_scenes(lambda x: np.repeat(np.asarray(x)[None], len(steps), axis=0), scene)
    for k, parameter in enumerate(numbers.parameters):
        address = parameter.address
        place = (slice(None), *(i for i in (address.component, address.column) if i is not None))
        getattr(getattr(many, address.group), address.field)[place] += steps[:, k]
    return many
