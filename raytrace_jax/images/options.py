"""What a picture file can be told, in words; free of JAX, for the command line."""

from typing import Literal

Transfer = Literal["course", "srgb"]
"""From scene-linear colours to a PNG's numbers: the course's way (truncation, no gamma), or as screens expect."""

Bits = Literal[8, 16]
"""Bits of a PNG's numbers."""
