"""The blocks of a scene, in the order in which it is written."""

from typing import NamedTuple

from jaxtyping import Array

from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import BlockKind


class Block(NamedTuple):
    """A block of the scene; `column` is its place in the group's arrays, None where the scene has one such block."""

    kind: BlockKind
    name: str
    column: int | None

    @property
    def keyword(self) -> str:
        """The word that begins the block in a file."""
        return self.kind.keyword

    def read(self, scene: Scene, attribute_name: str) -> Array:
        """The value of an attribute that is no name."""
        array = getattr(getattr(scene, self.kind.group), attribute_name)
        return array if self.column is None else array[..., self.column]

    def read_all(self, scene: Scene) -> dict[str, Array]:
        """The values of all attributes that are no names, by their names."""
        return {one.name: self.read(scene, one.name) for one in self.kind.attributes if one.kind != "name"}

    def refers_to(self, scene: Scene, attribute_name: str) -> int:
        """The column of the block that an attribute names."""
        return getattr(getattr(scene, self.kind.group), attribute_name)[self.column]


def blocks(scene: Scene) -> list[Block]:
    """All blocks in the order in which a scene is written."""
    found = [block for kind in scene_kinds(scene) if not kind.is_shape for block in _of_kind(scene, kind)]
    return found + shape_blocks(scene)


def shape_blocks(scene: Scene) -> list[Block]:
    """The shapes in the order of the file: a shape's place is its index."""
    shapes = {block.name: block for kind in scene_kinds(scene) if kind.is_shape for block in _of_kind(scene, kind)}
    return [shapes[name] for name in scene.shape_order]


def scene_kinds(scene: Scene) -> list[BlockKind]:
    """The rows of the table that the scene's fields follow."""
    return [kind for row in BLOCK_KINDS.values() for kind in row if isinstance(getattr(scene, kind.group), kind.struct)]


def _of_kind(scene: Scene, kind: BlockKind) -> list[Block]:
    group = getattr(scene, kind.group)
    if kind.is_single:
        return [Block(kind, group.name, None)]
    return [Block(kind, name, column) for column, name in enumerate(group.names)]
