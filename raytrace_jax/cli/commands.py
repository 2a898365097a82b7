"""The table of commands: for each its options, and the action that takes them.

Options lie in `cli.options` and do not import JAX, so that `--help` answers at once. Actions lie in `cli.actions`, one
module a command; only that of the command in hand is imported.
"""

from typing import NamedTuple

from raytrace_jax.cli.options.exchange import Export, Import
from raytrace_jax.cli.options.explanations import Format, Info, New, Rays, Scenes, Teach, View
from raytrace_jax.cli.options.fits import Batch, Fit
from raytrace_jax.cli.options.photo import Board, Calibrate, Photo
from raytrace_jax.cli.options.pictures import Gallery, Grad, Render, Sweep


class Entry(NamedTuple):
    """A command's options, and the function of a module of `cli.actions` that takes them and returns an exit code."""

    options: type
    module: str
    function: str


COMMANDS = {
    "render": Entry(Render, "render", "run_render"),
    "grad": Entry(Grad, "grad", "run_grad"),
    "fit": Entry(Fit, "fit", "run_fit"),
    "gallery": Entry(Gallery, "gallery", "run_gallery"),
    "rays": Entry(Rays, "rays", "run_rays"),
    "sweep": Entry(Sweep, "sweep", "run_sweep"),
    "batch": Entry(Batch, "batch", "run_batch"),
    "view": Entry(View, "view", "run_view"),
    "board": Entry(Board, "board", "run_board"),
    "calibrate": Entry(Calibrate, "photo", "run_calibrate"),
    "photo": Entry(Photo, "photo", "run_photo"),
    "teach": Entry(Teach, "teach", "run_teach"),
    "export": Entry(Export, "exchange", "run_export"),
    "import": Entry(Import, "exchange", "run_import"),
    "new": Entry(New, "inspect", "run_new"),
    "format": Entry(Format, "inspect", "run_format"),
    "info": Entry(Info, "inspect", "run_info"),
    "scenes": Entry(Scenes, "inspect", "run_scenes"),
}
"""Commands by the names that users type, in the order of the help text."""
