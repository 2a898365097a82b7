"""The blocks of a scene, in the order in which it is written."""

from typing import Any, NamedTuple

from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.given import check_scene
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import NO_BLOCK, BlockKind
from raytrace_jax.scene.setting_words import ModelName


class Block(NamedTuple):
    """A block of the scene; `column` is its place in the group's arrays, None where the scene has one such block."""

    kind: BlockKind
    name: str
    column: int | None

    @property
    def keyword(self) -> str:
        """The word that begins the block in a file."""
        return self.kind.keyword

    def read(self, scene: Scene, attribute_name: str) -> Any:
        """The value of an attribute: an array of a continuous one, of others whatever they are."""
        values = getattr(getattr(scene, self.kind.group), attribute_name)
        if self.column is None:
            return values
        return values[self.column] if isinstance(values, tuple) else values[..., self.column]

    def read_all(self, scene: Scene) -> dict[str, Any]:
        """The values of all attributes that are numbers, by their names."""
        return {one.name: self.read(scene, one.name) for one in self.kind.attributes if not one.is_text}

    def refers_to(self, scene: Scene, attribute_name: str) -> "Block | None":
        """The block that an attribute names, or None."""
        attribute = self.kind.find(attribute_name)
        assert attribute is not None
        column = self.read(scene, attribute_name)
        return None if column == NO_BLOCK else blocks_of(scene, attribute.refers_to)[column]


def blocks(scene: Scene) -> list[Block]:
    """All blocks in the order in which a scene is written."""
    found = [block for kind in scene_kinds(scene) if not kind.is_shape for block in _of_kind(scene, kind)]
    return found + shape_blocks(scene)


def blocks_of(scene: Scene, keyword: str) -> list[Block]:
    """The blocks of a keyword, kind by kind: what a block is named by is its place here."""
    return [block for kind in scene_kinds(scene) if kind.keyword == keyword for block in _of_kind(scene, kind)]


def material_of(scene: Scene, shape: Block) -> Block:
    """The material of a shape."""
    material = shape.refers_to(scene, "material")
    assert material is not None
    return material


def scene_model(scene: Scene) -> ModelName:
    """The model that a scene says it is for; `classic` if it does not say. Raises SceneError for what is no scene."""
    check_scene(scene)
    return (scene.settings and scene.settings.model) or "classic"


def shape_blocks(scene: Scene) -> list[Block]:
    """The shapes in the order of the file: a shape's place is its index."""
    shapes = {block.name: block for kind in scene_kinds(scene) if kind.is_shape for block in _of_kind(scene, kind)}
    return [shapes[name] for name in scene.shape_order]


def scene_kinds(scene: Scene) -> list[BlockKind]:
    """The rows of the table that the scene's fields follow. Raises SceneError for what is no scene."""
    check_scene(scene)
    return [kind for row in BLOCK_KINDS.values() for kind in row if isinstance(getattr(scene, kind.group), kind.struct)]


def _of_kind(scene: Scene, kind: BlockKind) -> list[Block]:
    group = getattr(scene, kind.group)
    if kind.is_single:
        return [Block(kind, group.name, None)]
    return [Block(kind, name, column) for column, name in enumerate(group.names)]
