"""The words of a scene's file, and limits of its settings; free of NumPy, for the command line's help."""

from typing import Literal

ModelName = Literal["classic", "additive", "physical"]
"""Models of light at surfaces: the assignment's, that of the report on checkpoints, or that of real glass."""

EdgeMode = Literal["point", "aware"]
"""The view of a sample: one ray, or the area around it."""

PixelConvention = Literal["corner", "center"]
"""The points at which pixels look: the image plane's end points, or the centres of pixels that tile it."""

Reflectance = Literal["none", "schlick"]
"""The weight of reflected light at a transparent surface of the classic model."""

EtaConvention = Literal["course", "physical"]
"""The classic model's ratio of indices on leaving a shape."""

TextureFilter = Literal["bilinear", "nearest"]
"""The colour of a picture on a surface between the centres of its texels."""

TextureWrap = Literal["clamp", "repeat", "black"]
"""The surroundings of a picture on a surface: its border, itself again, or black texels."""

MAX_SAMPLES = 64
"""The most sub-pixel samples in each direction."""

MAX_BOUNCES = 64
"""The most bounces of a path."""

MAX_PICTURE_SIDE = 32768
"""The largest width and height of a picture, in pixels."""
