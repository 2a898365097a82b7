"""The command line: `raytrace-jax COMMAND`; `commands` has the table of them."""

import sys
from collections.abc import Sequence

from raytrace_jax._version import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code; `argv` is without the program's name (None: `sys.argv`)."""
    arguments = list(sys.argv[1:] if argv is None else argv)
    if "--version" in arguments:
        print(f"raytrace-jax {__version__}")
        return 0
    # Not at the top: whoever asks for the version need not wait for what reads the other arguments.
    from raytrace_jax.cli.dispatch import run

    return run(arguments)
