"""Compiling what the next stages of a fit need while this one runs, so that they need not wait for it."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

from raytrace_jax.util.beside import thread_settings


class CompileAhead:
    """A thread beside, for as long as a `with` block lasts, that does one work after the other.

    What is begun when the block ends goes on to its end, unseen; what is not begun is dropped.
    """

    def __init__(self):
        self.thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="compile-ahead")

    def __enter__(self) -> "CompileAhead":
        return self

    def __exit__(self, *error: object) -> None:
        self.thread.shutdown(wait=False, cancel_futures=True)

    def add(self, work: Callable[[], object]) -> None:
        """Do this next. Should it fail, whoever needs its outcome fails at the same place, and tells."""
        settings = thread_settings()

        def run() -> None:
            with settings(), contextlib.suppress(Exception):
                work()

        self.thread.submit(run)
