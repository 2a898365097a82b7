"""A block as a file or a program describes it, checked on its own: what it may have, and what it must."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any, Protocol

import numpy as np
from jax.core import Tracer

from raytrace_jax.errors import RaytraceError
from raytrace_jax.scene.block_kinds import BLOCK_KINDS
from raytrace_jax.scene.model_names import ModelName
from raytrace_jax.scene.schema import Attribute, BlockKind
from raytrace_jax.util.text import did_you_mean, listed, quoted

KEYWORD, NAME = "keyword of the block", "name of the block"
"""Parts of a block that an error may be about, besides its attributes, which go by their names."""


class Origin(Protocol):
    """Where a block was described: it words errors."""

    @property
    def whole(self) -> str:
        """What all blocks are in: `file`."""
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
        """The rows of the table that have all attributes that are there; one row if the block is complete."""
        return [kind for kind in BLOCK_KINDS[self.keyword] if all(kind.find(name) for name in self.values)]

    def admit(self, attribute_name: str) -> Attribute:
        """The attribute of this name. Raises the origin's error if none goes with those that are there already."""
        for kind in self.kinds:
            attribute = kind.find(attribute_name)
            if attribute:
                return attribute
        rows = BLOCK_KINDS[self.keyword]
        owners = [kind for kind in rows if kind.find(attribute_name)]
        if owners:
            strangers = [name for name in self.values if not any(kind.find(name) for kind in owners)]
            message = (
                f"{self} mixes two kinds of {self.keyword}: {attribute_name} does not go with {listed(strangers)}."
            )
        else:
            suggestion = did_you_mean(attribute_name, [name for kind in rows for name in _names(kind)])
            message = f"unknown attribute {quoted(attribute_name)} in {self}.{suggestion}"
        message += f" Valid attributes of a {self.keyword}: {_either(map(_names, rows))}."
        if not owners and attribute_name in (*BLOCK_KINDS, "{"):
            message += self.origin.unclosed(str(self))
        raise self.origin.error(attribute_name, message)

    def complete(self, dtype: np.dtype, model: ModelName) -> None:
        """Fill in the model's defaults. Raises the origin's error if something lacks or does not go together."""
        kinds, given = self.kinds, tuple(self.values)
        missing = [[name for name in kind.required(model) if name not in given] for kind in kinds]
        if all(missing):
            needed = _either(kind.required(model) for kind in kinds)
            message = f"{self} lacks {_either(missing)}. A {self.keyword} must have: {needed}."
            raise self.origin.error(KEYWORD, message)
        kind = kinds[missing.index([])]
        for attribute in kind.attributes:
            if attribute.name not in given:
                default = attribute.default_of(model, self.values.__getitem__)
                self.values[attribute.name] = np.array(default, dtype).reshape(attribute.shape)
        found = kind.complaint({name: value for name, value in self.values.items() if not isinstance(value, Tracer)})
        if found:
            check, complaint = found
            part = [name for name in given if name in check.attributes][-1]
            raise self.origin.error(part, f"in {self}, {complaint}.")


def _names(kind: BlockKind) -> list[str]:
    return [attribute.name for attribute in kind.attributes]


def _either(choices: Iterable[Sequence[str]]) -> str:
    """The choices, each a list of words."""
    return "; or ".join(listed(choice) for choice in choices)
