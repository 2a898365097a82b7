"""Compiling what the next stages of a fit need while this one runs, so that they need not wait for it."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import jax


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
        is_double = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]

        def run() -> None:
            # The precision is each thread's own.
            with jax.enable_x64(is_double), contextlib.suppress(Exception):
                work()

        self.thread.submit(run)
