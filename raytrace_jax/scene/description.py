"""A block as a file or a program describes it, checked on its own: what it may have, and what it must."""

import dataclasses
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.schema import Attribute, BlockKind
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.values import is_traced
from raytrace_jax.util.text import did_you_mean, listed, quoted

KEYWORD, NAME = "keyword of the block", "name of the block"
"""Parts of a block that an error may be about, besides its attributes, which go by their names."""


class Origin(Protocol):
    """Where a block was described: it words errors."""

    @property
    def whole(self) -> str:
        """A word for what all blocks are in: `file`."""
        ...

    @property
    def folder(self) -> Path:
        """Where relative paths begin."""
        ...

    @property
    def wants_relative_paths(self) -> bool:
        """Whether a path must not be absolute."""
        ...

    def is_there(self, part: str) -> str:
        """Where a part of the block is, as the end of a sentence that begins with the block: `is in line 3`."""
        ...

    def unclosed(self, block: str) -> str:
        """What to ask where another block seems to begin within this one, or nothing."""
        ...

    def error(self, part: str, message: str) -> RaytraceError:
        """Return (for the caller to raise) the error that points at a part of the block."""
        ...


@dataclasses.dataclass
class Description:
    """A block as it was described.

    Args:
        keyword: what kind of block it is, one of the table's.
        name: its name.
        origin: where it was described.
        values: by attribute an array of numbers, whole numbers, or the name of another block.
    """

    keyword: str
    name: str
    origin: Origin
    values: dict[str, Any] = dataclasses.field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.keyword} {quoted(self.name)}"

    @property
    def kinds(self) -> list[BlockKind]:
        """The rows of the table that have all attributes that are there and take their values, if any does."""
        rows = list(BLOCK_KINDS[self.keyword])
        for name, value in self.values.items():
            having = [(kind, attribute) for kind in rows if (attribute := kind.find(name))]
            # What none of them takes is wrong, and said to be when it is checked.
            rows = [kind for kind, attribute in having if attribute.takes(value)] or [kind for kind, _ in having]
        return rows

    @property
    def kind(self) -> BlockKind:
        """The row of a complete block: the first that it can be."""
        return self.kinds[0]

    def admit(self, attribute_name: str) -> list[Attribute]:
        """What the attribute of this name can be. Raises the origin's error if none goes with what is there already."""
        found = [attribute for kind in self.kinds if (attribute := kind.find(attribute_name))]
        if found:
            return found
        rows = BLOCK_KINDS[self.keyword]
        owners = [kind for kind in rows if kind.find(attribute_name)]
        if owners:
            strangers = [
                _shown(owners, name, value) for name, value in self.values.items() if not _fits(owners, name, value)
            ]
            message = (
                f"{self} mixes two kinds of {self.keyword}: {attribute_name} does not go with {listed(strangers)}."
            )
        else:
            suggestion = did_you_mean(attribute_name, [name for kind in rows for name in _names(kind)])
            message = f"unknown attribute {quoted(attribute_name)} in {self}.{suggestion}"
        message += f" Valid attributes of a {self.keyword}: {_most(map(_names, rows))}."
        if not owners and attribute_name in (*BLOCK_KINDS, "{"):
            message += self.origin.unclosed(str(self))
        raise self.origin.error(attribute_name, message)

    def complete(self, dtype: np.dtype, model: ModelName) -> None:
        """Fill in the model's defaults. Raises the origin's error if something lacks or does not go together."""
        kinds, given = self.kinds, tuple(self.values)
        missing = [[name for name in kind.required(model) if name not in given] for kind in kinds]
        if all(missing):
            needed = _least(kind.required(model) for kind in kinds)
            message = f"{self} lacks {_least(missing)}. A {self.keyword} must have: {needed}."
            raise self.origin.error(KEYWORD, message)
        kind = kinds[missing.index([])]
        for attribute in kind.attributes:
            if attribute.name not in given:
                default = attribute.default_of(model, self.values.__getitem__)
                is_array = attribute.kind == "number"
                self.values[attribute.name] = np.array(default, dtype).reshape(attribute.shape) if is_array else default
        found = kind.complaint({name: value for name, value in self.values.items() if not is_traced(value)})
        if found:
            check, complaint = found
            part = [name for name in given if name in check.attributes][-1]
            raise self.origin.error(part, f"in {self}, {complaint}.")


def _fits(kinds: list[BlockKind], name: str, value: Any) -> bool:
    """Whether one of some kinds has an attribute of this name that takes such a value."""
    return any(attribute.takes(value) for kind in kinds if (attribute := kind.find(name)))


def _shown(kinds: list[BlockKind], name: str, value: Any) -> str:
    """An attribute, and how many numbers it has where that is what some kinds do not take."""
    return f"{name} of {np.size(value)} numbers" if any(kind.find(name) for kind in kinds) else name


def _names(kind: BlockKind) -> list[str]:
    return [attribute.name for attribute in kind.attributes]


def _most(choices: Iterable[Sequence[str]]) -> str:
    """The choices, each a list of words, without those that are part of another."""
    unlike = list(choices)
    return _either(words for words in unlike if not any(set(words) < set(other) for other in unlike))


def _least(choices: Iterable[Sequence[str]]) -> str:
    """The choices, each a list of words, without those that another is part of."""
    unlike = list(choices)
    return _either(words for words in unlike if not any(set(words) > set(other) for other in unlike))


def _either(choices: Iterable[Sequence[str]]) -> str:
    return "; or ".join(dict.fromkeys(listed(choice) for choice in choices))
