"""The options of `rays`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from tyro.conf import arg

from raytrace_jax.cli.commands.shared import Assignments, RenderOptions, SceneFile


@dataclass(frozen=True)
class Rays:
    """Draw the rays of one pixel from the side, and list them in a table.

    The table on stdout has a line for each ray: from whose hit it starts, what it hits, how far that is, the angles
    there, and the colour that it brings back. The first line's colour is the pixel's.

    Example: raytrace-jax rays vitreous.txt --pixel 320 240 -o rays.svg
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    pixel: Annotated[tuple[int, int], arg(metavar="X Y")]
    """The pixel (required): its column and row, counted from the top left of the whole picture."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.svg")]
    """The drawing to write, .svg or .png. Missing folders are made."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()
