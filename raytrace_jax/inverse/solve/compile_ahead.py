"""Compiling what the next stages of a fit need while this one runs, so that they need not wait for it."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from raytrace_jax.util.beside import thread_settings

THREADS = 2
"""One traces, which is Python's work, while XLA compiles for the other."""


class CompileAhead:
    """Threads beside, for as long as a `with` block lasts, that begin one work after the other.

    What is begun when the block ends goes on to its end, unseen; what is not begun is dropped.
    """

    def __init__(self):
        self.threads = ThreadPoolExecutor(max_workers=THREADS, thread_name_prefix="compile-ahead")

    def __enter__(self) -> "CompileAhead":
        return self

    def __exit__(self, *error: object) -> None:
        self.threads.shutdown(wait=False, cancel_futures=True)

    def add(self, *works: Callable[[], object]) -> None:
        """Do these next. Should one fail, whoever needs its outcome fails at the same place, and tells."""
        settings = thread_settings()

        def run(work: Callable[[], object]) -> None:
            with settings(), contextlib.suppress(Exception):
                work()

        for work in works:
            self.threads.submit(run, work)
