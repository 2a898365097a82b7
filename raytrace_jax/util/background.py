"""Work in another thread: a compilation cannot be interrupted, but whoever waits for it can be."""

import contextlib
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import TypeVar

import jax

T = TypeVar("T")


def run_beside(work: Callable[[], T], check: Callable[[], None], stop: Callable[[], None]) -> T:
    """Return what `work()` returns, or raise what it raises; it is left behind should the wait for it end before.

    Args:
        work: what is done in another thread, with this one's settings of JAX.
        check: called in this thread now and then; what it raises ends the wait, as Ctrl-C does.
        stop: called once when the wait ends before the work: asks it to stop. It has half a second to do so.
    """
    settings, outcome = thread_settings(), Future[T]()

    def run() -> None:
        try:
            with settings():
                outcome.set_result(work())
        except BaseException as error:  # Ctrl-C is an exception too, where a callback raises it.
            outcome.set_exception(error)

    threading.Thread(target=run, name="fit").start()
    try:
        while not outcome.done():
            wait([outcome], 0.2)  # On Windows Ctrl-C is noticed only in between.
            if not outcome.done():
                check()
    except BaseException:
        stop()
        with contextlib.suppress(KeyboardInterrupt):  # Who asks twice does not wait.
            wait([outcome], 0.5)
        raise
    return outcome.result()


class CompileAhead:
    """A one-worker executor that compiles ahead of need, for as long as a `with` block lasts.

    What is begun when the block ends goes on to its end, unseen; what is not begun is dropped.
    """

    def __init__(self):
        self.thread = ThreadPoolExecutor(max_workers=1, thread_name_prefix="compile-ahead")

    def __enter__(self) -> "CompileAhead":
        return self

    def __exit__(self, *error: object) -> None:
        self.thread.shutdown(wait=False, cancel_futures=True)

    def add(self, work: Callable[[], object]) -> None:
        """Do this next. Errors are dropped here; the caller compiles again and meets the same error."""
        settings = thread_settings()

        def run() -> None:
            with settings(), contextlib.suppress(Exception):
                work()

        self.thread.submit(run)


def thread_settings() -> Callable[[], contextlib.ExitStack]:
    """JAX's settings in this thread, as a context for another: each thread has its own."""
    names = ("enable_x64", "debug_nans", "default_device", "default_matmul_precision")
    values = {name: getattr(jax.config, f"jax_{name}") for name in names}

    def entered() -> contextlib.ExitStack:
        stack = contextlib.ExitStack()
        for name, value in values.items():
            stack.enter_context(getattr(jax, name)(value))
        return stack

    return entered
