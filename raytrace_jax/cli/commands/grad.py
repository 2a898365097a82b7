"""The options of `grad`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from raytrace_jax.cli.commands.shared import Assignments, RenderOptions, SceneFile


@dataclass(frozen=True)
class Grad:
    """Differentiate the picture of a scene with respect to parameters.

    OUT.exr gets the picture (R G B) and for each number a signed layer, as d.vitreous.ior.R/G/B or
    d.vitreous.center.x.R/G/B. OUT.png beside it shows them on one sheet, the mean over R, G and B. The paths of both
    are printed.

    Example: raytrace-jax grad vitreous.txt --wrt vitreous.ior vitreous.center -o derivatives.exr --check
    """

    scene: SceneFile
    """The scene, a model.txt file."""
    wrt: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")]
    """The parameters (required), as vitreous.ior or vitreous.center; `raytrace-jax info SCENE` lists all."""
    output: Annotated[Path, arg(aliases=["-o"], metavar="OUT.exr")]
    """The OpenEXR file to write, with OUT.png beside it. Missing folders are made."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    edges: Literal["aware", "point"] = "aware"
    """aware: derivatives see silhouettes and refracted edges move; point: they do not.
    Derivatives that miss edges are faster and of little use."""
    check: bool = False
    """Compare with finite differences of supersampled pictures: a second row on the sheet, and a table on stdout."""
    check_samples: Annotated[int, arg(metavar="N")] = 16
    """The pictures for --check, two for each number, have N x N rays a pixel. 1 to 64."""
    check_step: Annotated[float, arg(metavar="X")] = 0.006
    """How far --check moves a parameter to either side, in its own unit; less where its limits are near."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()
