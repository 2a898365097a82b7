"""Scenes for other renderers, and from them."""

from typing import Literal

Format = Literal["pov", "mitsuba"]
"""POV-Ray 3.7's language; Mitsuba 3's XML."""
