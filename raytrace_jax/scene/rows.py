"""Rows: blocks as a file, a program or a dict says them, each with where it was said.

A row is a `Description` of plain values. It is checked on its own: values, limits, what goes together; and its defaults
are filled in.
"""

import dataclasses
import operator
import os
from collections.abc import Callable, Iterable, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array

from raytrace_jax.errors import RaytraceError, SceneError
from raytrace_jax.scene.response import FILM, OF_THE_CAMERA
from raytrace_jax.scene.schema import Attribute, BlockType, is_name
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.table import BLOCK_TYPES
from raytrace_jax.util.numerics import cast, is_traced
from raytrace_jax.util.text import did_you_mean, listed, quoted

Value = ArrayLike | Iterable[ArrayLike]

KEYWORD, NAME = "keyword of the block", "name of the block"
"""Parts of a block that an error may be about, besides its attributes, which go by their names."""


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
        if found := _named(self.types, attribute_name):
            return found
        rows = BLOCK_TYPES[self.keyword]
        owners = [row for row in rows if row.find(attribute_name)]
        if owners:
            strangers = []
            for name, value in self.values.items():
                shared = _named(owners, name)
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
        values = {name: self._value(name, _named(types, name), dtype) for name in self.values}
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


def _named(rows: Iterable[BlockType], name: str) -> list[Attribute]:
    """The attributes of this name."""
    return [attribute for row in rows if (attribute := row.find(name))]


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
