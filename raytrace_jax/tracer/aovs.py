"""The arbitrary output variables (AOVs) of a film; free of JAX, for the command line.

A new variable is a name and a row here: what it is called in an EXR file, and where a traced picture has it.
"""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

AovName = Literal["depth", "normal", "position", "shape_index", "bounce_count"]
"""The names of the rows below."""


class Aov(NamedTuple):
    """A variable of each pixel's own point.

    Args:
        channels: the names of its channels in an EXR file.
        value: the variable, from a `wavefront.Trace`.
        missing: what stands where nothing is hit.
    """

    channels: tuple[str, ...]
    value: Callable[[Any], Any]
    missing: int = 0


AOVS: dict[str, Aov] = {
    "depth": Aov(("depth.Z",), lambda trace: trace.first.t),
    "normal": Aov(("normal.X", "normal.Y", "normal.Z"), lambda trace: trace.first.n),
    "position": Aov(("position.X", "position.Y", "position.Z"), lambda trace: trace.first.p),
    "shape_index": Aov(("shape_index.I",), lambda trace: trace.first.shape, missing=-1),
    "bounce_count": Aov(("bounce_count.I",), lambda trace: trace.bounce_count),
}
"""The AOVs, by the names of `RenderSettings.aov`."""
