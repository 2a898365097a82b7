"""The picture of the scene that is fitted, and its derivatives by the unknowns."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Bool, Float


class Picture(eqx.Module):
    """A picture near which the problem is made linear.

    Args:
        image: the picture.
        columns: its derivative with respect to each of the unknowns.
        sees_edge: the pixels of an edge-aware picture in which an edge is, as `Trace.sees_edge`; else None.
    """

    image: Float[Array, "3 height width"]
    columns: Float[Array, "parameters 3 height width"]
    sees_edge: Bool[np.ndarray, "height width"] | None = None
