"""The options of `teach`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

LessonName = Literal["snell", "fresnel", "critical", "ball", "total_reflection", "edges", "cost"]


@dataclass(frozen=True)
class Teach:
    """Draw the figures of a lecture on refraction and its derivatives, with a page that explains them.

    DIR gets a PNG for each figure and index.md with a paragraph on each. The paths are printed.

    Example: raytrace-jax teach -o lecture
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """The folder to write. It is made if it is missing."""
    only: Annotated[UseAppendAction[tuple[tuple[LessonName, ...], ...]], arg(metavar="NAME ...")] = ()
    """Draw only these. snell, fresnel, critical, ball: the formulas; total_reflection: automatic differentiation of a
    square root; edges: derivative pictures with and without edges; cost: the error against the index."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
