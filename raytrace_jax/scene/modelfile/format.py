"""Writing a scene as canonical text, which reads back to the same bits."""

import numpy as np

from raytrace_jax.errors import ModelFileError
from raytrace_jax.scene.block_kinds import TRANSPARENCY
from raytrace_jax.scene.blocks import Block, blocks, scene_model
from raytrace_jax.scene.modelfile.comments import CLOSING, END, OPENING, TOP, Comments, read_comments
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.digits import format_number
from raytrace_jax.util.text import quoted

INDENT = "    "


def format_scene(scene: Scene, *, model: ModelName | None = None, comments: str = "") -> str:
    """Write a scene as the text of a `model.txt`: settings, camera, background, lights, textures, materials, shapes.

    Attributes equal to their default under the model are left out, but for the index of glass and what has a comment.
    Numbers have the fewest digits for their array's dtype, so `parse_scene` with that dtype and model gives the same
    scene, bit for bit.

    Args:
        scene: what to write.
        model: whose defaults are left out; None is the model of the scene's settings, or `classic`.
        comments: the text of a file whose comments are kept, each at the block or the attribute that it belongs to.

    Returns:
        The text, which ends with a line break.

    Raises:
        ModelFileError: the scene holds NaN, infinity or a name that is not one word; no file can say that.
    """
    known = model or scene_model(scene)
    kept = read_comments(comments)
    top, end = ("".join(f"{comment}\n" for comment in kept.above.get(part, [])) for part in (TOP, END))
    return "\n".join(filter(None, [top, *(_block_text(scene, block, known, kept) for block in blocks(scene)), end]))


def _block_text(scene: Scene, block: Block, model: ModelName, comments: Comments) -> str:
    if not is_name(block.name):
        raise ModelFileError(
            f"the {block.keyword} name {quoted(block.name)} cannot be written: a name is one word without braces."
        )
    opening, closing = ((block.keyword, block.name, brace) for brace in (OPENING, CLOSING))
    lines = comments.around(opening, f"{block.keyword} {block.name} {{")
    for attribute in block.kind.attributes:
        part = (block.keyword, block.name, attribute.name)
        line = _line(
            scene, block, attribute, model, is_kept=comments.has(part) or _is_index_of_glass(scene, block, attribute)
        )
        if line:
            lines += comments.around(part, INDENT + line, INDENT)
    lines += comments.around(closing, "}", INDENT)
    return "".join(f"{line}\n" for line in lines)


def _is_index_of_glass(scene: Scene, block: Block, attribute: Attribute) -> bool:
    """Whether an attribute is the index of a material that lets light through."""
    weights = (block.read(scene, name) for name in TRANSPARENCY if block.kind.find(name))
    return attribute.name == "ior" and any(bool(weight != 0) for weight in weights)


def _line(scene: Scene, block: Block, attribute: Attribute, model: ModelName, is_kept: bool) -> str:
    """The line of one attribute; nothing where it has no value, or its default and is not kept all the same."""
    if not attribute.is_stored:
        return f"{attribute.name} {attribute.choices[0]}"
    if attribute.kind == "name":
        named = block.refers_to(scene, attribute.name)
        return f"{attribute.name} {named.name}" if named else ""
    value = block.read(scene, attribute.name)
    if value is None or (attribute.is_text and value == attribute.default and not is_kept):
        return ""
    if attribute.is_text:
        return f"{attribute.name} {_word(block, attribute, value)}"
    values = np.asarray(value)
    if attribute.kind != "number":
        return f"{attribute.name} {_number_text(values)}"
    if not np.all(np.isfinite(values)):
        raise ModelFileError(f"a {block.keyword} has {attribute.name} {values}, which no model.txt can say.")
    text = _number_text(values)
    default = attribute.default_of(model, lambda name: block.read(scene, name))
    return "" if not is_kept and _is_default(text, default, values.dtype) else f"{attribute.name} {text}"


def _word(block: Block, attribute: Attribute, value: str) -> str:
    if is_name(value):
        return value
    what = f"{attribute.name} {quoted(value)}" if value else f"no {attribute.name}: its picture came as numbers"
    raise ModelFileError(f"the {block.keyword} {quoted(block.name)} has {what}, which no model.txt can say.")


def _number_text(values: np.ndarray) -> str:
    return " ".join(format_number(value) for value in np.atleast_1d(values))


def _is_default(text: str, default: tuple[float, ...] | str | None, dtype: np.dtype) -> bool:
    # Compare texts: as numbers, -0 would equal a default of 0 and lose its sign.
    return default is not None and text == _number_text(np.array(default, dtype))
