"""Which textures lie on which blocks: a kind of shape has to say how a texture lies on it."""

from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.description import Description
from raytrace_jax.scene.schema import BlockKind
from raytrace_jax.util.words import quoted


def check_mappings(blocks: dict[str, list[Description]]) -> None:
    """Refuse textures where they have no mapping.

    Args:
        blocks: complete blocks by keyword, all shapes as `shape`; what they name exists.

    Raises:
        RaytraceError: of the block's origin.
    """
    textures = {block.name: block for block in blocks["texture"]}
    materials = {block.name: block for block in blocks["material"]}
    for shape in blocks["shape"]:
        material = materials[shape.values["material"]]
        texture = textures.get(material.values["texture"])
        if texture and texture.kind.group not in shape.kind.textures:
            message = f"{shape} has the {material} with the {texture}"
            raise shape.origin.error("material", f"{message}: {_no_mapping(shape.kind, texture)}")
    for background in blocks["background"]:
        texture = textures.get(background.values["texture"])
        if texture and texture.kind.group not in background.kind.textures:
            raise background.origin.error(
                "texture", f"{background} has the {texture}: {_no_mapping(background.kind, texture)}"
            )


def _no_mapping(kind: BlockKind, texture: Description) -> str:
    word = texture.values["kind"]
    able = [other.keyword for rows in BLOCK_KINDS.values() for other in rows if texture.kind.group in other.textures]
    return f"a {kind.keyword} has no mapping for the kind {quoted(word)}; a {' or '.join(able)} has one."
