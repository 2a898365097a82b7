"""The scene that rows make: what holds between blocks is checked here (names, references, one camera)."""

import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from raytrace_jax.errors import PictureError, RaytraceError, SceneWarning
from raytrace_jax.images.pictures import read_picture, states_colours
from raytrace_jax.scene.rows import KEYWORD, NAME, Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import NO_BLOCK, Attribute
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES, SETTINGS, SHAPE_KEYWORDS
from raytrace_jax.util.numerics import is_traced, real_numbers
from raytrace_jax.util.text import did_you_mean, listed, quoted, sentence

SINGLE_KEYWORDS = tuple(keyword for keyword, types in BLOCK_TYPES.items() if types[0].is_single)


def assemble(
    described: Iterable[Description], dtype: np.dtype, model: ModelName | None, error: Callable[[str], RaytraceError]
) -> Scene:
    """The scene of described blocks; lights, materials and shapes keep their order.

    Args:
        described: the rows; settings come first.
        model: the one as which the scene is loaded; None is that of its settings, or `classic`.
        error: words an error that no block is to blame for.

    Raises:
        RaytraceError: a wrong value, a second camera or none, a name that is taken, or one that no block has; the
            errors of `error` or of the blocks' origins.
    """
    # Blocks by keyword, and all shapes as `shape`, with what a scene must have.
    blocks: dict[str, list[Description]] = {keyword: [] for keyword in (*BLOCK_TYPES, "shape")}
    first_of_name: dict[tuple[str, str], Description] = {}
    for row in described:
        block, keyword = row.checked(dtype, model or "classic"), row.keyword
        if keyword == SETTINGS:
            model = model or block.values["model"]
        if keyword in SINGLE_KEYWORDS and blocks[keyword]:
            (first,) = blocks[keyword]
            message = f"{block} is a second {keyword}; {first} {first.origin.is_there(KEYWORD)}, a scene has one."
            raise block.origin.error(KEYWORD, message)
        namespace = "shape" if keyword in SHAPE_KEYWORDS else keyword
        first = first_of_name.setdefault((namespace, block.name), block)
        if first is not block:
            message = f"the {namespace} name {quoted(block.name)} is taken: {first} {first.origin.is_there(NAME)}."
            raise block.origin.error(NAME, message)
        for key in {keyword, namespace}:
            blocks[key].append(block)
    for keyword in SINGLE_KEYWORDS:
        if not blocks[keyword] and not BLOCK_TYPES[keyword][0].is_optional:
            raise error(f"the scene has no {keyword}: it must have one {keyword} block.")

    # Each type becomes one struct. Names become columns before any is made, as blocks may name those that come later. A
    # column counts all blocks of a keyword, type by type.
    by_type = [(row, [b for b in blocks[key] if b.type is row]) for key, rows in BLOCK_TYPES.items() for row in rows]
    column_of: dict[str, dict[str, int]] = {keyword: {} for keyword in BLOCK_TYPES}
    for row, those in by_type:
        columns = column_of[row.keyword]
        columns.update({block.name: len(columns) + k for k, block in enumerate(those)})
    fields: dict[str, Any] = {}
    for row, those in by_type:
        if row.is_single and not those:
            fields.setdefault(row.group, None)
            continue
        entries: dict[str, Any] = {}
        for attribute in filter(lambda one: one.is_stored, row.attributes):
            if attribute.value_type == "number" and not row.is_single:
                entries[attribute.name] = _columns([block.values[attribute.name] for block in those], attribute, dtype)
            else:
                entries[attribute.name] = tuple(_entry(block, attribute, column_of) for block in those)
            if attribute.value_type == "file":
                entries["texels"] = tuple(_read_texels(block, attribute.name, dtype) for block in those)
        if row.is_single:
            fields[row.group] = row.struct(name=those[0].name, **{name: value for name, (value,) in entries.items()})
        else:
            fields[row.group] = row.struct(names=tuple(block.name for block in those), **entries)
    _check_mappings(blocks)
    return Scene(**fields, model=model or "classic", shape_order=tuple(block.name for block in blocks["shape"]))


def _columns(values: list[Any], attribute: Attribute, dtype: np.dtype) -> Array:
    """The numbers of blocks as one array, components first and one column a block."""
    # Stacked by NumPy where it can be: thousands of small JAX arrays take seconds.
    if not is_traced(values):
        return jnp.asarray(np.array(values, dtype).reshape(len(values), *attribute.shape).T)
    return jnp.stack(values, axis=-1)


def _entry(block: Description, attribute: Attribute, column_of: Mapping[str, Mapping[str, int]]) -> Any:
    """A value of a block as a struct holds it: an array, the column of a name, or what is non-differentiable."""
    value = block.values[attribute.name]
    if attribute.value_type == "number":
        return jnp.asarray(value)
    if attribute.value_type == "file":
        return os.fspath(value) if isinstance(value, str | os.PathLike) else ""
    if attribute.value_type == "name":
        columns = column_of[attribute.refers_to]
        if value is not None and value not in columns:
            keyword = attribute.refers_to
            message = (
                f"{block} has the unknown {keyword} {quoted(value)}.{did_you_mean(value, columns)}"
                f" {keyword.capitalize()}s in this {block.origin.whole}: {listed(columns)}."
            )
            raise block.origin.error(attribute.name, message)
        return NO_BLOCK if value is None else columns[value]
    if attribute.value_type in ("integer", "constant") and value is not None:
        number = int if attribute.value_type == "integer" else float
        return tuple(map(number, value)) if attribute.components else number(value)
    return value


def _check_mappings(blocks: dict[str, list[Description]]) -> None:
    """Refuse textures where they have no mapping."""
    textures = {block.name: block for block in blocks["texture"]}
    materials = {block.name: block for block in blocks["material"]}
    # A shape has its texture through its material, a background has its own.
    uses = [(shape, "material", materials[shape.values["material"]]) for shape in blocks["shape"]]
    uses += [(background, "texture", background) for background in blocks["background"]]
    for block, part, owner in uses:
        texture = textures.get(owner.values["texture"])
        if texture and texture.type.group not in block.type.textures:
            through = "" if owner is block else f"the {owner} with "
            able = [row.keyword for rows in BLOCK_TYPES.values() for row in rows if texture.type.group in row.textures]
            raise block.origin.error(
                part,
                f"{block} has {through}the {texture}: a {block.keyword} has no mapping for the kind "
                f"{quoted(texture.values['kind'])}; a {' or '.join(able)} has one.",
            )


def _read_texels(block: Description, attribute_name: str, dtype: np.dtype) -> Float[Array, "3 height width"]:
    """The scene-linear picture of a texture, from a file or an array. Raises the origin's error for what is none."""

    def refuse(what: object) -> RaytraceError:
        return block.origin.error(attribute_name, sentence(f"in {block}, {what}"))

    value = block.values[attribute_name]
    if not isinstance(value, str | os.PathLike):
        shape = np.shape(value)
        if len(shape) != 3 or shape[0] != 3 or 0 in shape:
            raise refuse(f"file takes a path or an array of shape (3, height, width), got one of shape {shape}")
        try:
            picture = jnp.asarray(value if is_traced(value) else real_numbers(value), dtype)
        except ValueError as reason:
            raise refuse(f"file {reason}") from None
        if not is_traced(value) and not bool(jnp.all(jnp.isfinite(picture))):
            raise refuse("file has an array with numbers that are masked or not finite")
        return picture
    path = Path(value)
    if path.is_absolute() and block.origin.wants_relative_paths:
        raise refuse(f"{quoted(str(path))} is an absolute path: a texture's is relative to the scene file")
    found = block.origin.folder / path
    try:
        transfer = block.values["transfer"]
        if transfer is None and not states_colours(found):
            how = "does not say how its numbers were made: add transfer srgb or course"
            raise refuse(f"the picture {quoted(str(value))} {how}")
        return jnp.asarray(read_picture(found, transfer=transfer), dtype)
    except PictureError as reason:
        raise refuse(f"the texture cannot be read: {reason}") from None


def floating(dtype: DTypeLike | None) -> np.dtype:
    """The dtype that JAX makes of one, or of None.

    Raises:
        TypeError: it is not a floating type.

    Warns:
        SceneWarning: float64 is asked for while JAX computes without it.
    """
    float_dtype = jax.dtypes.canonicalize_dtype(float if dtype is None else dtype)
    if not jnp.issubdtype(float_dtype, jnp.floating):
        raise TypeError(f"dtype must be a floating type, got {float_dtype}")
    # Python's `float` is whichever JAX computes in.
    if dtype is not None and dtype is not float and np.dtype(dtype) != float_dtype:
        warnings.warn(
            f"the scene is in {float_dtype}: {np.dtype(dtype)} needs jax.config.update('jax_enable_x64', True) before.",
            SceneWarning,
            stacklevel=4,
        )
    return float_dtype
