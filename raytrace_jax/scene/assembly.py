"""From described blocks to a `Scene`: what holds between blocks (names, references, one camera)."""

from collections.abc import Callable, Iterable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS, SHAPE_KEYWORDS
from raytrace_jax.scene.description import KEYWORD, NAME, Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.util.text import did_you_mean, listed, quoted

SINGLE_KEYWORDS = tuple(keyword for keyword, kinds in BLOCK_KINDS.items() if kinds[0].is_single)


def assemble(described: Iterable[Description], dtype: np.dtype, error: Callable[[str], RaytraceError]) -> Scene:
    """The scene of complete blocks; lights, materials and shapes keep their order.

    Args:
        described: the blocks, whose numbers have the dtype.
        dtype: floating dtype of the scene's arrays.
        error: words an error that no block is to blame for.

    Raises:
        RaytraceError: a second camera or none, a name that is taken, or one that no block has; the errors of `error` or
            of the blocks' origins.
    """
    blocks = _collect(described)
    for keyword in SINGLE_KEYWORDS:
        if not blocks[keyword]:
            raise error(f"the scene has no {keyword}: it must have one {keyword} block.")
    fields: dict[str, Any] = {}
    for keyword, rows in BLOCK_KINDS.items():
        if keyword in SINGLE_KEYWORDS:
            (block,) = blocks[keyword]
            (kind,) = block.kinds
            entries = {attribute.name: _entry(attribute, block.values[attribute.name]) for attribute in kind.attributes}
            fields[kind.group] = kind.struct(name=block.name, **entries)
        else:
            (kind,) = rows
            columns = {attribute.name: _columns(attribute, blocks, keyword, dtype) for attribute in kind.attributes}
            fields[kind.group] = kind.struct(names=_names(blocks[keyword]), **columns)
    return Scene(**fields, shape_order=_names(blocks["shape"]))


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


def _entry(attribute: Attribute, value: Any) -> Array | tuple[int, ...]:
    """The value of the one block of its kind."""
    return tuple(int(number) for number in value) if attribute.kind == "integer" else jnp.asarray(value)


def _columns(
    attribute: Attribute, blocks: dict[str, list[Description]], keyword: str, dtype: np.dtype
) -> Array | tuple[int, ...]:
    """An attribute of all blocks of a kind: an array, components first and one column a block, or static indices."""
    rows = [block.values[attribute.name] for block in blocks[keyword]]
    if attribute.kind == "name":
        column_of = {name: column for column, name in enumerate(_names(blocks[attribute.refers_to]))}
        return tuple(_column(block, attribute, column_of) for block in blocks[keyword])
    # Stacked by NumPy where it can be: thousands of small JAX arrays take seconds.
    if not any(isinstance(row, Tracer) for row in rows):
        return jnp.asarray(np.array(rows, dtype).reshape(len(rows), *attribute.shape).T)
    return jnp.stack(rows, axis=-1)


def _column(block: Description, attribute: Attribute, column_of: dict[str, int]) -> int:
    name = block.values[attribute.name]
    if name not in column_of:
        kind = attribute.refers_to
        message = (
            f"{block} has the unknown {kind} {quoted(name)}.{did_you_mean(name, column_of)}"
            f" {kind.capitalize()}s in this {block.origin.whole}: {listed(column_of)}."
        )
        raise block.origin.error(attribute.name, message)
    return column_of[name]
