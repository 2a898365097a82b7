"""Picture files: what their numbers mean, and the words that say it, for which no NumPy is needed."""

from typing import Literal

Transfer = Literal["course", "srgb"]
"""How scene-linear colours become a PNG's numbers: the course's way (truncation, no gamma), or as screens expect."""

Clipped = Literal["auto", "drop", "keep"]
"""What becomes of pixels at the ends of what a file can store: `images.masks` says."""

Bits = Literal[8, 16]
"""Bits of a PNG's numbers."""
