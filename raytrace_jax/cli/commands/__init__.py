"""The commands and their options as typed dataclasses: tyro makes the parser and the help texts of them.

Nothing here imports JAX, so that `--help` answers at once.
"""

from typing import NamedTuple

from raytrace_jax.cli.commands.batch import Batch
from raytrace_jax.cli.commands.fit import Fit
from raytrace_jax.cli.commands.gallery import Gallery
from raytrace_jax.cli.commands.grad import Grad
from raytrace_jax.cli.commands.inspect import Format, Info
from raytrace_jax.cli.commands.rays import Rays
from raytrace_jax.cli.commands.render import Render
from raytrace_jax.cli.commands.sweep import Sweep
from raytrace_jax.cli.commands.teach import Teach


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
    "teach": Entry(Teach, "teach", "run_teach"),
    "format": Entry(Format, "inspect", "run_format"),
    "info": Entry(Info, "inspect", "run_info"),
}
"""By the names that users type, in the order of the help text."""
