"""Work in another thread: a compilation cannot be interrupted, but whoever waits for it can be."""

import contextlib
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import ParamSpec, TypeVar

import jax

P = ParamSpec("P")
T = TypeVar("T")


class Clock:
    """The time that some work has, and whether it was asked to stop.

    Args:
        on_stop: called when it is asked to stop.
    """

    def __init__(self, max_seconds: float | None = None, on_stop: Callable[[], None] = lambda: None):
        self.begun, self.max_seconds, self.on_stop = time.monotonic(), max_seconds, on_stop
        self.is_stopped = False

    @property
    def seconds(self) -> float:
        """The seconds since the work began."""
        return time.monotonic() - self.begun

    def stop(self) -> None:
        """Ask the work to stop, where it checks the clock next."""
        self.on_stop()
        self.is_stopped = True

    def check(self) -> None:
        """Raise TimeoutError when the time is up, or the work was asked to stop."""
        if self.is_stopped or (self.max_seconds is not None and self.seconds > self.max_seconds):
            raise TimeoutError


def run_beside(work: Callable[[], T], clock: Clock) -> T:
    """Return what `work()` returns, or raise what it raises; it is left behind should the wait for it end before.

    The wait ends when the clock says so, with TimeoutError, and by Ctrl-C. The work is then asked to stop, and has half
    a second for that.

    Args:
        work: done in another thread, with this one's settings of JAX.
    """
    pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="fit")
    outcome = pool.submit(with_settings(work))
    pool.shutdown(wait=False)
    try:
        while not outcome.done():
            wait([outcome], 0.2)  # On Windows Ctrl-C is noticed only in between.
            if not outcome.done():
                clock.check()
    except BaseException:
        clock.stop()
        with contextlib.suppress(KeyboardInterrupt):  # Who asks twice does not wait.
            wait([outcome], 0.5)
        raise
    return outcome.result()


def with_settings(work: Callable[P, T]) -> Callable[P, T]:
    """Work for another thread with JAX's settings of this one: each thread has its own."""
    names = ("enable_x64", "debug_nans", "default_device", "default_matmul_precision")
    values = {name: getattr(jax.config, f"jax_{name}") for name in names}

    def run(*args: P.args, **options: P.kwargs) -> T:
        with contextlib.ExitStack() as stack:
            for name, value in values.items():
                stack.enter_context(getattr(jax, name)(value))
            return work(*args, **options)

    return run
