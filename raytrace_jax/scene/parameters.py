"""Continuous parameters of a scene by the names of the file: `vitreous.center.x`, `topright.location`, `cyan.ior`.

A name is `block.attribute` or `block.attribute.component` (x y z for points and normals, x y for `worlddim` and a
camera's `center`, r g b for colours, k1 k2 for `distortion`). A shape's name reaches its material too (`vitreous.ior`),
unless the shape has such an attribute itself.
"""

import dataclasses
from collections.abc import Iterable, Mapping

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from raytrace_jax.errors import ParameterError
from raytrace_jax.scene.addresses import Address, Parameter, resolve
from raytrace_jax.scene.blocks import Block, blocks, material_of, shape_blocks
from raytrace_jax.scene.film import FILM, neutral_film
from raytrace_jax.scene.given import check_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.scene.values import Value, as_array, is_traced
from raytrace_jax.util.text import parse_number, quoted


def list_parameters(scene: Scene) -> dict[str, Array]:
    """List every continuous parameter by its canonical name, in the order in which a scene is written.

    The values have shape () or (2,) or (3,). A material's parameters are listed once, under the material.

    Returns:
        The values by name.
    """
    return {
        f"{block.name}.{attribute.name}": block.read(scene, attribute.name)
        for block in blocks(scene)
        for attribute in block.kind.continuous
    }


def get_parameter(scene: Scene, name: str) -> Array:
    """Return a parameter's value: shape () for a single number, (2,) or (3,) for a vector.

    Raises:
        ParameterError: there is no such parameter; the message names close matches and what exists.
    """
    return resolve(scene, name).address.read(scene)


def set_parameters(scene: Scene, values: Mapping[str, Value]) -> Scene:
    """Return the scene with new parameter values; differentiable in values and scene, and fit for `jax.jit`.

    A scene without a film gets one for a name such as `film.blur`.

    Args:
        scene: the scene, which keeps its dtype.
        values: value by name, with the parameter's shape (a single number may come as shape (1,) too).

    Raises:
        ParameterError: an unknown name, two names for one number, a wrong shape, or a concrete value that no
            `model.txt` may have (traced values have no value to check yet).
    """
    scene = with_film(scene, values)
    parameters = {name: resolve(scene, name) for name in values}
    _scalar_addresses(parameters)
    entries: dict[Address, tuple[str, Attribute, Array]] = {}
    # Inside a jit, compute what is known already at once, so that it can be checked.
    with jax.ensure_compile_time_eval():
        for name, (address, _, attribute, _) in parameters.items():
            value = _value(name, values[name], address.read(scene))
            if address.component is not None:
                entry = entries[address.entry][2] if address.entry in entries else address.entry.read(scene)
                value = entry.at[address.component].set(value)
            entries[address.entry] = (name, attribute, value)

        for address, (name, attribute, value) in entries.items():
            violation = None if is_traced(value) else attribute.violation(np.asarray(value))
            if violation:
                raise ParameterError(f"{quoted(name)}: {violation}, got {np.asarray(value)}.")
            scene = address.write_entry(scene, value)
        for name, parameter in parameters.items():
            if parameter.block.kind.checks:
                _check_block(scene, name, parameter.block)
    return scene


def with_film(scene: Scene, names: Iterable[str]) -> Scene:
    """The scene with a film that does nothing, if it has none and one of the names is a film's: `film.gain.r`."""
    check_scene(scene)
    if scene.film is not None or not any(str(name).partition(".")[0] == FILM for name in names):
        return scene
    return dataclasses.replace(scene, film=neutral_film(scene.camera.viewpoint.dtype))


def shared_with(scene: Scene, name: str) -> tuple[str, ...]:
    """Name the other shapes that change too when a shape's parameter is set, in the order of the file.

    `vitreous.ior` is the index of a material, which other shapes may have as well. A name that addresses the
    material itself (`cyan.ior`) leaves no doubt and shares with no one: ().

    Raises:
        ParameterError: there is no such parameter.
    """
    parameter = resolve(scene, name)
    if parameter.through_shape is None:
        return ()
    return tuple(
        shape.name
        for shape in shape_blocks(scene)
        if material_of(scene, shape) == parameter.block and shape.name != parameter.through_shape
    )


def scalar_names(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    """Expand vectors to the names of their numbers: `vitreous.center` to `vitreous.center.x`, `.y` and `.z`.

    The given spelling is kept: `vitreous.ior` stays, although its canonical name is `cyan.ior`.

    Raises:
        ParameterError: an unknown name, or two names for one number (also under another spelling); one text, of which
            the letters came as names.
    """
    names = list(names)
    if "." in names and len(names) > 1:
        text = "".join(name for name in names if len(name) == 1)
        raise ParameterError(f"a list of names is wanted, and this is the text {text!r}: write [{text!r}].")
    for name in names:
        if names.count(name) > 1:
            raise ParameterError(f"{quoted(name)} is given twice.")
    return tuple(_scalar_addresses({name: resolve(scene, name) for name in names}).values())


def _scalar_addresses(parameters: Mapping[str, Parameter]) -> dict[Address, str]:
    """Map the address of each single number to its name; refuse two names for one number."""
    scalar_name: dict[Address, str] = {}
    given_name: dict[Address, str] = {}
    for name, parameter in parameters.items():
        for scalar, address in parameter.scalars(name):
            if address in given_name:
                both = f"{quoted(given_name[address])} and {quoted(name)}"
                raise ParameterError(f"{both} both give the number {quoted(scalar)}: give it once.")
            scalar_name[address], given_name[address] = scalar, name
    return scalar_name


def parse_assignment(text: str) -> tuple[str, tuple[float, ...]]:
    """Split `vitreous.center=4.2,2.3,-1` into the name and its numbers, ready for `set_parameters`.

    Raises:
        ParameterError: no `=`, no name, or something that is not a finite number.
    """
    # A block's name may hold a '=', numbers cannot.
    name, equals, numbers = (piece.strip() for piece in text.rpartition("="))
    if not equals or not name:
        raise ParameterError(f"{quoted(text)} is no assignment: write name=value, or name=x,y,z for a vector.")
    try:
        return name, tuple(parse_number(number.strip()) for number in numbers.split(","))
    except ValueError as reason:
        raise ParameterError(f"{quoted(text)}: {reason}.") from None


def _value(name: str, value: Value, current: Array) -> Array:
    """Bring a value to the shape and dtype of the one it replaces; what is concrete must be finite."""
    try:
        return jnp.asarray(as_array(value, current.shape, current.dtype))
    except ValueError as reason:
        raise ParameterError(f"{quoted(name)} {reason}.") from None


def _check_block(scene: Scene, name: str, block: Block) -> None:
    """Refuse values that the attributes of a block may not have together, as far as they are concrete."""
    values = block.read_all(scene)
    complaint = block.kind.complaint({key: np.asarray(x) for key, x in values.items() if not is_traced(x)})
    if complaint:
        raise ParameterError(f"{quoted(name)}: {complaint[1]}.")
