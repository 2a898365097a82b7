"""The schema: what an attribute of a block may hold, what quantity its numbers are, what attributes a block has."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.text import is_unicode

NO_BLOCK = -1
"""The column of a name that a block does without."""

Range = tuple[float, float]


class Limit(NamedTuple):
    """A condition on an attribute's values, and its words for people: `<attribute> must be <wanted>`."""

    holds: Callable[[np.ndarray], bool]
    wanted: str


def between(least: float, most: float, wanted: str = "") -> Limit:
    """The limit that values are neither less nor more than these numbers."""
    return Limit(
        lambda values: bool(np.all((values >= least) & (values <= most))), wanted or f"from {least:g} to {most:g}"
    )


def less_than(most: float, least: float) -> Limit:
    """The limit that values are less than a number, and not less than another one."""
    wanted = f"{least:g} or greater and less than {most:g}"
    return Limit(lambda values: bool(np.all((values >= least) & (values < most))), wanted)


POSITIVE = Limit(lambda values: bool(np.all(values > 0)), "greater than 0")
NOT_NEGATIVE = Limit(lambda values: bool(np.all(values >= 0)), "0 or greater")
NOT_ALL_ZERO = Limit(lambda values: bool(np.any(values != 0)), "a vector other than 0 0 0")


class Check(NamedTuple):
    """A condition on several attributes of a block.

    `complaint` takes their values in this order, and says as a sentence without its end what is wrong with them.
    """

    attributes: tuple[str, ...]
    complaint: Callable[..., str | None]


class Quantity(NamedTuple):
    """The quantity that an attribute's numbers are: all that a fit, a search or a figure wants to know of it.

    Args:
        unit: what one of them is, for people: `world unit`; empty for a `unit of <attribute>`.
        dimension: the power of a length in its unit: where all lengths of a scene are doubled, the number has to grow
            by two to this power to leave the picture as it is.
        model_dimensions: the power under a model where it is another one.
        ranges: where a fit keeps the number: in the first of these open intervals that holds the start, or at whose
            lower end it lies; anywhere if none does.
        scale: what a large change of it is as large as: the number itself, its vector, the index's distance from 1, or
            the attributes that say how large its block is.
        sized_by: for the scale `block`, these attributes.
        is_light: whether it is as large as the light: where all light of a scene is doubled, so is the number.
        role: as what a search scans it: an index of refraction, or one of the three numbers of a position in the
            picture; None if it does not.
    """

    unit: str = ""
    dimension: int = 0
    model_dimensions: Mapping[str, int] = {}
    ranges: tuple[Range, ...] = ()
    scale: Literal["value", "vector", "index", "block"] = "value"
    sized_by: tuple[str, ...] = ()
    is_light: bool = False
    role: Literal["index", "position"] | None = None

    def dimension_in(self, model: str) -> int:
        """The power of a length in the unit, under a model."""
        return self.model_dimensions.get(model, self.dimension)

    def range_at(self, start: float) -> Range:
        """The interval in which a fit keeps a number with this start."""
        return next((span for span in self.ranges if span[0] <= start <= span[1]), (-math.inf, math.inf))


ABOVE_ZERO = ((0.0, math.inf),)

NUMBER = Quantity()
AMOUNT = Quantity(ranges=ABOVE_ZERO)
"""A number of 0 or more, a colour among them: one that starts negative may stay so, as no range holds it."""

LIGHT = AMOUNT._replace(is_light=True)

PIXELS = Quantity("pixel", scale="vector")
"""A point of the picture."""

LENGTH = Quantity("world unit", dimension=1, ranges=ABOVE_ZERO)
VECTOR = Quantity("world unit", dimension=1, scale="vector")
"""A point, or the way from one point to another."""


@dataclasses.dataclass(frozen=True)
class DerivedDefault:
    """A default that `values` makes from other values of the block, those of `attributes`, which it must have.

    `words` say for people what it is.
    """

    attributes: tuple[str, ...]
    values: Callable[..., tuple[float, ...]]
    words: str


class Attribute(NamedTuple):
    """One attribute of a block, with the same name in the file and in the scene's pytree.

    Args:
        name: the word before its values.
        components: what its numbers are called, such as x y z; empty for a single value.
        value_type: what its values are. A `number` is continuous; all else is static: an `integer`, a `constant` (a
            number that nobody differentiates by), a `word` of some, the `name` of another block, a `file`.
        default: the values of a block that does not say, or how they follow from others; None if it has to say.
        model_defaults: the default under a model where it is another one.
        only_models: the models to which it means something; empty if all have it.
        choices: for a word, those that there are. Of a single one only the file knows: it tells blocks of one keyword
            apart.
        refers_to: for a name, the keyword of the blocks that it names.
        is_optional: a block may do without it; it then has the value None (of a name, the column `NO_BLOCK`).
        without: what holds where an optional one is not said, for people; empty for nothing.
        how_to_change: where it is no number, how it is changed, as the end of an error message.
    """

    name: str
    components: tuple[str, ...] = ()
    value_type: Literal["number", "integer", "constant", "word", "name", "file"] = "number"
    default: tuple[float, ...] | str | DerivedDefault | None = None
    model_defaults: Mapping[str, tuple[float, ...]] = {}
    only_models: tuple[ModelName, ...] = ()
    limit: Limit | None = None
    quantity: Quantity = NUMBER
    choices: tuple[str, ...] = ()
    refers_to: str = ""
    is_optional: bool = False
    without: str = ""
    how_to_change: str = ""

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
        return self.value_type in ("word", "name", "file")

    @property
    def is_stored(self) -> bool:
        """Whether the block's struct has a field for it."""
        return len(self.choices) != 1

    def takes(self, value: Any) -> bool:
        """Whether a value is of its type: the word is one of its own, or as many numbers."""
        if self.value_type == "word":
            return value in self.choices
        # Of a row, numbers may be traced.
        shape = (len(value),) if isinstance(value, list | tuple) else np.shape(value)
        return value is None or self.is_text or shape == self.shape

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
        return self.quantity.unit or f"unit of {self.name}"

    def describe(self) -> str:
        """What the attribute takes, as a phrase for an error message."""
        if self.value_type == "word":
            return f"{self.name} is {' or '.join(self.choices)}"
        if self.is_text:
            return f"{self.name} takes the name of a {self.refers_to or 'picture file'}"
        word = "whole number" if self.value_type == "integer" else "number"
        components = f" ({' '.join(self.components)})" if self.components else ""
        return f"{self.name} takes {self.value_count} {word}{'s' if self.value_count > 1 else ''}{components}"

    def violation(self, values: np.ndarray) -> str | None:
        """The limit that finite values break, in words, or None."""
        return f"{self.name} must be {self.limit.wanted}" if self.limit and not self.limit.holds(values) else None


class BlockType(NamedTuple):
    """A type of block.

    Args:
        keyword: the word that begins such a block; types with one keyword are told apart by their attributes.
        group: the `Scene` field that holds all blocks of this type.
        struct: what is in that field: with a name if a scene has one such block, with a column for each of many if not.
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
        """The attribute of this name, or None."""
        return next((attribute for attribute in self.attributes if attribute.name == attribute_name), None)

    @property
    def continuous(self) -> tuple[Attribute, ...]:
        """The attributes that a gradient can reach."""
        return tuple(attribute for attribute in self.attributes if attribute.value_type == "number")

    def required(self, model: ModelName) -> tuple[str, ...]:
        """The names of the attributes that have no default."""
        defaults = [(a, a.model_defaults.get(model, a.default)) for a in self.attributes if not a.is_optional]
        return tuple(attribute.name for attribute, default in defaults if default is None)

    def complaint(self, values: Mapping[str, np.ndarray]) -> tuple[Check, str] | None:
        """The first check that a block's values break, and what is wrong; checks with values missing are left out."""
        possible = [check for check in self.checks if values.keys() >= set(check.attributes)]
        complaints = ((check, check.complaint(*map(values.__getitem__, check.attributes))) for check in possible)
        return next(((check, complaint) for check, complaint in complaints if complaint), None)


def is_name(text: str) -> bool:
    """Whether a text can name a block: one token that does not look like a comment."""
    is_one_token = bool(text) and not any(character.isspace() or character in "{}\0\ufeff" for character in text)
    return is_one_token and is_unicode(text) and not text.startswith(("#", "//"))
