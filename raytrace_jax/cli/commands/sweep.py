"""The options of `sweep`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import arg

from raytrace_jax.cli.commands.shared import Assignments, RenderOptions, SceneFile, Transfer


@dataclass(frozen=True)
class Sweep:
    """Animate a scene: a parameter goes through a range, a frame a value.

    Example: raytrace-jax sweep vitreous.txt --over vitreous.ior=1.0:2.4:60 -o sweep.gif --bounce --label
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    over: Annotated[str, arg(metavar="NAME=START:STOP:COUNT")]
    """The parameter and its values, evenly spaced with both ends included, as vitreous.ior=1.0:2.4:60; it is a single
    number, as vitreous.center.x; `raytrace-jax info SCENE` lists the names."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.gif")]
    """The animation to write: OUT.gif, or OUT.mp4 if ffmpeg is on the PATH. Missing folders are made."""
    assignments: Assignments = ()
    """Set another parameter, as vitreous.radius=2 or vitreous.center=4.2,2.3,-1."""
    fps: Annotated[int, arg(metavar="N")] = 20
    """Frames a second, 1 to 60; a GIF has at most 50, and rounds to hundredths of a second a frame."""
    bounce: bool = False
    """Go through the values and back again, so that the animation has no jump where it repeats."""
    label: bool = False
    """Write the name and the value on each frame."""
    edges: Literal["point", "aware"] = "point"
    """What a sample sees. point: one ray, as the course has it; aware: the area around it, edges blended smoothly."""
    transfer: Transfer = "course"
    """Colours in the frames. course: floor(255 * C), no gamma; srgb: what screens expect."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()
