"""The arbitrary output variables (AOVs) of a film; free of JAX, for the command line."""

from typing import Literal

AovName = Literal["depth", "normal", "position", "shape_index", "bounce_count"]

AOV_CHANNELS: dict[str, tuple[str, ...]] = {
    "depth": ("depth.Z",),
    "normal": ("normal.X", "normal.Y", "normal.Z"),
    "position": ("position.X", "position.Y", "position.Z"),
    "shape_index": ("shape_index.I",),
    "bounce_count": ("bounce_count.I",),
}
"""The arbitrary output variables of a film, and the names of their channels in an EXR file."""
