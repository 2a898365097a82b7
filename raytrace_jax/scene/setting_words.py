"""The words of a scene's file, and limits of its settings; free of NumPy, for the command line's help."""

from typing import Literal

ModelName = Literal["classic", "additive", "physical"]
"""What a surface does with light: the assignment's model, that of the report on checkpoints, or that of real glass."""

EdgeMode = Literal["point", "aware"]
"""What a sample sees: one ray, or the area around it."""

PixelConvention = Literal["corner", "center"]
"""Where pixels look: at the image plane's end points, or at the centres of pixels that tile it."""

Reflectance = Literal["none", "schlick"]
"""How reflected and transmitted light share a transparent surface of the classic model."""

EtaConvention = Literal["course", "physical"]
"""The classic model's ratio of indices on leaving a shape."""

TextureFilter = Literal["bilinear", "nearest"]
"""What a picture on a surface shows between the centres of its texels."""

TextureWrap = Literal["clamp", "repeat", "black"]
"""What lies beyond a picture on a surface: its border, itself again, or black texels."""

MAX_SAMPLES = 64
"""The most sub-pixel samples in each direction."""

MAX_BOUNCES = 64
"""The most bounces of a path."""

MAX_PICTURE_SIDE = 32768
"""The largest width and height of a picture, in pixels."""
