"""What a fit looks for: free parameters, ties between them, and the target's exposure and offset."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float

from raytrace_jax.errors import ParameterError
from raytrace_jax.inverse.problem.transforms import Transform, default_transform
from raytrace_jax.scene.addresses import resolve
from raytrace_jax.scene.parameters import get_parameter, scalar_names, set_parameters
from raytrace_jax.scene.scene import Scene

EXPOSURE, OFFSET = "exposure", "offset"
"""Nuisance parameters: the target is `exposure` times the scene's picture plus `offset`, the same for R, G and B."""


@dataclasses.dataclass(frozen=True)
class Unknowns:
    """How the values of the free parameters follow from the solver's unknowns `y`, and the scene from the values.

    Args:
        names: the free scalar parameters; `exposure` and `offset` last, if they are free.
        transforms: of each, the smooth function that keeps its value within its bounds.
        ties: (follower, leader) pairs of scalar parameters: the follower always has the leader's value.
    """

    names: tuple[str, ...]
    transforms: tuple[Transform, ...]
    ties: tuple[tuple[str, str], ...] = ()

    def values(self, y: Float[Array, " parameters"]) -> Float[Array, " parameters"]:
        """The values at unknowns `y`."""
        return jnp.stack([transform.to_value(y[k]) for k, transform in enumerate(self.transforms)])

    def unknowns(self, values: Float[np.ndarray, " parameters"]) -> Float[np.ndarray, " parameters"]:
        """The unknowns that give these values; a value beyond its bound is first moved just inside."""
        return np.array([t.to_unknown(float(v)) for t, v in zip(self.transforms, values, strict=True)])

    def scene(self, scene: Scene, values: Float[Array, " parameters"] | Float[np.ndarray, " parameters"]) -> Scene:
        """The scene with these values, ties followed."""
        value = {name: values[k] for k, name in enumerate(self.names)}
        in_scene: Mapping[str, ArrayLike] = {n: v for n, v in value.items() if n not in (EXPOSURE, OFFSET)}
        return set_parameters(scene, {**in_scene, **{follower: value[leader] for follower, leader in self.ties}})

    def expose(
        self, image: Float[Array, "3 height width"], values: Float[Array, " parameters"]
    ) -> Float[Array, "3 height width"]:
        """The scene's picture with the fitted exposure and offset."""
        if EXPOSURE in self.names:
            image = image * values[self.names.index(EXPOSURE)] + values[self.names.index(OFFSET)]
        return image

    def initial(self, scene: Scene) -> Float[np.ndarray, " parameters"]:
        """The values in a scene; exposure 1 and offset 0."""
        nuisance = {EXPOSURE: 1.0, OFFSET: 0.0}
        return np.array([nuisance[n] if n in nuisance else float(get_parameter(scene, n)) for n in self.names])


def make_unknowns(
    scene: Scene, free: Sequence[str], ties: Mapping[str, str] | None = None, *, exposure: bool = False
) -> Unknowns:
    """The unknowns of a fit.

    Args:
        scene: gives the start, from which the bounds follow.
        free: names of parameters, `vitreous.ior`, or of whole vectors, `vitreous.center`.
        ties: leader by follower, both scalars or both vectors; the leader is free, the follower is not.
        exposure: whether the target's exposure and offset are free as well.

    Raises:
        ParameterError: unknown names, none at all, one twice, or a tie that is none.
    """
    names = scalar_names(scene, free)
    if not names:
        raise ParameterError("there is nothing to fit: name at least one free parameter, such as sphere.center")
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
    transforms = [_transform(scene, name) for name in names]
    if exposure:
        names, transforms = (*names, EXPOSURE, OFFSET), [*transforms, Transform("above"), Transform()]
    return Unknowns(tuple(names), tuple(transforms), tuple(pairs))


def _transform(scene: Scene, name: str) -> Transform:
    parameter = resolve(scene, name)
    return default_transform(parameter.attribute.nature, float(parameter.address.read(scene)))


def spelled(scene: Scene, names: Sequence[str], name: str, role: str) -> str:
    """A free number as `names` spell it: `vitreous.ior` and `cyan.ior` may be one.

    Args:
        scene: the scene.
        names: the free numbers.
        name: the number, under any of its names.
        role: what it is for, to say in an error.

    Raises:
        ParameterError: there is no such number, it is several, or it is not free.
    """
    if name in names:
        return name
    own = scalar_names(scene, [name])
    if own != (name,):
        raise ParameterError(f"{role} {name}: it has several numbers; name one, such as {own[0]}.")
    for free in names:
        if free not in (EXPOSURE, OFFSET) and resolve(scene, free).address == resolve(scene, name).address:
            return free
    raise ParameterError(f"{role} {name}: it is not free; free are {', '.join(names)}.")


def natural_scale(scene: Scene, name: str) -> float:
    """How large a change of a parameter is a large one: the step of a search, the measure of an error.

    An index counts from 1, a position in radii of its sphere, anything else by its own size, as its `Nature` says.
    """
    if name in (EXPOSURE, OFFSET):
        return {EXPOSURE: 1.0, OFFSET: 0.1}[name]
    address, block, attribute, _ = resolve(scene, name)
    value, nature = float(address.read(scene)), attribute.nature
    if nature.scale == "index":
        return max(abs(value - 1), 0.1)
    if nature.scale == "block":
        return max(_length(block.read(scene, name)) for name in nature.sized_by)
    if nature.scale == "vector":
        return max(_length(address.entry.read(scene)), 1.0)
    return max(abs(value), 0.1)


def _length(value: Array) -> float:
    """The length of a vector, the magnitude of a number."""
    return float(np.linalg.norm(value)) if value.ndim else abs(float(value))
