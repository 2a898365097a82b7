"""From described blocks to a `Scene`: what holds between blocks (names, references, one camera)."""

from collections.abc import Callable, Iterable
from itertools import chain
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS, SHAPE_KEYWORDS
from raytrace_jax.scene.description import KEYWORD, NAME, Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import NO_BLOCK, Attribute
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.texture_files import file_name, read_texels
from raytrace_jax.scene.values import is_traced
from raytrace_jax.util.text import did_you_mean, listed, quoted


def check_mappings(blocks: dict[str, list[Description]]) -> None:
    """Refuse textures where they have no mapping.

    Args:
        blocks: complete blocks by keyword, all shapes as `shape`; what they name exists.

    Raises:
        RaytraceError: of the block's origin.
    """
    textures = {block.name: block for block in blocks["texture"]}
    materials = {block.name: block for block in blocks["material"]}
    # A shape has its texture through its material, a background has its own.
    uses = [(shape, "material", materials[shape.values["material"]]) for shape in blocks["shape"]]
    uses += [(background, "texture", background) for background in blocks["background"]]
    for block, part, owner in uses:
        texture = textures.get(owner.values["texture"])
        if texture and texture.kind.group not in block.kind.textures:
            through = "" if owner is block else f"the {owner} with "
            able = [
                kind.keyword for rows in BLOCK_KINDS.values() for kind in rows if texture.kind.group in kind.textures
            ]
            raise block.origin.error(
                part,
                f"{block} has {through}the {texture}: a {block.keyword} has no mapping for the kind "
                f"{quoted(texture.values['kind'])}; a {' or '.join(able)} has one.",
            )


SINGLE_KEYWORDS = tuple(keyword for keyword, kinds in BLOCK_KINDS.items() if kinds[0].is_single)


def assemble(
    described: Iterable[Description], dtype: np.dtype, model: ModelName | None, error: Callable[[str], RaytraceError]
) -> Scene:
    """The scene of complete blocks; lights, materials and shapes keep their order.

    Args:
        described: the blocks, whose numbers have the dtype.
        dtype: floating dtype of the scene's arrays.
        model: the one as which the scene is loaded; None is that of its settings, or `classic`.
        error: words an error that no block is to blame for.

    Raises:
        RaytraceError: a second camera or none, a name that is taken, or one that no block has; the errors of `error` or
            of the blocks' origins.
    """
    # Blocks by keyword, with what a scene must have, and then by kind: each kind becomes one struct.
    blocks = _collect(described)
    for keyword in SINGLE_KEYWORDS:
        if not blocks[keyword] and not BLOCK_KINDS[keyword][0].is_optional:
            raise error(f"the scene has no {keyword}: it must have one {keyword} block.")
    by_kind = {
        keyword: [[block for block in blocks[keyword] if block.kind is kind] for kind in rows]
        for keyword, rows in BLOCK_KINDS.items()
    }
    # Names become columns before any struct is made, as blocks may name those that come later. A column counts all
    # blocks of a keyword, kind by kind.
    column_of = {keyword: {b.name: k for k, b in enumerate(chain(*groups))} for keyword, groups in by_kind.items()}
    # A kind of which there is one at most becomes a struct of values, or None; any other a struct of arrays.
    fields: dict[str, Any] = {}
    for keyword, rows in BLOCK_KINDS.items():
        for kind, those in zip(rows, by_kind[keyword], strict=True):
            if kind.is_single and those:
                (block,) = those
                entries = {a.name: _entry(block, a, column_of) for a in kind.attributes if a.is_stored}
                fields[kind.group] = kind.struct(name=block.name, **entries)
            elif kind.is_single:
                fields.setdefault(kind.group, None)
            else:
                columns = {a.name: _columns(a, those, column_of, dtype) for a in kind.attributes if a.is_stored}
                files = next((a for a in kind.attributes if a.kind == "file"), None)
                pictures = {"texels": tuple(read_texels(block, files, dtype) for block in those)} if files else {}
                fields[kind.group] = kind.struct(names=_names(those), **columns, **pictures)
    check_mappings(blocks)
    known = model or getattr(fields["settings"], "model", None) or "classic"
    return Scene(**fields, model=known, shape_order=_names(blocks["shape"]))


def _collect(described: Iterable[Description]) -> dict[str, list[Description]]:
    """The blocks by keyword, and all shapes as `shape`; refuses doubled names and a second camera."""
    blocks: dict[str, list[Description]] = {keyword: [] for keyword in (*BLOCK_KINDS, "shape")}
    first_of_name: dict[tuple[str, str], Description] = {}
    for block in described:
        keyword = block.keyword
        if keyword in SINGLE_KEYWORDS and blocks[keyword]:
            (first,) = blocks[keyword]
            message = f"{block} is a second {keyword}; {first} {first.origin.is_there(KEYWORD)}, a scene has one."
            raise block.origin.error(KEYWORD, message)
        namespace = "shape" if keyword in SHAPE_KEYWORDS else keyword
        first = first_of_name.setdefault((namespace, block.name), block)
        if first is not block:
            message = f"the {namespace} name {quoted(block.name)} is taken: {first} {first.origin.is_there(NAME)}."
            raise block.origin.error(NAME, message)
        blocks[keyword].append(block)
        if namespace == "shape":
            blocks[namespace].append(block)
    return blocks


def _names(blocks: list[Description]) -> tuple[str, ...]:
    return tuple(block.name for block in blocks)


def _entry(block: Description, attribute: Attribute, column_of: dict[str, dict[str, int]]) -> Any:
    """The value of the one block of its kind."""
    value = block.values[attribute.name]
    if attribute.kind == "number":
        return jnp.asarray(value)
    if attribute.kind == "name":
        return _column(block, attribute, column_of[attribute.refers_to])
    return _static(attribute, value)


def _static(attribute: Attribute, value: Any) -> Any:
    """A value that is no number to differentiate by, as a struct holds it."""
    if value is None or attribute.is_text:
        return value
    number = int if attribute.kind == "integer" else float
    return tuple(map(number, value)) if attribute.components else number(value)


def _columns(
    attribute: Attribute, those: list[Description], column_of: dict[str, dict[str, int]], dtype: np.dtype
) -> Array | tuple[Any, ...]:
    """An attribute of all blocks of a kind: an array, components first and one column a block, or static values."""
    if attribute.kind == "name":
        return tuple(_column(block, attribute, column_of[attribute.refers_to]) for block in those)
    rows = [block.values[attribute.name] for block in those]
    if attribute.kind == "file":
        return tuple(file_name(row) for row in rows)
    if attribute.kind != "number":
        return tuple(_static(attribute, row) for row in rows)
    # Stacked by NumPy where it can be: thousands of small JAX arrays take seconds.
    if not is_traced(rows):
        return jnp.asarray(np.array(rows, dtype).reshape(len(rows), *attribute.shape).T)
    return jnp.stack(rows, axis=-1)


def _column(block: Description, attribute: Attribute, column_of: dict[str, int]) -> int:
    """The column of the block that an attribute names, or `NO_BLOCK`."""
    name = block.values[attribute.name]
    if name is None:
        return NO_BLOCK
    if name not in column_of:
        kind = attribute.refers_to
        message = (
            f"{block} has the unknown {kind} {quoted(name)}.{did_you_mean(name, column_of)}"
            f" {kind.capitalize()}s in this {block.origin.whole}: {listed(column_of)}."
        )
        raise block.origin.error(attribute.name, message)
    return column_of[name]
