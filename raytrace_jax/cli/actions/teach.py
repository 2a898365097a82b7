"""`teach`: the figures of the lessons, and the page that explains them."""

import contextlib

from raytrace_jax.cli.console import stderr_console
from raytrace_jax.cli.options.explanations import Teach
from raytrace_jax.cli.preparation import check_folder
from raytrace_jax.cli.progress import Timer
from raytrace_jax.report.lessons import LESSONS, index_page
from raytrace_jax.util.files import atomic_write, write_text
from raytrace_jax.util.session import jax_session


def run_teach(command: Teach) -> int:
    """Draw the lessons' figures, write them and their page, and print the paths."""
    wanted = set(command.only) or set(LESSONS)
    names = tuple(name for name in LESSONS if name in wanted)
    check_folder(command.output)
    timer = Timer("drawing", stderr_console(quiet=command.quiet))
    # A display on stderr would catch what is printed on stdout.
    with contextlib.nullcontext() if timer.display else timer, jax_session(64):
        for number, name in enumerate(names, start=1):
            figure = LESSONS[name].draw()
            for suffix in ("png", *command.also):
                path = command.output / f"{name}.{suffix}"
                with atomic_write(path) as temporary:
                    figure.savefig(temporary)
                print(path, flush=True)
            timer.took(f"figure {number}/{len(names)}, {name},")
    page = command.output / "index.md"
    write_text(page, index_page(names))
    print(page)
    return 0
