"""Writing a scene as canonical text, which reads back to the same bits."""

import numpy as np

from raytrace_jax.errors import ModelFileError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.blocks import Block, blocks
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.util.text import format_number, quoted

INDENT = "    "


def format_scene(scene: Scene, *, model: ModelName = "classic") -> str:
    """Write a scene as the text of a `model.txt`: camera, lights, materials, then shapes in `shape_order`.

    Attributes equal to their default under the model are left out. Numbers have the fewest digits for their array's
    dtype, so `parse_scene` with that dtype and model gives the same scene, bit for bit.

    Raises:
        ModelFileError: the scene holds NaN, infinity or a name that is not one word; no file can say that.
    """
    return "\n".join(_block_text(scene, block, model) for block in blocks(scene))


def _block_text(scene: Scene, block: Block, model: ModelName) -> str:
    if not is_name(block.name):
        raise ModelFileError(
            f"the {block.keyword} name {quoted(block.name)} cannot be written: a name is one word without braces."
        )
    lines = [line for attribute in block.kind.attributes for line in _lines(scene, block, attribute, model)]
    return "".join([f"{block.keyword} {block.name} {{\n", *(f"{INDENT}{line}\n" for line in lines), "}\n"])


def _lines(scene: Scene, block: Block, attribute: Attribute, model: ModelName) -> list[str]:
    """The line of one attribute, or none where it has its default."""
    if attribute.kind == "name":
        (named,) = BLOCK_KINDS[attribute.refers_to]
        name = getattr(scene, named.group).names[block.refers_to(scene, attribute.name)]
        return [f"{attribute.name} {name}"]
    values = np.asarray(block.read(scene, attribute.name))
    if attribute.kind == "integer":
        return [f"{attribute.name} {' '.join(map(str, values))}"]
    if not np.all(np.isfinite(values)):
        raise ModelFileError(f"a {block.keyword} has {attribute.name} {values}, which no model.txt can say.")
    text = _number_text(values)
    default = attribute.default_of(model, lambda name: block.read(scene, name))
    return [] if _is_default(text, default, values.dtype) else [f"{attribute.name} {text}"]


def _number_text(values: np.ndarray) -> str:
    return " ".join(format_number(value) for value in np.atleast_1d(values))


def _is_default(text: str, default: tuple[float, ...] | None, dtype: np.dtype) -> bool:
    # Compare texts: as numbers, -0 would equal a default of 0 and lose its sign.
    return default is not None and text == _number_text(np.array(default, dtype))
