"""The options of `render`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from raytrace_jax.cli.commands.shared import Assignments, RenderOptions, SceneFile, Transfer

Aov = Literal["depth", "normal", "position", "shape_index", "bounce_count"]


@dataclass(frozen=True)
class Render:
    """Render a scene to an OpenEXR picture, with a PNG beside it, and print their paths.

    Example: raytrace-jax render vitreous.txt -o vitreous.exr -D vitreous.ior=1.5 --aov depth normal
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]
    """The picture to write: OUT.exr (and OUT.png beside it), or OUT.png alone. Missing folders are made."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    edges: Literal["point", "aware"] = "point"
    """What a sample sees. point: one ray, as the course has it; aware: the area around it, edges blended smoothly."""
    binning: Annotated[int, arg(metavar="N")] = 1
    """Render one large pixel for each N x N of the picture: a quick preview."""
    aov: Annotated[UseAppendAction[tuple[tuple[Aov, ...], ...]], arg(metavar="NAME ...")] = ()
    """More channels for the OpenEXR file: depth, normal, position, shape_index, bounce_count."""
    half: bool = False
    """Store 16-bit floats in the OpenEXR file, half its size."""
    png: bool = True
    """Write a PNG beside the OpenEXR file."""
    png_transfer: Transfer = "course"
    """Colours in the PNG. course: floor(255 * C), no gamma; srgb: what screens expect."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()
