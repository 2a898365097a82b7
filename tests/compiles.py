"""Counting what XLA compiles and what JAX traces."""

import contextlib
import threading

import jax

from raytrace_jax.util.compilation import EXPORTED


@contextlib.contextmanager
def counted_compiles(event="backend_compile_duration", thread=None):
    """Yield a list that grows by the name of each program that is compiled while the block runs, by that thread only.

    A fit of another test may still compile in a thread of its own.
    """
    compiles = []

    def listen(name, _, *, fun_name="", **__):
        if name == f"/jax/core/compile/{event}" and thread in (None, threading.current_thread()):
            compiles.append(fun_name.replace(f"{EXPORTED})", ")"))

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield compiles
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def counted_traces():
    """Yield a list that grows by the name of each jitted function that is traced while the block runs."""
    return counted_compiles("jaxpr_trace_duration")
