"""The words of a declaration: what an attribute of a block may hold, and what quantity its numbers are."""

import dataclasses
import functools
import inspect
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple, TypeGuard, get_args

import equinox as eqx
import numpy as np
from jax.typing import ArrayLike

from ..util.numerics import is_traced
from ..util.text import is_unicode
from .setting_words import ModelName

NO_BLOCK = -1
"""The column of a name that a block does without."""

XY, XYZ, RGB = ("x", "y"), ("x", "y", "z"), ("r", "g", "b")

PICTURE_MIDDLE = "the picture's middle"
"""The default of a camera's `center`, (pixeldim - 1) / 2."""

Range = tuple[float, float]


class Limit(NamedTuple):
    """A condition on an attribute's values, and its words for people: `<attribute> must be <wanted>`."""

    holds: Callable[[np.ndarray], bool]
    wanted: str


def between(least: float, most: float, wanted: str = "", *, is_open: bool = False) -> Limit:
    """The limit that values lie in an interval, with its upper end if it is not open."""
    words = f"{least:g} or greater and less than {most:g}" if is_open else f"from {least:g} to {most:g}"
    is_below = np.less if is_open else np.less_equal
    return Limit(lambda values: bool(np.all((values >= least) & is_below(values, most))), wanted or words)


Check = Callable[..., str | None]
"""A condition on several attributes of a block: a function of their values, with their names, that says as a sentence
without its end what is wrong with them."""


class Quantity(NamedTuple):
    """What an attribute's numbers are: all that a fit, a search or a figure wants to know of them.

    Args:
        unit: what one of them is, for people: `world unit`; empty for a `unit of <attribute>`.
        dimension: the power of a length in its unit: where all lengths of a scene are doubled, the number has to grow
            by two to this power to leave the picture as it is. `model_dimensions` has another one of a model.
        ranges: where a fit keeps the number: in the first of these open intervals that holds the start, or at whose
            lower end it lies; anywhere if none does.
        scale: what a large change of it is as large as: the number itself, its vector, the index's distance from 1, or
            the attributes `sized_by` that say how large its block is.
        is_light: whether it is as large as the light: where all light of a scene is doubled, so is the number.
        role: what a search scans it as: an index of refraction, or a position in the picture.
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
        return self.model_dimensions.get(model, self.dimension)

    def range_at(self, start: float) -> Range:
        """The interval in which a fit keeps a number with this start."""
        return next((span for span in self.ranges if span[0] <= start <= span[1]), (-math.inf, math.inf))


class Attribute(NamedTuple):
    """One attribute of a block: what the field of a struct declares, under the field's name, by `attribute`.

    Args:
        components: what its numbers are called, such as x y z; empty for a single value.
        value_type: what its values are. A `number` is continuous; all else is static: an `integer`, a `constant` (a
            non-differentiable number), a `word` of some, the `name` of another block, a `file`, a
            `glass` of the catalogue.
        default: the values of a block that does not say; None if it has to say.
        model_defaults: the default under a model where it is another one.
        only: the models to which it means something; empty if all have it.
        choices: for a word, those that there are.
        without: what holds where an optional one is not said, for people; empty for nothing. A block has to have what
            is not optional: then it is None.
        after: the attribute after which a file has it; empty for the one declared before.
    """

    name: str
    components: tuple[str, ...] = ()
    value_type: Literal["number", "integer", "constant", "word", "name", "file", "glass"] = "number"
    default: tuple[float, ...] | str | None = None
    model_defaults: Mapping[str, tuple[float, ...]] = {}
    only: tuple[ModelName, ...] = ()
    limit: Limit | None = None
    quantity: Quantity = Quantity()
    choices: tuple[str, ...] = ()
    without: str | None = None
    after: str = ""

    def default_of(self, model: ModelName, read: Callable[[str], Any]) -> tuple[float, ...] | str | None:
        """The values in a block without the attribute; None if there are none. `read` has its values by name."""
        default = self.model_defaults.get(model, self.default)
        return tuple((float(n) - 1) / 2 for n in read("pixeldim")) if default == PICTURE_MIDDLE else default

    @property
    def default_words(self) -> str:
        if self.default is None:
            return "required" if self.without is None else self.without or "none"
        if isinstance(self.default, str):
            return self.default
        every = {"": self.default, **{f" ({model})": values for model, values in self.model_defaults.items()}}
        return ", ".join(" ".join(f"{number:g}" for number in values) + of for of, values in every.items())

    def is_used_by(self, model: str) -> bool:
        return model in (self.only or (model,))

    @property
    def is_optional(self) -> bool:
        """Whether a block may do without it, with the value None or the column `NO_BLOCK`."""
        return self.without is not None

    @property
    def is_text(self) -> bool:
        return self.value_type in ("word", "name", "file", "glass")

    def takes(self, value: Any) -> bool:
        """Whether a value is of its type: the word is one of its own, or as many numbers, which may be traced."""
        if self.value_type == "word":
            return value in self.choices
        shape = (len(value),) if isinstance(value, list | tuple) else np.shape(value)
        return value is None or self.is_text or shape == self.shape

    @property
    def value_count(self) -> int:
        return len(self.components) or 1

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one block's value: `(3,)` for a point, `()` for a radius."""
        return (len(self.components),) if self.components else ()

    @property
    def unit(self) -> str:
        return self.quantity.unit or f"unit of {self.name}"

    def describe(self) -> str:
        if self.value_type == "word":
            return f"{self.name} is {' or '.join(self.choices)}"
        if self.is_text:
            what = {"file": "picture file", "glass": "material of the catalogue"}.get(self.value_type, self.name)
            return f"{self.name} takes the name of a {what}"
        word = "whole number" if self.value_type == "integer" else "number"
        components = f" ({' '.join(self.components)})" if self.components else ""
        return f"{self.name} takes {self.value_count} {word}{'s' if self.value_count > 1 else ''}{components}"

    def violation(self, values: ArrayLike) -> str | None:
        """The limit that finite values break, in words, or None; what is traced has no values yet."""
        if self.limit is None or is_traced(values) or self.limit.holds(np.asarray(values)):
            return None
        return f"{self.name} must be {self.limit.wanted}"


def attribute(components: tuple[str, ...] = (), **declared: Any) -> Any:
    """The field of a struct that is an attribute of its blocks, as `Attribute` has it; static if it is no number."""
    declaration = Attribute("", components, **declared)
    return eqx.field(static=declaration.value_type != "number", metadata={"attribute": declaration})


def word(choices: object, default: str | None = None, **declared: Any) -> Any:
    """The field of an attribute that is one of some words, the arguments of a `Literal`."""
    return attribute(value_type="word", choices=get_args(choices), default=default, **declared)


@functools.cache
def declared_attributes(struct: type) -> tuple[Attribute, ...]:
    """The attributes that a struct's fields declare, in the order in which a file has them."""
    fields = [field for field in dataclasses.fields(struct) if "attribute" in field.metadata]
    attributes = [field.metadata["attribute"]._replace(name=field.name) for field in fields]
    # The sort keeps the order of equals: an attribute with another one before it comes right behind that one.
    order = [field.name for field in fields]
    return tuple(sorted(attributes, key=lambda a: order.index(a.after or a.name)))


class SingleBlock(eqx.Module):
    """A block of which a scene, or each view of it, has one at most, with its name."""

    name: str = eqx.field(static=True)


class Blocks(eqx.Module):
    """Blocks of one type, with their names in the order of the file."""

    names: tuple[str, ...] = eqx.field(static=True)


class BlockType(NamedTuple):
    """A type of block.

    Args:
        keyword: the word that begins such a block; types with one keyword are told apart by their attributes.
        group: the `Scene` field that holds all blocks of this type.
        struct: what is in that field: with a name if a scene has one such block, with a column for each of many if not.
            Without the one block the field is None; a camera has to be there.
        textures: the groups of the textures that have a mapping on it.
    """

    keyword: str
    group: str
    struct: type[Any]
    checks: tuple[Check, ...] = ()
    textures: tuple[str, ...] = ()

    @property
    def attributes(self) -> tuple[Attribute, ...]:
        return declared_attributes(self.struct)

    @property
    def is_single(self) -> bool:
        """Whether a scene, or a view of it, has one block of this keyword."""
        return issubclass(self.struct, SingleBlock)

    @property
    def is_shape(self) -> bool:
        """Whether rays can hit it: it has a material, and a place in `shape_order`."""
        return self.find("material") is not None

    def find(self, attribute_name: str) -> Attribute | None:
        return next((attribute for attribute in self.attributes if attribute.name == attribute_name), None)

    @property
    def continuous(self) -> tuple[Attribute, ...]:
        return tuple(attribute for attribute in self.attributes if attribute.value_type == "number")

    def required(self, model: ModelName) -> tuple[str, ...]:
        needed = (attribute for attribute in self.attributes if not attribute.is_optional)
        return tuple(a.name for a in needed if a.model_defaults.get(model, a.default) is None)

    def complaint(self, values: Mapping[str, Any]) -> tuple[tuple[str, ...], str] | None:
        """The attributes of the first check that a block's values break, and what is wrong.

        Checks with values missing, or traced, are left out.
        """
        values = {name: value for name, value in values.items() if not is_traced(value)}
        for check in self.checks:
            names = tuple(inspect.signature(check).parameters)
            if values.keys() >= set(names) and (found := check(*(np.asarray(values[name]) for name in names))):
                return names, found
        return None


def is_name(text: object) -> TypeGuard[str]:
    """Whether a text can name a block: one token that does not look like a comment."""
    if not isinstance(text, str) or not text or text.startswith(("#", "//")):
        return False
    return is_unicode(text) and not any(character.isspace() or character in "{}\0\ufeff" for character in text)
