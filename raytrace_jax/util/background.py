"""Work in another thread: a compilation cannot be interrupted, but whoever waits for it can be."""

import contextlib
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar

import jax

T = TypeVar("T")


def run_beside(work: Callable[[], T], check: Callable[[], None], stop: Callable[[], None]) -> T:
    """Return what `work()` returns, or raise what it raises; it is left behind should the wait for it end before.

    Args:
        work: done in another thread, with this one's settings of JAX.
        check: called in this thread now and then; what it raises ends the wait, as Ctrl-C does.
        stop: called when the wait ends before the work: asks it to stop within half a second.
    """
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fit")
    outcome = pool.submit(with_settings(work))
    pool.shutdown(wait=False)
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


def with_settings(work: Callable[[], T]) -> Callable[[], T]:
    """Work for another thread with JAX's settings of this one: each thread has its own."""
    names = ("enable_x64", "debug_nans", "default_device", "default_matmul_precision")
    values = {name: getattr(jax.config, f"jax_{name}") for name in names}

    def run() -> T:
        with contextlib.ExitStack() as stack:
            for name, value in values.items():
                stack.enter_context(getattr(jax, name)(value))
            return work()

    return run
