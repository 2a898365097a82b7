"""Rows: blocks as a file, a program or a dict says them, checked on their own; and the scene that they make."""

import dataclasses
import operator
import os
import warnings
from collections.abc import Callable, Iterable, Mapping
from itertools import chain
from pathlib import Path
from typing import Any, Self

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float

from ..errors import PictureError, RaytraceError, RaytraceWarning, SceneError, reworded
from ..images.pictures import read_whole_picture, states_colours
from ..optics.dispersion import CHANNEL_WAVELENGTHS
from ..optics.glass import named
from ..util.compilation import refuse_fork
from ..util.numerics import cast, is_traced, on_device, real_numbers
from ..util.text import did_you_mean, listed, quoted, sentence
from .response import FILM
from .scene import Scene, View
from .schema import NO_BLOCK, Attribute, BlockType, is_name
from .setting_words import ModelName
from .table import BLOCK_TYPES, SETTINGS, SHAPE_KEYWORDS

Value = ArrayLike | Iterable[ArrayLike]

OF_VIEWS = ("camera", FILM)
"""The keywords of blocks of which each view of a scene has one."""

HEAD = "keyword and name of the block"
"""The part of a block that an error may be about, besides its attributes, which go by their names."""


@dataclasses.dataclass
class Description:
    """A block as a program describes it; `reader.FileBlock` is one of a file.

    Args:
        folder: where the paths of pictures begin.
        values: by attribute a number or a row of numbers, a word, or the name of another block.
    """

    keyword: str
    name: str
    folder: Path = Path()
    values: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.keyword} {quoted(self.name)}"

    def error(self, part: str, message: str) -> RaytraceError:
        """The error, for the caller to raise, about a part of the block: `HEAD` or an attribute."""
        return SceneError(message)

    @property
    def kinds(self) -> list[BlockType]:
        """The rows that have all its attributes; if any take all its values, only these. The first is its own."""
        having = [row for row in BLOCK_TYPES[self.keyword] if all(map(row.find, self.values))]
        return [
            row for row in having if all(a.takes(self.values[a.name]) for a in row.attributes if a.name in self.values)
        ] or having

    def admit(self, name: str) -> list[Attribute]:
        """What the attribute of this name can be. Raises the block's error if none goes with what is there already."""
        if attributes := _named(self.kinds, name):
            return attributes
        rows = BLOCK_TYPES[self.keyword]
        known = list(dict.fromkeys(attribute.name for row in rows for attribute in row.attributes))
        if name in known:
            others = [row for row in rows if row.find(name)]
            strangers = [said for said in self.values if not _named(others, said)] or self.values
            message = f"{self} mixes two kinds of {self.keyword}: {name} does not go with {listed(strangers)}."
        else:
            message = f"unknown attribute {quoted(name)} in {self}.{did_you_mean(name, known)}"
        raise self.error(name, f"{message} Valid attributes of a {self.keyword}: {listed(known)}.")

    def checked(self, dtype: np.dtype, model: ModelName) -> Self:
        """The complete block: its numbers as arrays, the model's defaults filled in.

        Raises the block's error: a value is wrong, something lacks or does not go together.
        """
        if self.values.get("glass") is not None:
            return self._from_catalogue().checked(dtype, model)
        kinds = self.kinds
        values = {name: self._value(name, _named(kinds, name), dtype) for name in self.values}
        missing = [[name for name in row.required(model) if name not in values] for row in kinds]
        if all(missing):
            needed = [row.required(model) for row in kinds]
            lacking, wanted = ("; or ".join(dict.fromkeys(map(listed, names))) for names in (missing, needed))
            raise self.error(HEAD, f"{self} lacks {lacking}. A {self.keyword} must have: {wanted}.")
        row = kinds[missing.index([])]
        for attribute in row.attributes:
            if attribute.name not in values:
                default = attribute.default_of(model, values.__getitem__)
                is_array = attribute.value_type == "number"
                values[attribute.name] = np.array(default, dtype).reshape(attribute.shape) if is_array else default
        if complaint := row.complaint(values):
            names, words = complaint
            raise self.error([name for name in self.values if name in names][-1], f"in {self}, {words}.")
        return dataclasses.replace(self, values=values)

    def _from_catalogue(self) -> Self:
        """The block with the indices of its glass in the place of the name. Raises the block's error."""
        if "ior" in self.values:
            raise self.error("glass", f"{self} has both ior and glass, which says the ior: leave one of them out.")
        with reworded(lambda reason: self.error("glass", sentence(f"in {self}, {reason}"))):
            ior = tuple(map(float, named(str(self.values["glass"])).index(CHANNEL_WAVELENGTHS)))
        return dataclasses.replace(self, values=self.values | {"ior": ior, "glass": None})

    def _value(self, name: str, attributes: list[Attribute], dtype: np.dtype) -> Any:
        """One value as the scene has it: what its attribute is meant for, or anything if it is meant for nothing."""
        value: Any = self.values[name]
        attribute = next((attribute for attribute in attributes if attribute.takes(value)), attributes[0])
        is_word = isinstance(value, str | os.PathLike)
        if (value is None and attribute.is_optional) or (attribute.value_type == "file" and not is_word):
            return value  # Texels are checked where files are read.
        if attribute.is_text:
            if is_word and attribute.takes(value):
                return value
            raise self.error(name, f"in {self}, {either(attributes)}, {_got(value)}.")
        numbers: Any = value
        try:
            if attribute.value_type == "integer":
                numbers = tuple(map(operator.index, numbers)) if attribute.components else operator.index(numbers)
            array = as_array(numbers, attribute.shape, dtype if attribute.value_type == "number" else np.dtype(float))
        except TypeError:
            raise self.error(name, f"in {self}, {attribute.describe()}, {_got(value)}.") from None
        except ValueError as reason:
            raise self.error(name, f"in {self}, {name} {reason}.") from None
        if violation := attribute.violation(array):
            raise self.error(name, f"in {self}, {violation}, {_got(value)}, which is {array} in {array.dtype}.")
        if attribute.value_type == "number":
            return array
        return numbers if attribute.value_type == "integer" else float(array)


def _named(rows: Iterable[BlockType], name: str) -> list[Attribute]:
    return [attribute for row in rows if (attribute := row.find(name))]


def either(attributes: Iterable[Attribute]) -> str:
    """What any of some attributes wants, in words, each once."""
    return " or ".join(dict.fromkeys(attribute.describe() for attribute in attributes))


def describe(keyword: str, name: object, values: Mapping[str, Any], folder: Path = Path()) -> Description:
    """The row of a block. Raises SceneError: its name is no name, or its attributes do not go together."""
    if not is_name(name):
        raise SceneError(f"expected a name for this {keyword}, {_got(name)}: a name is one word without braces.")
    block = Description(keyword, name, folder)
    for attribute_name, value in values.items():
        block.admit(attribute_name)
        block.values[attribute_name] = value
    return block


def as_array(value: Value, shape: tuple[int, ...], dtype: np.dtype) -> Array | np.ndarray:
    """An array of numbers, a NumPy array unless something in the value is traced; a single number may come in a row.

    Raises:
        ValueError: no numbers, another shape, or not finite; the message is what follows the value's name.
    """
    try:
        known = None if is_traced(value) else np.ma.asarray(value, np.float64).filled(np.nan)
        array = jnp.asarray(value, dtype) if known is None else cast(known, dtype)
    except OverflowError:
        raise ValueError(f"must be finite in {dtype}, {_got(value)}") from None
    except (TypeError, ValueError):
        raise ValueError(f"takes a number or a row of numbers, {_got(value)}") from None
    if array.shape == (1,) and not shape:
        array = array.reshape(())
    if array.shape != shape:
        raise ValueError(f"takes {_count(shape)}, got {_count(array.shape)}")
    if not is_traced(array) and not np.all(np.isfinite(array)):
        raise ValueError(f"must be finite in {dtype}, {_got(value)}")
    return array


def _got(value: object) -> str:
    return f"got {quoted(str(value))}"


def _count(shape: tuple[int, ...]) -> str:
    if len(shape) > 1:
        return f"an array of shape {shape}"
    count = shape[0] if shape else 1
    return f"{count} number{'s' if count != 1 else ''}"


def assemble(
    described: Iterable[Description], dtype: np.dtype, model: ModelName | None, error: Callable[[str], RaytraceError]
) -> Scene:
    """The scene of described blocks; lights, materials and shapes keep their order.

    The first camera is the one that is rendered. With several of them a film is that of the camera of its name.

    Raises the blocks' errors: a wrong value, a name that is taken, a film of no camera, or a name that no block has.

    Args:
        described: the rows; settings come first.
        model: the one as which the scene is loaded; None is that of its settings, or `classic`.
        error: words an error that no block is to blame for.
    """
    refuse_fork()  # The first arrays start JAX, and what forks from then on has no use of it.
    # Blocks by keyword and name. Shapes have their names in common, and their order.
    named: dict[str, dict[str, Description]] = {_namespace(keyword): {} for keyword in BLOCK_TYPES}
    for row in described:
        block, keyword = row.checked(dtype, model or "classic"), row.keyword
        others = named[_namespace(keyword)]
        if others and BLOCK_TYPES[keyword][0].is_single and (keyword not in OF_VIEWS or block.name in others):
            raise block.error(HEAD, _second(block, others))
        if block.name in others:
            message = f"the {_namespace(keyword)} name {quoted(block.name)} is taken: {others[block.name]} has it."
            raise block.error(HEAD, message)
        if keyword == SETTINGS:
            if any(named.values()):
                raise block.error(HEAD, f"{block} comes too late: settings are the first block of a scene.")
            model = model or block.values["model"]
        others[block.name] = block
    if not named["camera"]:
        raise error("the scene has no camera: it must have a camera block.")
    further = _taken_views(named)

    # Each type becomes one struct. Names become columns before any is made, as blocks may name those that come later. A
    # column counts all blocks of a keyword, type by type.
    blocks: dict[BlockType, list[Description]] = {row: [] for rows in BLOCK_TYPES.values() for row in rows}
    for block in chain.from_iterable(others.values() for others in named.values()):
        blocks[block.kinds[0]].append(block)
    columns: dict[str, dict[str, int]] = {keyword: {} for keyword in BLOCK_TYPES}
    for row, those in blocks.items():
        names = columns[row.keyword]
        for block in those:
            names[block.name] = len(names)
    fields: dict[str, Any] = {}
    for row, those in blocks.items():
        if those or not row.is_single:
            fields[row.group] = _struct(row, those, columns, dtype)
        fields.setdefault(row.group, None)
    _check_mappings(named)

    def alone(block: Description | None) -> Any:
        return block and _struct(block.kinds[0], [block], columns, dtype)

    views = tuple(View(alone(camera), alone(film)) for camera, film in further)
    return Scene(**fields, model=model or "classic", shape_order=tuple(named["shape"]), further_views=views)


def _second(block: Description, others: Mapping[str, Description]) -> str:
    named = " of that name" if block.name in others and block.keyword in OF_VIEWS else ""
    before = others.get(block.name) or next(iter(others.values()))
    return f"{block} is a second {block.keyword}{named}; {before} comes before it."


def _taken_views(named: dict[str, dict[str, Description]]) -> list[tuple[Description, Description | None]]:
    """Take all cameras but the first out of a scene's blocks, each with its film.

    Raises a film's error: no camera has its name where there are several, or it is a second one where there is one.
    """
    cameras, films = named["camera"], named[FILM]
    if len(cameras) == 1 and len(films) > 1:
        first, second, *_ = films.values()
        raise second.error(HEAD, _second(second, {first.name: first}))
    for film in films.values() if len(cameras) > 1 else ():
        if film.name not in cameras:
            raise film.error(
                HEAD,
                f"{film} belongs to no camera: with several cameras a film has the name of its own, as film "
                f"{next(iter(cameras))}.{did_you_mean(film.name, cameras)} Cameras of this scene: {listed(cameras)}.",
            )
    return [(cameras.pop(name), films.pop(name, None)) for name in list(cameras)[1:]]


def _namespace(keyword: str) -> str:
    return "shape" if keyword in SHAPE_KEYWORDS else keyword


def _struct(row: BlockType, blocks: list[Description], columns: dict[str, dict[str, int]], dtype: np.dtype) -> Any:
    entries: dict[str, Any] = {}
    for attribute in row.attributes:
        values: list[Any] = [block.values[attribute.name] for block in blocks]
        if attribute.value_type == "name":
            values = [_column(block, attribute.name, columns[attribute.name]) for block in blocks]
        elif attribute.value_type == "file":
            entries["texels"] = tuple(_read_texels(block, dtype) for block in blocks)
            values = [os.fspath(value) if isinstance(value, str | os.PathLike) else "" for value in values]
        if row.is_single:
            entries[attribute.name] = on_device(values[0]) if attribute.value_type == "number" else values[0]
        elif attribute.value_type != "number":
            entries[attribute.name] = tuple(values)
        elif is_traced(values):
            entries[attribute.name] = jnp.stack(values, axis=-1)
        else:  # Stacked by NumPy: thousands of small JAX arrays take seconds.
            entries[attribute.name] = on_device(np.array(values, dtype).reshape(len(values), *attribute.shape).T)
    if row.is_single:
        return row.struct(name=blocks[0].name, **entries)
    return row.struct(names=tuple(block.name for block in blocks), **entries)


def _column(block: Description, keyword: str, columns: Mapping[str, int]) -> int:
    """The column of the block that an attribute names, which is called by that block's keyword."""
    value = block.values[keyword]
    if value is not None and value not in columns:
        message = f"{block} has the unknown {keyword} {quoted(value)}.{did_you_mean(value, columns)}"
        raise block.error(keyword, f"{message} {keyword.capitalize()}s in this scene: {listed(columns)}.")
    return NO_BLOCK if value is None else columns[value]


def _check_mappings(named: dict[str, dict[str, Description]]) -> None:
    # A shape has its texture through its material, a background has its own.
    uses = [(shape, "material", named["material"][shape.values["material"]]) for shape in named["shape"].values()]
    uses += [(background, "texture", background) for background in named["background"].values()]
    for block, part, owner in uses:
        texture = named["texture"].get(owner.values["texture"])
        if texture and (group := texture.kinds[0].group) not in block.kinds[0].textures:
            kind = quoted(texture.values["kind"])
            others = [word for word, rows in BLOCK_TYPES.items() if any(group in row.textures for row in rows)]
            words = f"a {block.keyword} has no mapping for the kind {kind}, as {listed(others)} have"
            raise block.error(part, f"{block} has the {texture}: {words}.")


def _read_texels(block: Description, dtype: np.dtype) -> Float[Array, "3 height width"]:
    """The scene-linear picture of a texture, from a file or an array. Raises the block's error for anything else."""

    def refuse(what: object) -> RaytraceError:
        return block.error("file", sentence(f"in {block}, {what}"))

    value = block.values["file"]
    if not isinstance(value, str | os.PathLike):
        shape = np.shape(value)
        if len(shape) != 3 or shape[0] != 3 or 0 in shape:
            raise refuse(f"file takes a path or an array of shape (3, height, width), got one of shape {shape}")
        if is_traced(value):
            return jnp.asarray(value, dtype)
        try:
            picture = jnp.asarray(real_numbers(value), dtype)
        except ValueError as reason:
            raise refuse(f"file {reason}") from None
        if not jnp.all(jnp.isfinite(picture)):
            raise refuse("file has an array with numbers that are masked or not finite")
        return picture
    path, transfer = block.folder / value, block.values["transfer"]
    try:
        if transfer is None and not states_colours(path):
            how = "does not say how its numbers were made: add transfer srgb or course"
            raise refuse(f"the picture {quoted(str(value))} {how}")
        return jnp.asarray(read_whole_picture(path, transfer=transfer), dtype)
    except PictureError as reason:
        raise refuse(f"the texture cannot be read: {reason}") from None


def floating(dtype: DTypeLike | None) -> np.dtype:
    """The dtype that JAX makes of one, or of None. Raises TypeError: it is not a floating type.

    Warns:
        RaytraceWarning: float64 is asked for while JAX computes without it.
    """
    float_dtype = jax.dtypes.canonicalize_dtype(float if dtype is None else dtype)
    if not jnp.issubdtype(float_dtype, jnp.floating):
        raise TypeError(f"dtype must be a floating type, got {float_dtype}")
    # Python's `float` is whichever JAX computes in.
    if dtype is not None and dtype is not float and np.dtype(dtype) != float_dtype:
        warnings.warn(
            f"the scene is in {float_dtype}: {np.dtype(dtype)} needs jax.config.update('jax_enable_x64', True) before.",
            RaytraceWarning,
            stacklevel=4,
        )
    return float_dtype
