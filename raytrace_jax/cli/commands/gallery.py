"""The options of `gallery`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional, UseAppendAction, arg

from raytrace_jax.cli.commands.shared import Assignments, RenderOptions, Transfer


@dataclass(frozen=True)
class Gallery:
    """Render the pictures of the source documents: what goes wrong without a part of the model, what each effect adds.

    assignment: the six pictures of the assignment page, from no total internal reflection to the final one with
    Schlick's approximation. checkpoints: reflection, Fresnel and transmission of the additive model, without and with
    each. DIR gets an OpenEXR file and a PNG of each, and gallery.png, one labelled sheet. With --wrt each has its
    edge-aware derivatives, as layers of its file and below it on the sheet.

    Example: raytrace-jax gallery data/vitreous.txt --wrt vitreous.ior --size 320 240 -o gallery
    """

    output: Annotated[Path, arg(aliases=["-o"], metavar="DIR")]
    """The folder for the pictures; it is made if it is missing."""
    scene: Annotated[Positional[Path | None], arg(metavar="SCENE")] = None
    """The scene; without it data/vitreous.txt or, for the checkpoints, data/checkpoints.txt in the current folder."""
    set: Literal["assignment", "checkpoints"] = "assignment"
    """Which pictures."""
    wrt: Annotated[UseAppendAction[tuple[tuple[str, ...], ...]], arg(metavar="NAME ...")] = ()
    """Parameters to differentiate by, as vitreous.ior; `raytrace-jax info SCENE` lists all."""
    assignments: Assignments = ()
    """Set a parameter, as vitreous.ior=1.5 or vitreous.center=4.2,2.3,-1; `raytrace-jax info SCENE` lists the names."""
    png_transfer: Transfer = "course"
    """Colours in the PNGs. course: floor(255 * C), no gamma; srgb: what screens expect."""
    quiet: bool = False
    """Say nothing on the way; errors and warnings are still shown."""
    render: RenderOptions = RenderOptions()
