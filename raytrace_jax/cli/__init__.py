"""The command line `raytrace-jax COMMAND`; `dispatch` has the table of commands."""

import contextlib
import os
import signal
import sys
import threading
from collections.abc import Sequence

from .._version import __version__


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line and return its exit code.

    None stands for the arguments of this process, which then does not outlive the command, whatever a thread may still
    compile.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if argv is None:
        # What `timeout`, SLURM and Docker send before they kill ends a command as Ctrl-C does: nothing is lost.
        signal.signal(signal.SIGTERM, signal.default_int_handler)
    if "--version" in arguments:
        from ..util.cache_folder import describe_cache

        print(f"raytrace-jax {__version__}", describe_cache(), sep="\n")
        code = 0
    else:
        # Not at the top: whoever asks for the version need not wait for what reads the other arguments.
        from .console import TYPED
        from .dispatch import run

        TYPED.set(tuple(arguments))
        code = run(arguments)
    if argv is None and any(not t.daemon for t in threading.enumerate() if t is not threading.main_thread()):
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(code)
    return code
