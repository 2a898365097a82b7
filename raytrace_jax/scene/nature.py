"""What kind of quantity an attribute is: all that a fit, a search or a figure wants to know of it."""

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

Range = tuple[float, float]

Scale = Literal["value", "vector", "index", "block"]
"""What a large change of a number is as large as.

It is the number itself, its vector, the index's distance from 1, or the attributes that say how large its block is."""

Role = Literal["index", "position"]
"""What a search takes a number for: an index of refraction, or one of the three of a position in the picture."""


class Nature(NamedTuple):
    """The nature of an attribute's numbers.

    Args:
        unit: what one of them is, for people: `world unit`; empty for a `unit of <attribute>`.
        dimension: the power of a length in its unit: where all lengths of a scene are doubled, the number has to grow
            by two to this power to leave the picture as it is.
        model_dimensions: the power under a model where it is another one.
        ranges: where a fit keeps the number: in the first of these open intervals that holds the start, or at whose
            lower end it lies; anywhere if none does.
        scale: what a large change of it is.
        sized_by: for the scale `block`, the block's attributes that say how large it is.
        role: as what a search scans it, None if it does not.
    """

    unit: str = ""
    dimension: int = 0
    model_dimensions: Mapping[str, int] = {}
    ranges: tuple[Range, ...] = ()
    scale: Scale = "value"
    sized_by: tuple[str, ...] = ()
    role: Role | None = None

    def dimension_in(self, model: str) -> int:
        """The power of a length in the unit, under a model."""
        return self.model_dimensions.get(model, self.dimension)

    def range_at(self, start: float) -> Range:
        """The interval in which a fit keeps a number with this start."""
        return next((span for span in self.ranges if span[0] <= start <= span[1]), EVERYWHERE)


EVERYWHERE = (-math.inf, math.inf)
ABOVE_ZERO = ((0.0, math.inf),)

PLAIN = Nature()
WEIGHT = Nature(ranges=((0.0, 1.0),))
AMOUNT = Nature(ranges=ABOVE_ZERO)
COLOR = Nature(ranges=ABOVE_ZERO)
"""A colour that starts negative may stay so: no range holds it."""

SHINE = COLOR._replace(model_dimensions={"classic": 1, "physical": 2})
"""The colour of point lights, which the classic model divides by a distance and the physical one by its square.

Ambient light has it too, of which the physical model knows nothing."""

INDEX = Nature("unit of index", ranges=((1.0, math.inf), *ABOVE_ZERO), scale="index", role="index")
"""An index stays above 1; one that starts below 1 is that of a bubble and only stays above 0."""

ANGLE_OF_VIEW = Nature("degree", ranges=((1e-4, 179.9999),))
"""The range lies within an angle's limits also where its ends are rounded to float32."""

PIXELS = Nature("pixel", scale="vector")
"""A place in the picture."""

LENGTH = Nature("world unit", dimension=1, ranges=ABOVE_ZERO)
VECTOR = Nature("world unit", dimension=1, scale="vector")
"""A point, or the way from one point to another."""
