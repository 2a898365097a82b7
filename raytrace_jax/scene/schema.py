"""The vocabulary of `model.txt`: keywords, attributes, defaults and limits, and the models that give them a meaning.

One table for the reader, the writer and the parameters by name, so that all three accept the same values.
An attribute has the same name in the file and in the scene's pytree.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import numpy as np

LARGEST_PICTURE_SIDE = 32768

ModelName = Literal["classic", "additive"]
"""What a surface does with light: the assignment's model, or that of the report on checkpoints."""


class Limit(NamedTuple):
    """A condition on an attribute's values, and the same in words: `<attribute> must be <wanted>`."""

    holds: Callable[[np.ndarray], bool]
    wanted: str


class Attribute(NamedTuple):
    """One attribute of a block: `components` is empty for a single value, `default` is None if it is required.

    `additive` is the default under the additive model, where it is another one.
    """

    name: str
    components: tuple[str, ...] = ()
    kind: Literal["number", "integer", "name"] = "number"
    default: tuple[float, ...] | None = None
    limit: Limit | None = None
    additive: tuple[float, ...] | None = None

    def default_of(self, model: ModelName) -> tuple[float, ...] | None:
        """The values of a block that does not say; None if it has to."""
        return self.additive if model == "additive" and self.additive is not None else self.default

    @property
    def value_count(self) -> int:
        """How many values follow the attribute's name."""
        return len(self.components) or 1

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of one block's value: `(3,)` for a point, `()` for a radius."""
        return (len(self.components),) if self.components else ()

    def describe(self) -> str:
        """What the attribute takes, as a phrase for an error message."""
        if self.kind == "name":
            return f"{self.name} takes the name of a material"
        word = "whole number" if self.kind == "integer" else "number"
        components = f" ({' '.join(self.components)})" if self.components else ""
        return f"{self.name} takes {self.value_count} {word}{'s' if self.value_count > 1 else ''}{components}"

    def violation(self, values: np.ndarray) -> str | None:
        """Say which limit finite values of shape `shape` break, or return None."""
        if self.limit is None or self.limit.holds(values):
            return None
        return f"{self.name} must be {self.limit.wanted}"


class BlockKind(NamedTuple):
    """A kind of block: the `Scene` field that holds all blocks of this kind, and their attributes."""

    group: str
    attributes: tuple[Attribute, ...]

    def find(self, attribute_name: str) -> Attribute | None:
        """Return the attribute of this name, or None."""
        return next((attribute for attribute in self.attributes if attribute.name == attribute_name), None)

    @property
    def continuous(self) -> tuple[Attribute, ...]:
        """The attributes that a gradient can reach."""
        return tuple(attribute for attribute in self.attributes if attribute.kind == "number")


XY, XYZ, RGB = ("x", "y"), ("x", "y", "z"), ("r", "g", "b")
BLACK = (0.0, 0.0, 0.0)

POSITIVE = Limit(lambda values: bool(np.all(values > 0)), "greater than 0")
NOT_NEGATIVE = Limit(lambda values: bool(np.all(values >= 0)), "0 or greater")
UNIT_INTERVAL = Limit(lambda values: bool(np.all((values >= 0) & (values <= 1))), "from 0 to 1")
NOT_ALL_ZERO = Limit(lambda values: bool(np.any(values != 0)), "a vector other than 0 0 0")
PICTURE_SIDES = Limit(
    lambda values: bool(np.all((values >= 1) & (values <= LARGEST_PICTURE_SIDE))),
    f"from 1 to {LARGEST_PICTURE_SIDE} a side",
)

MATERIAL_NAME = Attribute("material", kind="name")

BLOCK_KINDS: dict[str, BlockKind] = {
    "camera": BlockKind(
        "camera",
        (
            Attribute("pixeldim", XY, kind="integer", limit=PICTURE_SIDES),
            Attribute("worlddim", XY, limit=POSITIVE),
            Attribute("viewpoint", XYZ),
        ),
    ),
    "light": BlockKind(
        "lights",
        (
            Attribute("location", XYZ),
            Attribute("emissivity", RGB),
            Attribute("energy", default=(10.0,), limit=NOT_NEGATIVE),
        ),
    ),
    "material": BlockKind(
        "materials",
        (
            Attribute("ambient", RGB, default=BLACK, additive=(0.05,) * 3),
            Attribute("diffuse", RGB, default=BLACK, additive=(0.78,) * 3),
            Attribute("specular", RGB, default=BLACK, additive=(0.2,) * 3),
            Attribute("alpha", default=(0.0,), limit=UNIT_INTERVAL),
            Attribute("ior", default=(1.0,), limit=POSITIVE, additive=(1.45,)),
            Attribute("hardness", default=(1000.0,), limit=NOT_NEGATIVE),
            Attribute("reflectivity", default=(0.0,), limit=UNIT_INTERVAL),
            Attribute("fresnel", default=(0.0,), limit=UNIT_INTERVAL),
            Attribute("transmission", default=(0.0,), limit=UNIT_INTERVAL),
        ),
    ),
    "plane": BlockKind(
        "planes", (MATERIAL_NAME, Attribute("normal", XYZ, limit=NOT_ALL_ZERO), Attribute("point", XYZ))
    ),
    "sphere": BlockKind("spheres", (MATERIAL_NAME, Attribute("center", XYZ), Attribute("radius", limit=POSITIVE))),
}

SHAPE_KEYWORDS = ("plane", "sphere")
ATTRIBUTE_NAMES = frozenset(attribute.name for kind in BLOCK_KINDS.values() for attribute in kind.attributes)


def is_name(text: str) -> bool:
    """Whether a text can name a block: one token that does not look like a comment."""
    is_one_token = bool(text) and not any(character.isspace() or character in "{}\0\ufeff" for character in text)
    return is_one_token and not text.startswith(("#", "//"))
