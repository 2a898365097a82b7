"""A scene as plain values, for JSON, TOML or a database, and back."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jax.typing import DTypeLike

from raytrace_jax.errors import SceneError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.blocks import Block, blocks
from raytrace_jax.scene.build import PythonOrigin, make_scene
from raytrace_jax.scene.description import Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.util.text import did_you_mean, listed, quoted

BLOCK, NAME = "block", "name"
"""Keys of a block beside its attributes: its keyword and its name."""


def scene_to_dict(scene: Scene) -> dict[str, Any]:
    """A scene as strings, numbers and lists: `{"model": "physical", "blocks": [{"block": "sphere", ...}, ...]}`.

    Blocks are in the order in which a file has them; each has its keyword as `block`, its `name`, and every attribute
    that has a value. Numbers come back exactly in the same dtype.

    Raises:
        SceneError: the scene has a picture that came as numbers, and no file.
    """
    return {"model": scene.model, "blocks": [_plain(scene, block) for block in blocks(scene)]}


def scene_from_dict(
    values: Mapping[str, Any], *, folder: str | os.PathLike[str] = ".", dtype: DTypeLike | None = None
) -> Scene:
    """The scene of `scene_to_dict`'s values.

    Args:
        values: `blocks`, as `scene_to_dict` has them, and `model`, which may be missing.
        folder: where the paths of pictures begin.
        dtype: floating dtype of the scene's arrays; None means JAX's default.

    Raises:
        SceneError: the values are no scene.
    """
    rows = values.get("blocks") if isinstance(values, Mapping) else None
    if not isinstance(rows, (list, tuple)) or not all(isinstance(row, Mapping) for row in rows):
        raise SceneError('a scene is wanted as {"blocks": [{"block": "sphere", "name": "ball", ...}, ...]}.')
    unknown = sorted(set(values) - {"model", "blocks"})
    if unknown:
        raise SceneError(f"a scene has model and blocks, not {listed(unknown)}.")
    origin = PythonOrigin(folder=Path(folder))
    return make_scene(*(_described(row, origin) for row in rows), dtype=dtype, model=values.get("model"))


def _plain(scene: Scene, block: Block) -> dict[str, Any]:
    row: dict[str, Any] = {BLOCK: block.keyword, NAME: block.name}
    for attribute in block.kind.attributes:
        if not attribute.is_stored:
            row[attribute.name] = attribute.choices[0]
        elif attribute.kind == "name":
            named = block.refers_to(scene, attribute.name)
            row |= {attribute.name: named.name} if named else {}
        else:
            value = block.read(scene, attribute.name)
            if attribute.kind == "file" and not value:
                raise SceneError(f"the {block.keyword} {quoted(block.name)} came as numbers: a file is wanted for it.")
            plain = value if attribute.is_text else np.asarray(value).tolist()
            row |= {} if value is None else {attribute.name: plain}
    return row


def _described(row: Mapping[str, Any], origin: PythonOrigin) -> Description:
    keyword, name = row.get(BLOCK), row.get(NAME)
    if keyword not in BLOCK_KINDS:
        suggestion = did_you_mean(str(keyword), BLOCK_KINDS)
        raise SceneError(f"there is no block {quoted(str(keyword))}.{suggestion} Blocks: {listed(BLOCK_KINDS)}.")
    if not isinstance(name, str):
        raise SceneError(f"a {keyword} has no name.")
    block = Description(keyword, name, origin)
    for attribute, value in row.items():
        if attribute not in (BLOCK, NAME):
            block.admit(attribute)
            block.values[attribute] = tuple(value) if isinstance(value, list) else value
    return block
