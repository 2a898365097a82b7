"""`teach`: the figures of the lessons, and the page that explains them."""

import time

from raytrace_jax.cli.commands.teach import Teach
from raytrace_jax.cli.console import stderr_console
from raytrace_jax.cli.output import check_folder
from raytrace_jax.report.lessons import LESSONS, index_page
from raytrace_jax.util.files import atomic_write
from raytrace_jax.util.session import jax_session


def run_teach(command: Teach) -> int:
    """Draw the lessons' figures, write them and their page, and print the paths."""
    wanted = {name for names in command.only for name in names} or set(LESSONS)
    names = tuple(name for name in LESSONS if name in wanted)
    check_folder(command.output)
    console = stderr_console()
    console.quiet = command.quiet
    with jax_session(64):
        for number, name in enumerate(names, start=1):
            start = time.perf_counter()
            figure = LESSONS[name].draw()
            path = command.output / f"{name}.png"
            with atomic_write(path) as temporary:
                figure.savefig(temporary)
            print(path, flush=True)
            console.print(f"figure {number}/{len(names)}, {name}, took {time.perf_counter() - start:.1f} s")
    page = command.output / "index.md"
    with atomic_write(page) as temporary:
        temporary.write_text(index_page(names), encoding="utf-8")
    print(page)
    return 0
