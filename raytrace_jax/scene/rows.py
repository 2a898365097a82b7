"""Rows: blocks as a file, a program or a dict says them, each with where it was said, and the scene that they make.

A row is a `Description` of plain values. `assemble` checks each on its own (values, limits, what goes together), fills
in defaults, checks what holds between blocks (names, references, one camera), and makes the scene.
"""

import dataclasses
import operator
import os
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float

from raytrace_jax.errors import PictureError, RaytraceError, SceneError, SceneWarning
from raytrace_jax.images.pictures import read_picture, states_colours
from raytrace_jax.scene.response import FILM, OF_THE_CAMERA
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import NO_BLOCK, Attribute, BlockType, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES, SETTINGS, SHAPE_KEYWORDS
from raytrace_jax.util.numerics import cast, is_traced, real_numbers
from raytrace_jax.util.text import did_you_mean, listed, quoted, sentence

Value = ArrayLike | Iterable[ArrayLike]

KEYWORD, NAME = "keyword of the block", "name of the block"
"""Parts of a block that an error may be about, besides its attributes, which go by their names."""

SINGLE_KEYWORDS = tuple(keyword for keyword, types in BLOCK_TYPES.items() if types[0].is_single)


@dataclasses.dataclass
class Origin:
    """The program that described a block, or for `reader.FileOrigin` the place in a file: it words errors.

    Relative paths begin in `folder`.
    """

    folder: Path = Path()
    whole = "scene"
    wants_relative_paths = False
    unclosed = ""  # What to ask where another block seems to begin within a block {}.

    def is_there(self, part: str) -> str:
        """Where a part of the block is, as the end of a sentence that begins with the block."""
        return "comes before it"

    def shown(self, part: str, value: Any) -> str:
        """A value as it was said."""
        return quoted(str(value))

    def error(self, part: str, message: str) -> RaytraceError:
        """The error, for the caller to raise, that points at a part of the block."""
        return SceneError(message)


@dataclasses.dataclass
class Description:
    """A block as it was described.

    Args:
        values: by attribute a number or a row of numbers, a word, or the name of another block.
    """

    keyword: str
    name: str
    origin: Origin
    values: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.keyword} {quoted(self.name)}"

    @property
    def types(self) -> list[BlockType]:
        """The rows of the table that have all attributes that are there and take their values, if any does."""
        rows = list(BLOCK_TYPES[self.keyword])
        for name, value in self.values.items():
            having = [(row, attribute) for row in rows if (attribute := row.find(name))]
            # What none of them takes is wrong, and said to be when it is checked.
            rows = [row for row, attribute in having if attribute.takes(value)] or [row for row, _ in having]
        return rows

    @property
    def type(self) -> BlockType:
        """The row of a complete block: the first that it can be."""
        return self.types[0]

    def admit(self, attribute_name: str) -> list[Attribute]:
        """What the attribute of this name can be. Raises the origin's error if none goes with what is there already."""
        found = [attribute for row in self.types if (attribute := row.find(attribute_name))]
        if found:
            return found
        rows = BLOCK_TYPES[self.keyword]
        owners = [row for row in rows if row.find(attribute_name)]
        if owners:
            strangers = []
            for name, value in self.values.items():
                shared = [attribute for row in owners if (attribute := row.find(name))]
                if not any(attribute.takes(value) for attribute in shared):
                    strangers.append(f"{name} of {np.size(value)} numbers" if shared else name)
            message = (
                f"{self} mixes two kinds of {self.keyword}: {attribute_name} does not go with {listed(strangers)}."
            )
        else:
            suggestion = did_you_mean(attribute_name, [a.name for row in rows for a in row.attributes])
            message = f"unknown attribute {quoted(attribute_name)} in {self}.{suggestion}"
            if self.keyword == FILM and attribute_name in OF_THE_CAMERA:
                message = f"{self} has no {attribute_name}: write {OF_THE_CAMERA[attribute_name]}."
        names = [[attribute.name for attribute in row.attributes] for row in rows]
        message += f" Valid attributes of a {self.keyword}: {_either(names, operator.gt)}."
        if not owners and attribute_name in (*BLOCK_TYPES, "{"):
            message += self.origin.unclosed.format(self)
        raise self.origin.error(attribute_name, message)

    def checked(self, dtype: np.dtype, model: ModelName) -> "Description":
        """The complete block: its numbers as arrays, the model's defaults filled in.

        Raises:
            RaytraceError: of the origin: a value is wrong, something lacks or does not go together.
        """
        types = self.types
        values = {name: self._value(name, [a for row in types if (a := row.find(name))], dtype) for name in self.values}
        types = dataclasses.replace(self, values=values).types
        missing = [[name for name in row.required(model) if name not in values] for row in types]
        if all(missing):
            needed = _either([row.required(model) for row in types])
            message = f"{self} lacks {_either(missing)}. A {self.keyword} must have: {needed}."
            raise self.origin.error(KEYWORD, message)
        row = types[missing.index([])]
        for attribute in row.attributes:
            if attribute.name not in values:
                default = attribute.default_of(model, values.__getitem__)
                is_array = attribute.value_type == "number"
                values[attribute.name] = np.array(default, dtype).reshape(attribute.shape) if is_array else default
        found = row.complaint({name: value for name, value in values.items() if not is_traced(value)})
        if found:
            check, complaint = found
            part = [name for name in self.values if name in check.attributes][-1]
            raise self.origin.error(part, f"in {self}, {complaint}.")
        return dataclasses.replace(self, values=values)

    def _value(self, name: str, attributes: list[Attribute], dtype: np.dtype) -> Any:
        """One value as the scene has it, of what its attribute can be: what it is meant for, any if it is none."""

        def refuse(what: str, ending: str = ".") -> RaytraceError:
            return self.origin.error(name, f"in {self}, {what}, got {self.origin.shown(name, value)}{ending}")

        value: Any = self.values[name]
        attribute = next((attribute for attribute in attributes if attribute.takes(value)), attributes[0])
        is_word = isinstance(value, str | os.PathLike)
        if (value is None and attribute.is_optional) or (attribute.value_type == "file" and not is_word):
            return value  # Texels are checked where files are read.
        if attribute.is_text:
            choices = tuple(dict.fromkeys(chain.from_iterable(one.choices for one in attributes)))
            if is_word and (not choices or value in choices):
                return value
            wanted = f"{name} is {' or '.join(choices)}" if choices else attribute.describe()
            raise refuse(wanted, f".{did_you_mean(str(value), choices)}")
        numbers: Any = value
        try:
            if attribute.value_type == "integer":
                numbers = [operator.index(n) for n in numbers] if attribute.components else operator.index(numbers)
            array = as_array(numbers, attribute.shape, dtype if attribute.value_type == "number" else np.dtype(float))
        except TypeError:
            raise refuse(attribute.describe()) from None
        except ValueError as reason:
            raise self.origin.error(name, f"in {self}, {name} {reason}.") from None
        violation = None if is_traced(array) else attribute.violation(np.asarray(array))
        if violation:
            is_rounded = not attribute.violation(np.asarray(numbers, np.float64))
            rounded = f", which {dtype} rounds to {' '.join(map(str, np.ravel(array)))}" if is_rounded else ""
            raise refuse(violation, f"{rounded}.")
        return array


def describe(keyword: str, name: str, values: Mapping[str, Any], origin: Origin) -> Description:
    """The row of a block. Raises SceneError: its name is no name, or its attributes do not go together."""
    if not isinstance(name, str) or not is_name(name):
        got = quoted(str(name))
        raise SceneError(f"expected a name for this {keyword}, got {got}: a name is one word without braces.")
    block = Description(keyword, name, origin)
    for attribute_name, value in values.items():
        block.admit(attribute_name)
        block.values[attribute_name] = value
    return block


def _either(choices: Sequence[Sequence[str]], beats: Callable[[set[str], set[str]], bool] = operator.lt) -> str:
    """The choices, each a list of words, without those that another one beats: contains, or is part of."""
    left = [words for words in choices if not any(beats(set(other), set(words)) for other in choices)]
    return "; or ".join(dict.fromkeys(map(listed, left)))


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
        blocks[keyword].append(block)
        if namespace == "shape":
            blocks[namespace].append(block)
    for keyword in SINGLE_KEYWORDS:
        if not blocks[keyword] and not BLOCK_TYPES[keyword][0].is_optional:
            raise error(f"the scene has no {keyword}: it must have one {keyword} block.")
    # Each type becomes one struct. Names become columns before any is made, as blocks may name those that come later. A
    # column counts all blocks of a keyword, type by type.
    by_type = {
        keyword: [[block for block in blocks[keyword] if block.type is row] for row in rows]
        for keyword, rows in BLOCK_TYPES.items()
    }
    column_of = {keyword: {b.name: k for k, b in enumerate(chain(*groups))} for keyword, groups in by_type.items()}
    fields: dict[str, Any] = {}
    for keyword, rows in BLOCK_TYPES.items():
        for row, those in zip(rows, by_type[keyword], strict=True):
            stored = [attribute for attribute in row.attributes if attribute.is_stored]
            if row.is_single and those:
                # A struct of values, not of arrays.
                (block,) = those
                entries = {a.name: _entry(block, a, column_of) for a in stored}
                fields[row.group] = row.struct(name=block.name, **entries)
            elif row.is_single:
                fields.setdefault(row.group, None)
            else:
                columns = {a.name: _columns(a, those, column_of, dtype) for a in stored}
                file = next((a.name for a in stored if a.value_type == "file"), None)
                pictures = {"texels": tuple(_read_texels(block, file, dtype) for block in those)} if file else {}
                fields[row.group] = row.struct(names=tuple(block.name for block in those), **columns, **pictures)
    _check_mappings(blocks)
    return Scene(**fields, model=model or "classic", shape_order=tuple(block.name for block in blocks["shape"]))


def _entry(block: Description, attribute: Attribute, column_of: dict[str, dict[str, int]]) -> Any:
    """A value of a block as a struct holds it: an array, the column of a name, or what nobody differentiates by."""
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
    if value is None or attribute.is_text:
        return value
    number = int if attribute.value_type == "integer" else float
    return tuple(map(number, value)) if attribute.components else number(value)


def _columns(
    attribute: Attribute, those: list[Description], column_of: dict[str, dict[str, int]], dtype: np.dtype
) -> Array | tuple[Any, ...]:
    """An attribute of all blocks of a type: an array, components first and one column a block, or static values."""
    if attribute.value_type != "number":
        return tuple(_entry(block, attribute, column_of) for block in those)
    rows = [block.values[attribute.name] for block in those]
    # Stacked by NumPy where it can be: thousands of small JAX arrays take seconds.
    if not is_traced(rows):
        return jnp.asarray(np.array(rows, dtype).reshape(len(rows), *attribute.shape).T)
    return jnp.stack(rows, axis=-1)


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
    """The picture of a texture, scene-linear: a file, relative to the origin's folder, or from Python an array.

    Raises:
        RaytraceError: of the block's origin: a file that is missing, broken or does not say how its numbers were made;
            an absolute path in a scene's file; an array that is no picture.
    """

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


def as_array(value: Value, shape: tuple[int, ...], dtype: np.dtype) -> Array | np.ndarray:
    """An array of numbers, a NumPy array unless something in the value is traced; a single number may come in a row.

    Raises:
        ValueError: no numbers, another shape, or not finite; the message is what follows the value's name.
    """
    try:
        known = None if is_traced(value) else np.ma.asarray(value, np.float64).filled(np.nan)
        array = jnp.asarray(value, dtype) if known is None else cast(known, dtype)
    except OverflowError:
        raise ValueError(f"must be finite in {dtype}, got {quoted(str(value))}") from None
    except (TypeError, ValueError):
        raise ValueError(f"takes a number or a row of numbers, got {quoted(str(value))}") from None
    if array.shape == (1,) and shape == ():
        array = array.reshape(())
    if array.shape != shape:
        wanted, got = (f"{n} number{'s' if n != 1 else ''}" for n in (shape[0] if shape else 1, array.size))
        raise ValueError(f"takes {wanted}, got {got if array.ndim < 2 else f'an array of shape {array.shape}'}")
    if not is_traced(array) and not np.all(np.isfinite(array)):
        raise ValueError(f"must be finite in {dtype}, got {quoted(str(value))}")
    return array


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
