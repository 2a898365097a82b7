"""The names of the models of light; free of NumPy, for the command line's help."""

from typing import Literal

ModelName = Literal["classic", "additive"]
"""What a surface does with light: the assignment's model, or that of the report on checkpoints."""
