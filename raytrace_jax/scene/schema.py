"""The words of a declaration: what an attribute of a block may hold, and what quantity its numbers are."""

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, get_args

import equinox as eqx
import numpy as np

from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.text import is_unicode

NO_BLOCK = -1
"""The column of a name that a block does without."""

XY, XYZ, RGB = ("x", "y"), ("x", "y", "z"), ("r", "g", "b")

Range = tuple[float, float]


class Limit(NamedTuple):
    """A condition on an attribute's values, and its words for people: `<attribute> must be <wanted>`."""

    holds: Callable[[np.ndarray], bool]
    wanted: str


def between(least: float, most: float, wanted: str = "") -> Limit:
    """The limit that values lie in a closed interval."""
    wanted = wanted or f"from {least:g} to {most:g}"
    return Limit(lambda values: bool(np.all((values >= least) & (values <= most))), wanted)


def less_than(most: float, least: float) -> Limit:
    """The limit that values lie in a half-open interval."""
    wanted = f"{least:g} or greater and less than {most:g}"
    return Limit(lambda values: bool(np.all((values >= least) & (values < most))), wanted)


UNIT_INTERVAL = between(0, 1)
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
    """One attribute of a block: what the field of a struct declares, under the field's name, by `attribute`.

    Args:
        name: the word before its values.
        components: what its numbers are called, such as x y z; empty for a single value.
        value_type: what its values are. A `number` is continuous; all else is static: an `integer`, a `constant` (a
            non-differentiable number), a `word` of some, the `name` of another block, a `file`.
        default: the values of a block that does not say, or how they follow from others; None if it has to say.
        model_defaults: the default under a model where it is another one.
        only: the models to which it means something; empty if all have it.
        choices: for a word, those that there are.
        without: what holds where an optional one is not said, for people; empty for nothing. A block has to have what
            is not optional: then it is None.
    """

    name: str
    components: tuple[str, ...] = ()
    value_type: Literal["number", "integer", "constant", "word", "name", "file"] = "number"
    default: tuple[float, ...] | str | DerivedDefault | None = None
    model_defaults: Mapping[str, tuple[float, ...]] = {}
    only: tuple[ModelName, ...] = ()
    limit: Limit | None = None
    quantity: Quantity = Quantity()
    choices: tuple[str, ...] = ()
    without: str | None = None

    def default_of(self, model: ModelName, read: Callable[[str], Any]) -> tuple[float, ...] | str | None:
        """The values in a block without the attribute; None if there are none. `read` has its values by name."""
        default = self.model_defaults.get(model, self.default)
        if isinstance(default, DerivedDefault):
            return default.values(*map(read, default.attributes))
        return default

    def is_used_by(self, model: str) -> bool:
        """Whether it means something to a model."""
        return model in (self.only or (model,))

    @property
    def is_optional(self) -> bool:
        """Whether a block may do without it: it then has the value None (of a name, the column `NO_BLOCK`)."""
        return self.without is not None

    @property
    def refers_to(self) -> str:
        """For a name, the keyword of the blocks that it names: the attribute is called by it."""
        return self.name if self.value_type == "name" else ""

    @property
    def is_text(self) -> bool:
        """Whether its value is one word of text, not numbers."""
        return self.value_type in ("word", "name", "file")

    @property
    def is_stored(self) -> bool:
        """Whether the block's struct has a field for it; a word without a choice only tells kinds of blocks apart."""
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

    @property
    def how_to_change(self) -> str:
        """How to change what is no parameter, as the end of an error message; empty for a number."""
        if self.value_type == "file":
            return "it is the name of a file; change it in the scene's file."
        if self.is_text:
            return f"it is a {self.value_type}; change it in the file."
        if self.components and self.value_type == "integer":
            return "it is a count of pixels; set the picture's size with the size option."
        return "" if self.value_type == "number" else "it is a setting; use its option."

    def violation(self, values: np.ndarray) -> str | None:
        """The limit that finite values break, in words, or None."""
        return f"{self.name} must be {self.limit.wanted}" if self.limit and not self.limit.holds(values) else None


def attribute(components: tuple[str, ...] = (), *, after: str = "", **declared: Any) -> Any:
    """The field of a struct that is an attribute of its blocks: static unless its values are numbers.

    Args:
        after: the attribute after which a file has it; empty for the one declared before.
        declared: what `Attribute` has, without its name, which is that of the field.
    """
    one = Attribute("", components, **declared)
    return eqx.field(static=one.value_type != "number", metadata={"attribute": one, "after": after})


def word(choices: object, default: str | None = None, **declared: Any) -> Any:
    """The field of an attribute whose value is one word of a `Literal`."""
    return attribute(value_type="word", choices=get_args(choices), default=default, **declared)


@functools.cache
def declared_attributes(struct: type) -> tuple[Attribute, ...]:
    """The attributes that a struct's fields declare, in the order in which a file has them."""
    found: list[Attribute] = []
    for field in dataclasses.fields(struct):
        if "attribute" in field.metadata:
            before = [one.name for one in found]
            place = before.index(field.metadata["after"]) + 1 if field.metadata["after"] else len(found)
            found.insert(place, field.metadata["attribute"]._replace(name=field.name))
    return tuple(found)


class BlockType(NamedTuple):
    """A type of block.

    Args:
        keyword: the word that begins such a block; types with one keyword are told apart by their attributes.
        group: the `Scene` field that holds all blocks of this type.
        struct: what is in that field: with a name if a scene has one such block, with a column for each of many if not.
        is_optional: a scene may do without the one block: then the field is None.
        textures: the groups of the textures that have a mapping on it.
    """

    keyword: str
    group: str
    struct: type[Any]
    attributes: tuple[Attribute, ...]
    checks: tuple[Check, ...] = ()
    is_optional: bool = False
    textures: tuple[str, ...] = ()

    @property
    def is_single(self) -> bool:
        """Whether a scene has one block of this keyword."""
        return any(field.name == "name" for field in dataclasses.fields(self.struct))

    @property
    def is_shape(self) -> bool:
        """Whether rays can hit it: it has a material, and a place in `shape_order`."""
        return self.find("material") is not None

    def find(self, attribute_name: str) -> Attribute | None:
        """The attribute of this name, or None."""
        return next((attribute for attribute in self.attributes if attribute.name == attribute_name), None)

    @property
    def continuous(self) -> tuple[Attribute, ...]:
        """The attributes that a gradient can reach."""
        return tuple(attribute for attribute in self.attributes if attribute.value_type == "number")

    def required(self, model: ModelName) -> tuple[str, ...]:
        """The names of the attributes that have no default."""
        needed = (a for a in self.attributes if not a.is_optional and a.model_defaults.get(model, a.default) is None)
        return tuple(attribute.name for attribute in needed)

    def complaint(self, values: Mapping[str, np.ndarray]) -> tuple[Check, str] | None:
        """The first check that a block's values break, and what is wrong; checks with values missing are left out."""
        possible = [check for check in self.checks if values.keys() >= set(check.attributes)]
        complaints = ((check, check.complaint(*map(values.__getitem__, check.attributes))) for check in possible)
        return next(((check, complaint) for check, complaint in complaints if complaint), None)


def is_name(text: str) -> bool:
    """Whether a text can name a block: one token that does not look like a comment."""
    is_one_token = bool(text) and not any(character.isspace() or character in "{}\0\ufeff" for character in text)
    return is_one_token and is_unicode(text) and not text.startswith(("#", "//"))
