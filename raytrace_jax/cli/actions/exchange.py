"""`export` and `import`: scenes for other renderers, and from them."""

from collections.abc import Sequence

from raytrace_jax.cli.console import stderr_console
from raytrace_jax.cli.options.exchange import Export, Import
from raytrace_jax.cli.preparation import read_picture_scene
from raytrace_jax.exchange.export import export_scene
from raytrace_jax.exchange.mitsuba.load import import_scene
from raytrace_jax.scene.writer import save_scene
from raytrace_jax.util.session import jax_session


def run_export(command: Export) -> int:
    """Write the file, say what is lost, and print the path."""
    with jax_session(command.render.precision):
        scene, settings = read_picture_scene(command.scene, command.assignments, command.render)
        lost = export_scene(scene, command.output, command.to, settings)
    _tell(lost, "not in the file, or otherwise there", command.quiet)
    print(command.output)
    return 0


def run_import(command: Import) -> int:
    """Read the file, say what is lost, write the scene and print its path."""
    with jax_session(64):
        scene, lost = import_scene(command.file)
        save_scene(scene, command.output, model="physical")
    _tell(lost, "not in the scene, or otherwise there", command.quiet)
    print(command.output)
    return 0


def _tell(lost: Sequence[str], where: str, quiet: bool) -> None:
    """Say on stderr how much is lost, and what, a line each; `where` begins the sentence."""
    console = stderr_console(quiet=quiet)
    if lost:
        count = "1 thing" if len(lost) == 1 else f"{len(lost)} things"
        console.print(f"{where}, {count}:", *(f"  {words}" for words in lost), sep="\n", markup=False, highlight=False)
