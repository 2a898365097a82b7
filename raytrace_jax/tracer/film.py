"""The picture that a render returns."""

import equinox as eqx
from jaxtyping import Array, Float, Int, Num


class Film(eqx.Module):
    """A rendered picture and its arbitrary output variables; components first, then rows from the top, then columns.

    Args:
        image: scene-linear RGB; the course's models keep it within [0, 1].
        aov: the variables asked for, by name: `depth` (distance along the camera ray), `normal` (unit, as the shape
            has it), `position` (world units), `shape_index` (place in the file's order, -1 for none), `bounce_count`
            (the largest number of bounces after which a ray of the pixel still hit something). They belong to the
            pixel's own point, whatever the number of samples, and are 0 where nothing is hit.
        overflow: by how many rays the levels of the tile that wanted most exceeded the plan's capacities; these were
            left black. `render` makes it zero; it can be positive only where `render` is traced with the caller's plan.
    """

    image: Float[Array, "3 height width"]
    aov: dict[str, Num[Array, "..."]]
    overflow: Int[Array, ""]
