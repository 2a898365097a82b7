"""The blocks of a scene, and its continuous parameters by the names of the file: `vitreous.center.x`, `cyan.ior`.

A name is `block.attribute` or `block.attribute.component`, such as x y z of a point. A shape's name reaches its
material too (`vitreous.ior`), unless the shape has such an attribute itself.
"""

import dataclasses
from collections.abc import Container, Iterable, Iterator, Mapping
from itertools import chain, product
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from ..errors import ParameterError
from ..util.numerics import is_traced, on_device
from ..util.text import did_you_mean, listed, parse_number, quoted
from .response import FILM, RESPONSE_EFFECTS, neutral_response
from .rows import Value, as_array
from .scene import Scene, check_scene
from .schema import NO_BLOCK, RGB, Attribute, BlockType
from .setting_words import ModelName
from .table import BLOCK_TYPES, COMPONENT_NAMES, SHAPE_KEYWORDS


class Block(NamedTuple):
    """A block of the scene.

    Args:
        column: its index in the group's arrays, None where a scene, or a view of it, has one such block.
        view: 0 of all that is rendered, k of the camera and the film of the k-th further view.
    """

    type: BlockType
    name: str
    column: int | None
    view: int = 0

    @property
    def keyword(self) -> str:
        return self.type.keyword

    def read(self, scene: Scene, attribute_name: str) -> Any:
        """The value of an attribute: an array of a continuous one, of others whatever they are."""
        return self.address(attribute_name).read(scene)

    def address(self, attribute_name: str, component: int | None = None) -> "Address":
        """The place of an attribute's values, or of one of its components."""
        return Address(self.type.group, attribute_name, self.column, component, self.view)

    def read_all(self, scene: Scene) -> dict[str, Any]:
        return {one.name: self.read(scene, one.name) for one in self.type.attributes if not one.is_text}

    def refers_to(self, scene: Scene, attribute_name: str) -> "Block | None":
        """The block that an attribute names, which is called by that block's keyword; None for none."""
        column = self.read(scene, attribute_name)
        return None if column == NO_BLOCK else blocks_of(scene, attribute_name)[column]


def blocks(scene: Scene) -> list[Block]:
    """All blocks in the order in which a scene is written."""
    others = [keyword for keyword in BLOCK_TYPES if keyword not in SHAPE_KEYWORDS]
    return blocks_of(scene, *others) + shape_blocks(scene)


def blocks_of(scene: Scene, *keywords: str) -> list[Block]:
    """The blocks of keywords, type by type: a block is named by its index among those of its keyword."""
    return [
        Block(row, name, None if row.is_single else column, view)
        for row, view, _, names in _groups(scene, keywords)
        for column, name in enumerate(names)
    ]


def _groups(scene: Scene, keywords: Container[str]) -> Iterator[tuple[BlockType, int, Any, tuple[str, ...]]]:
    """The types of blocks of keywords that the scene has: each with its view, its struct, the names of its blocks."""
    check_scene(scene)
    for rows in (rows for keyword, rows in BLOCK_TYPES.items() if keyword in keywords):
        # Of a view's fields a further view has only the camera and the film.
        for view, row in product(range(1 + len(scene.further_views)), rows):
            group: Any = getattr(_view_of(scene, view), row.group, None)
            if isinstance(group, row.struct):
                yield row, view, group, (group.name,) if row.is_single else group.names


def _view_of(scene: Scene, view: int) -> Any:
    """What has the fields of a block's groups: the scene, or from 1 on one of its further views."""
    return scene.further_views[view - 1] if view else scene


def shape_blocks(scene: Scene) -> list[Block]:
    """The shapes in the order of the file, which is that of their indices."""
    shapes = {block.name: block for block in blocks_of(scene, *SHAPE_KEYWORDS)}
    return [shapes[name] for name in scene.shape_order]


def attribute_values(scene: Scene) -> Iterator[tuple[BlockType, Attribute, tuple[str, ...], np.ndarray]]:
    """Each attribute of numbers: its type of block, the names of its blocks, its values as (components, blocks)."""
    for row, _, group, names in _groups(scene, BLOCK_TYPES):
        for attribute in row.continuous:
            values = np.reshape(np.asarray(getattr(group, attribute.name)), (attribute.value_count, len(names)))
            yield row, attribute, names, values


def material_of(scene: Scene, shape: Block) -> Block:
    """The block of the material that a shape has."""
    material = shape.refers_to(scene, "material")
    assert material is not None
    return material


def scene_model(scene: Scene) -> ModelName:
    """The model that a scene says it is for; `classic` if it does not say. Raises SceneError for what is no scene."""
    check_scene(scene)
    return (scene.settings and scene.settings.model) or "classic"


class Address(NamedTuple):
    """The place of a parameter in a scene's arrays: two names of the same parameter have equal addresses.

    `component` counts along the leading axis; None is the whole attribute. `view` is that of the block.
    """

    group: str
    field: str
    column: int | None
    component: int | None = None
    view: int = 0

    @property
    def is_elsewhere(self) -> bool:
        """Whether it belongs to a further view: it changes nothing that the rendered camera shows."""
        return self.view > 0

    @property
    def entry(self) -> "Address":
        return self._replace(component=None)

    def read(self, scene: Scene) -> Any:
        """The value in the scene: a vector, or a scalar of shape (); of what is no parameter whatever it is.

        A part of an array is one of NumPy's unless it is traced: each kind of slice is a program to JAX.
        """
        values = self._whole(scene)
        if isinstance(values, jax.Array) and not is_traced(values):
            values = np.asarray(values)
        if self.column is not None:
            values = values[self.column] if isinstance(values, tuple) else values[..., self.column]
        return values if self.component is None else values[self.component, ...]

    def write_entry(self, scene: Scene, value: Array | np.ndarray) -> Scene:
        array = on_device(value if self.column is None else with_part(self._whole(scene), self.column, value))
        return eqx.tree_at(self._whole, scene, array)

    def _whole(self, scene: Scene) -> Any:
        return getattr(getattr(_view_of(scene, self.view), self.group), self.field)


def with_part(array: Array | np.ndarray, index: int, value: Array | np.ndarray) -> Array | np.ndarray:
    """An array with a value at an index of its last axis, one of NumPy unless anything is traced."""
    xp = jnp if is_traced((array, value)) else np
    return xp.where(np.arange(array.shape[-1]) == index, xp.asarray(value)[..., None], xp.asarray(array))


class Parameter(NamedTuple):
    """A resolved name: where it is, its block and attribute, and through which shape its material was reached."""

    address: Address
    block: Block
    attribute: Attribute
    through_shape: str | None = None

    @property
    def is_color(self) -> bool:
        """Whether it is a colour, or one of its numbers: it changes the picture's channel of that number alone."""
        return self.attribute.components == RGB


def resolve(scene: Scene, name: str) -> Parameter:
    """Find the parameter that a name means. Raises ParameterError that lists what exists."""
    if not isinstance(name, str):
        raise ParameterError(f"the name of a parameter is wanted, such as 'glass.ior', and this is {name!r}.")
    # A block's own name may have dots.
    pieces = name.split(".")
    component = pieces.pop() if len(pieces) > 2 and pieces[-1] in COMPONENT_NAMES else None
    block_name, attribute_name = ".".join(pieces[:-1]), pieces[-1]
    known = blocks(scene)
    owners = [block for block in known if block.name == block_name]
    wholes = [block for block in known if block.name == name]
    # The blocks' own attributes come first, then those of the shapes' materials.
    materials = [(material_of(scene, block), block.name) for block in owners or wholes if block.type.is_shape]
    reached = [*((block, None) for block in owners or wholes), *materials]
    if wholes and not owners:
        model = scene_model(scene)
        attributes = chain.from_iterable(block.type.continuous for block, _ in reached)
        numbers = dict.fromkeys(f"{name}.{attribute.name}" for attribute in attributes if attribute.is_used_by(model))
        having = f"and a parameter is one of its numbers: {listed(numbers)}" if numbers else "which has no parameters"
        raise ParameterError(f"{quoted(name)} is a whole {wholes[0].keyword}, {having}.")
    if not owners:
        names = list(dict.fromkeys(block.name for block in known))
        first = next(block for block in known if block.type.continuous)
        example = listed(f"{first.name}.{one.name}" for one in first.type.continuous)
        guess = did_you_mean(block_name or name, names)
        raise ParameterError(
            f"{quoted(name)} is no parameter of this scene: one is written block.attribute, as {example}.{guess} "
            f"Blocks of this scene: {listed(names)}."
        )
    for block, shape in reached:
        attribute = block.type.find(attribute_name)
        if attribute is None or attribute.value_type != "number":
            continue
        components, index = attribute.components, None
        if component in components:
            index = components.index(component)
        elif component:
            having = f"its components are {listed(components)}" if components else "it is a single number"
            raise ParameterError(f"{quoted(name)}: {attribute_name} has no component {component!r}, {having}.")
        return Parameter(block.address(attribute_name, index), block, attribute, shape)
    if owners[0].type.find(attribute_name):
        how = "change it in the scene's file, or the picture's size by the size option"
        if attribute_name == "file":
            how = "make the scene anew with other pixels: build.texture(..., file=array), also within a gradient"
        raise ParameterError(f"{quoted(name)} is not a continuous parameter: {how}.")
    continuous = {block: [attribute.name for attribute in block.type.continuous] for block, _ in reached}
    for block, names in continuous.items():
        if any(kind.find(attribute_name) for kind in BLOCK_TYPES[block.keyword]):
            raise ParameterError(
                f"{quoted(name)}: {block.keyword} {block.name!r} has no {attribute_name}: write it into the block "
                f"first. It has {listed(names)}."
            )
    guess = did_you_mean(attribute_name, chain.from_iterable(continuous.values()))
    owned = "; ".join(f"{block.keyword} {block.name!r} has {listed(names)}" for block, names in continuous.items())
    raise ParameterError(f"{quoted(name)}: unknown attribute {quoted(attribute_name)}.{guess} The {owned}.")


def list_parameters(scene: Scene) -> dict[str, Array]:
    """Return every continuous parameter by its canonical name, in the order in which a scene is written.

    The values have shape () or (2,) or (3,). A material's parameters are listed once, under the material.
    """
    return {
        f"{block.name}.{attribute.name}": on_device(block.read(scene, attribute.name))
        for block in blocks(scene)
        for attribute in block.type.continuous
    }


def get_parameter(scene: Scene, name: str) -> Array:
    """A parameter's value: what `scene[name]` says."""
    return on_device(resolve(scene, name).address.read(scene))


def set_parameters(scene: Scene, values: Mapping[str, Value]) -> Scene:
    """Return the scene with new parameter values; differentiable in values and scene, and fit for `jax.jit`.

    It keeps its dtype; one without a film gets one for a name such as `film.blur`.

    Args:
        values: value by name, with the parameter's shape (a single number may come as shape (1,) too).

    Raises:
        ParameterError: an unknown name, two names for one number, a wrong shape, or a concrete value that no
            `model.txt` may have (traced values have no value to check yet).
    """
    if not isinstance(values, Mapping):
        wanted = "values by the names of parameters are wanted, as {'glass.ior': 1.5}"
        raise ParameterError(f"{wanted}, and this is of the type {type(values).__name__}.")
    scene = with_response(scene, values)
    parameters = {name: resolve(scene, name) for name in values}
    _scalar_addresses(parameters.items())
    entries: dict[Address, tuple[str, Attribute, Array | np.ndarray]] = {}
    for name, (address, _, attribute, _) in parameters.items():
        current = address.read(scene)
        try:
            value = as_array(values[name], current.shape, current.dtype)
        except ValueError as reason:
            raise ParameterError(f"{quoted(name)} {reason}.") from None
        whole = address.entry
        if address.component is not None:
            entry = entries[whole][2] if whole in entries else whole.read(scene)
            value = with_part(entry, address.component, value)
        entries[whole] = (name, attribute, value)

    for address, (name, attribute, value) in entries.items():
        if violation := attribute.violation(value):
            raise ParameterError(f"{quoted(name)}: {violation}, got {np.asarray(value)}.")
        scene = address.write_entry(scene, value)
    # Then what attributes of a block may not have together.
    for name, parameter in parameters.items():
        kind = parameter.block.type
        if kind.checks and (complaint := kind.complaint(parameter.block.read_all(scene))):
            raise ParameterError(f"{quoted(name)}: {complaint[1]}.")
    return scene


def with_response(scene: Scene, names: Iterable[str]) -> Scene:
    """The scene with a film that does nothing, if it has none and one of the names is a film's: `film.gain.r`.

    With several cameras each gets one whose own is asked for: `left.gain.r` is that of the camera `left`.
    """
    check_scene(scene)
    texts = [str(name) for name in names]
    if not scene.further_views:
        if scene.film is not None or not any(name.partition(".")[0] == FILM for name in texts):
            return scene
        return dataclasses.replace(scene, film=neutral_response(scene.camera.viewpoint.dtype))
    for camera in scene.cameras:
        view = scene.seen_by(camera)
        effects = tuple(f"{camera}.{effect.name}" for effect in RESPONSE_EFFECTS)
        asked = [name for name in texts if name in effects or name.rpartition(".")[0] in effects]
        # A texture of a camera's name may have such a number, too.
        if view.film is None and any(not _is_known(scene, name) for name in asked):
            film = dataclasses.replace(neutral_response(view.camera.viewpoint.dtype), name=camera)
            scene = dataclasses.replace(view, film=film).seen_by(scene.camera.name)
    return scene


def _is_known(scene: Scene, name: str) -> bool:
    try:
        return bool(resolve(scene, name))
    except ParameterError:
        return False


def response_effects(scene: Scene, names: Iterable[str]) -> dict[str, str]:
    """The numbers of `scene.film` among names of parameters, and the effect of each; the others move what is traced.

    Those of further views (`Address.is_elsewhere`) change nothing that is shown; their films' are not among them.
    """
    addresses = {name: resolve(scene, name).address for name in names}
    return {name: one.field for name, one in addresses.items() if one.group == FILM and not one.is_elsewhere}


def shared_with(scene: Scene, name: str) -> tuple[str, ...]:
    """Name the other shapes that change too when a shape's parameter is set, in the order of the file.

    `vitreous.ior` is the index of a material, which other shapes may have as well. A name that addresses the
    material itself (`cyan.ior`) leaves no doubt and shares with no one: ().
    """
    parameter = resolve(scene, name)
    if parameter.through_shape is None:
        return ()
    others = [shape for shape in shape_blocks(scene) if shape.name != parameter.through_shape]
    return tuple(shape.name for shape in others if material_of(scene, shape) == parameter.block)


def scalar_names(scene: Scene, names: Iterable[str]) -> tuple[str, ...]:
    """Expand vectors to the names of their numbers: `vitreous.center` to `vitreous.center.x`, `.y` and `.z`.

    The given spelling is kept: `vitreous.ior` stays, although its canonical name is `cyan.ior`.

    Raises:
        ParameterError: an unknown name, two names for one number (also under another spelling), or one text.
    """
    return tuple(_scalar_addresses([(name, resolve(scene, name)) for name in row_of_names(names)]).values())


def row_of_names(names: Iterable[str]) -> tuple[str, ...]:
    """The names in a row. Raises ParameterError of anything else, such as one text or an array of numbers."""
    if isinstance(names, str):
        raise ParameterError(f"a list of names is wanted, and this is the text {names!r}: write [{names!r}].")
    if not isinstance(names, Iterable) or getattr(names, "ndim", 1) != 1:
        raise ParameterError(f"a list of names is wanted, and this is of the type {type(names).__name__}.")
    return tuple(names)


def _scalar_addresses(parameters: Iterable[tuple[str, Parameter]]) -> dict[Address, str]:
    """Map the address of each single number to its name; refuse two names for one number."""
    scalars: dict[Address, tuple[str, str]] = {}
    for name, (whole, _, attribute, _) in parameters:
        addresses = {name: whole}
        if whole.component is None and attribute.components:
            addresses = {f"{name}.{c}": whole._replace(component=k) for k, c in enumerate(attribute.components)}
        for scalar, address in addresses.items():
            if address in scalars:
                both = f"{quoted(scalars[address][1])} and {quoted(name)}"
                raise ParameterError(f"{both} both give the number {quoted(scalar)}: give it once.")
            scalars[address] = (scalar, name)
    return {address: scalar for address, (scalar, _) in scalars.items()}


def parse_assignment(text: str) -> tuple[str, tuple[float, ...]]:
    """Split `vitreous.center=4.2,2.3,-1` into the name and its numbers. Raises ParameterError for anything else."""
    # A block's name may hold a '=', numbers cannot.
    name, equals, numbers = (piece.strip() for piece in text.rpartition("="))
    if not equals or not name:
        raise ParameterError(f"{quoted(text)} is no assignment: write name=value, or name=x,y,z for a vector.")
    if ":" in numbers:
        raise ParameterError(
            f"{quoted(text)}: one value is wanted. Many pictures in one process, which compiles once, are made by "
            "`raytrace-jax batch` from a plan, and an animation by `raytrace-jax sweep --over NAME=START:STOP:COUNT`."
        )
    try:
        return name, tuple(parse_number(number.strip()) for number in numbers.split(","))
    except ValueError as reason:
        raise ParameterError(f"{quoted(text)}: {reason}.") from None
