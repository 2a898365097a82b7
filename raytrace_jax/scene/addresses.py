"""From a parameter's name (`vitreous.center.x`) to its place in the scene's arrays."""

from typing import NamedTuple

import equinox as eqx
from jaxtyping import Array

from raytrace_jax.errors import ParameterError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS, COMPONENT_NAMES, RGB
from raytrace_jax.scene.blocks import Block, blocks, material_of
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.util.text import did_you_mean, listed, quoted


class Address(NamedTuple):
    """The place of a parameter: two names of the same parameter have equal addresses.

    `component` counts along the leading axis; None is the whole attribute.
    """

    group: str
    field: str
    column: int | None
    component: int | None = None

    @property
    def entry(self) -> "Address":
        """The address of the whole attribute that this parameter belongs to."""
        return self._replace(component=None)

    def read(self, scene: Scene) -> Array:
        """The parameter's value in the scene: a vector, or a scalar of shape ()."""
        array = getattr(getattr(scene, self.group), self.field)
        entry = array if self.column is None else array[..., self.column]
        return entry if self.component is None else entry[self.component]

    def write_entry(self, scene: Scene, value: Array) -> Scene:
        """The scene with a new value of the whole attribute."""

        def locate(tree):
            return getattr(getattr(tree, self.group), self.field)

        array = value if self.column is None else locate(scene).at[..., self.column].set(value)
        return eqx.tree_at(locate, scene, array)


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

    def scalars(self, name: str) -> list[tuple[str, Address]]:
        """The names and addresses of the single numbers that this parameter consists of."""
        if self.address.component is not None or not self.attribute.components:
            return [(name, self.address)]
        components = enumerate(self.attribute.components)
        return [(f"{name}.{component}", self.address._replace(component=i)) for i, component in components]


def resolve(scene: Scene, name: str) -> Parameter:
    """Find the parameter that a name means. Raises ParameterError that lists what exists."""
    if not isinstance(name, str):
        raise ParameterError(f"the name of a parameter is wanted, such as 'glass.ior', and this is {name!r}.")
    block_name, attribute_name, component = _split(name)
    owners = [block for block in blocks(scene) if block.name == block_name]
    if not owners:
        raise _unknown_block(scene, name, block_name)
    parameter = _find(scene, owners, attribute_name)
    if parameter is None:
        raise _unknown_attribute(scene, name, owners, attribute_name)
    if component is None:
        return parameter
    components = parameter.attribute.components
    if component not in components:
        wanted = f"its components are {listed(components)}" if components else "it is a single number"
        raise ParameterError(f"{quoted(name)}: {attribute_name} has no component {component!r}, {wanted}.")
    return parameter._replace(address=parameter.address._replace(component=components.index(component)))


def _split(name: str) -> tuple[str, str, str | None]:
    """Split `block.attribute` or `block.attribute.component`; the block's own name may have dots."""
    pieces = name.split(".")
    component = pieces.pop() if len(pieces) > 2 and pieces[-1] in COMPONENT_NAMES else None
    return ".".join(pieces[:-1]), pieces[-1], component


def _find(scene: Scene, owners: list[Block], attribute_name: str) -> Parameter | None:
    """Look among the blocks' own attributes first, then among those of the shapes' materials."""
    for block in owners:
        parameter = _own(block, attribute_name)
        if parameter:
            return parameter
    for block in owners:
        if block.kind.is_shape:
            parameter = _own(material_of(scene, block), attribute_name)
            if parameter:
                return parameter._replace(through_shape=block.name)
    return None


def _own(block: Block, attribute_name: str) -> Parameter | None:
    attribute = block.kind.find(attribute_name)
    if attribute is None or attribute.kind != "number":
        return None
    return Parameter(Address(block.kind.group, attribute.name, block.column), block, attribute)


def _unknown_block(scene: Scene, name: str, block_name: str) -> ParameterError:
    names = list(dict.fromkeys(block.name for block in blocks(scene)))
    if name in names:
        block = next(block for block in blocks(scene) if block.name == name)
        attributes = block.kind.continuous
        examples = listed(f"{name}.{attribute.name}" for attribute in attributes)
        return ParameterError(f"{quoted(name)} is a {block.keyword}, not a parameter. Its parameters are: {examples}.")
    if not block_name:
        return ParameterError(
            f"{quoted(name)} is no parameter: a parameter is written block.attribute, as {names[0]}.viewpoint."
            f"{did_you_mean(name, names)} Blocks of this scene: {listed(names)}."
        )
    return ParameterError(
        f"{quoted(name)}: the scene has no block {quoted(block_name)}.{did_you_mean(block_name, names)}"
        f" Blocks of this scene: {listed(names)}."
    )


def _with_materials(scene: Scene, owners: list[Block]) -> list[Block]:
    """The blocks, and the materials of those that are shapes."""
    return owners + [material_of(scene, block) for block in owners if block.kind.is_shape]


def _elsewhere(block: Block, attribute_name: str) -> bool:
    """Whether another kind of the block's keyword has a number of this name."""
    found = (kind.find(attribute_name) for kind in BLOCK_KINDS[block.keyword])
    return any(attribute.kind == "number" for attribute in found if attribute)


def _continuous(block: Block) -> list[str]:
    return [attribute.name for attribute in block.kind.continuous]


def _unknown_attribute(scene: Scene, name: str, owners: list[Block], attribute_name: str) -> ParameterError:
    static = next(filter(None, (block.kind.find(attribute_name) for block in owners)), None)
    if static:
        return ParameterError(f"{quoted(name)} is not a continuous parameter: {static.how_to_change}")
    owner = next((block for block in _with_materials(scene, owners) if _elsewhere(block, attribute_name)), None)
    if owner:
        return ParameterError(
            f"{quoted(name)}: {owner.keyword} {owner.name!r} has no {attribute_name}, which only another kind of "
            f"{owner.keyword} has: write it into the block first. It has {listed(_continuous(owner))}."
        )
    known: list[str] = []
    described: list[str] = []
    for block in owners:
        own = _continuous(block)
        known += own
        described.append(f"{block.keyword} {block.name!r} has {listed(own)}")
        if block.kind.is_shape:
            material = material_of(scene, block)
            through = _continuous(material)
            known += through
            described.append(f"through its material {material.name!r} {listed(through)}")
    return ParameterError(
        f"{quoted(name)}: unknown attribute {quoted(attribute_name)}.{did_you_mean(attribute_name, known)}"
        f" The {'; '.join(described)}."
    )
