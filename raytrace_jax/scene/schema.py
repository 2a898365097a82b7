"""What the table of blocks is made of: attributes with their defaults, limits and nature, and kinds of blocks."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from raytrace_jax.scene.limits import Check, Limit
from raytrace_jax.scene.nature import PLAIN, Nature
from raytrace_jax.scene.setting_words import ModelName

NO_BLOCK = -1
"""The column of a name that a block does without."""


@dataclasses.dataclass(frozen=True)
class DerivedDefault:
    """A default that follows from other values of the block.

    Args:
        attributes: which; the block must have them.
        values: from their values, in this order, those of the attribute.
        words: what it is, for people.
    """

    attributes: tuple[str, ...]
    values: Callable[..., tuple[float, ...]]
    words: str


class Attribute(NamedTuple):
    """One attribute of a block, with the same name in the file and in the scene's pytree.

    Args:
        name: the word before its values.
        components: what its numbers are called, such as x y z; empty for a single value.
        kind: what its values are. A `number` is continuous; all else is static: an `integer`, a `constant` (a number
            that nobody differentiates by), a `word` of some, the `name` of another block, a `file`.
        default: the values of a block that does not say, or how they follow from others; None if it has to say.
        model_defaults: the default under a model where it is another one.
        only_models: the models to which it means something; empty if all have it.
        limit: what values it may have.
        nature: what quantity its numbers are.
        choices: for a word, those that there are. Of a single one only the file knows: it tells kinds of blocks apart.
        refers_to: for a name, the keyword of the blocks that it names.
        is_optional: a block may do without it; it then has the value None (of a name, the column `NO_BLOCK`).
        without: what holds where an optional one is not said, for people; empty for nothing.
        how_to_change: where it is no number, how it is changed, as the end of an error message.
    """

    name: str
    components: tuple[str, ...] = ()
    kind: Literal["number", "integer", "constant", "word", "name", "file"] = "number"
    default: tuple[float, ...] | str | DerivedDefault | None = None
    model_defaults: Mapping[str, tuple[float, ...]] = {}
    only_models: tuple[ModelName, ...] = ()
    limit: Limit | None = None
    nature: Nature = PLAIN
    choices: tuple[str, ...] = ()
    refers_to: str = ""
    is_optional: bool = False
    without: str = ""
    how_to_change: str = ""

    def is_required(self, model: ModelName) -> bool:
        """Whether a block has to have the attribute."""
        return self.model_defaults.get(model, self.default) is None and not self.is_optional

    def default_of(self, model: ModelName, read: Callable[[str], Any]) -> tuple[float, ...] | str | None:
        """The values in a block without the attribute; None if there are none. `read` has its values by name."""
        default = self.model_defaults.get(model, self.default)
        if isinstance(default, DerivedDefault):
            return default.values(*map(read, default.attributes))
        return default

    def is_used_by(self, model: str) -> bool:
        """Whether it means something to a model."""
        return model in (self.only_models or (model,))

    @property
    def is_text(self) -> bool:
        """Whether its value is one word of text, not numbers."""
        return self.kind in ("word", "name", "file")

    @property
    def is_stored(self) -> bool:
        """Whether the block's struct has a field for it."""
        return len(self.choices) != 1

    def takes(self, value: Any) -> bool:
        """Whether a value is of its kind: the word is one of its own, or as many numbers."""
        if self.kind == "word":
            return value in self.choices
        return value is None or self.is_text or _shape(value) == self.shape

    @property
    def value_count(self) -> int:
        """How many values follow the attribute's name."""
        return len(self.components) or 1

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one block's value: `(3,)` for a point, `()` for a radius."""
        return (len(self.components),) if self.components else ()

    @property
    def unit(self) -> str:
        """What one of its numbers is, for people."""
        return self.nature.unit or f"unit of {self.name}"

    def describe(self) -> str:
        """What the attribute takes, as a phrase for an error message."""
        if self.kind == "name":
            return f"{self.name} takes the name of a {self.refers_to}"
        if self.kind == "word":
            return f"{self.name} is {' or '.join(self.choices)}"
        if self.kind == "file":
            return f"{self.name} takes the name of a picture file"
        word = "whole number" if self.kind == "integer" else "number"
        components = f" ({' '.join(self.components)})" if self.components else ""
        return f"{self.name} takes {self.value_count} {word}{'s' if self.value_count > 1 else ''}{components}"

    def violation(self, values: np.ndarray) -> str | None:
        """Say which limit finite values of shape `shape` break, or return None."""
        if self.limit is None or self.limit.holds(values):
            return None
        return f"{self.name} must be {self.limit.wanted}"


def _shape(value: Any) -> tuple[int, ...]:
    """The shape of a number, of a row of numbers, some of which may be traced, or of an array."""
    is_row = isinstance(value, list | tuple)
    return (len(value),) if is_row else np.shape(value)


class BlockKind(NamedTuple):
    """A kind of block.

    Args:
        keyword: the word that begins such a block; kinds with one keyword are told apart by their attributes.
        group: the `Scene` field that holds all blocks of this kind.
        struct: what is in that field: with a name if a scene has one such block, with a column for each of many if not.
        attributes: in the order in which they are written.
        checks: conditions on several of them.
        is_single: a scene has one block of this keyword.
        is_optional: or none: then the field is None.
        is_shape: rays can hit it; it has a material, and a place in `shape_order`.
        textures: the groups of the textures that have a mapping on it.
    """

    keyword: str
    group: str
    struct: type[Any]
    attributes: tuple[Attribute, ...]
    checks: tuple[Check, ...] = ()
    is_single: bool = False
    is_optional: bool = False
    is_shape: bool = False
    textures: tuple[str, ...] = ()

    def find(self, attribute_name: str) -> Attribute | None:
        """Return the attribute of this name, or None."""
        return next((attribute for attribute in self.attributes if attribute.name == attribute_name), None)

    @property
    def continuous(self) -> tuple[Attribute, ...]:
        """The attributes that a gradient can reach."""
        return tuple(attribute for attribute in self.attributes if attribute.kind == "number")

    def required(self, model: ModelName) -> tuple[str, ...]:
        """The names of the attributes that have no default."""
        return tuple(attribute.name for attribute in self.attributes if attribute.is_required(model))

    def complaint(self, values: Mapping[str, np.ndarray]) -> tuple[Check, str] | None:
        """The first check that a block's values break, and what is wrong; checks with values missing are left out."""
        for check in self.checks:
            if all(name in values for name in check.attributes):
                complaint = check.complaint(*(values[name] for name in check.attributes))
                if complaint:
                    return check, complaint
        return None


def is_name(text: str) -> bool:
    """Whether a text can name a block: one token that does not look like a comment."""
    is_one_token = bool(text) and not any(character.isspace() or character in "{}\0\ufeff" for character in text)
    return is_one_token and not text.startswith(("#", "//"))
