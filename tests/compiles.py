"""Counting what XLA compiles."""

import contextlib
import re

import jax

WHERE_IT_IS_KEPT = re.compile("_[0-9a-f]{16}(?=\\)?$)")
"""What follows a program's name where it is kept for the next process."""


@contextlib.contextmanager
def counted_compiles():
    """Yield a list that grows by the name of each program that is compiled while the block runs."""
    compiles = []

    def listen(event, _, *, fun_name="", **__):
        if event == "/jax/core/compile/backend_compile_duration":
            compiles.append(WHERE_IT_IS_KEPT.sub("", fun_name))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield compiles
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)
