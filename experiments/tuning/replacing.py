"""Other values for the package's tuning numbers, in every module that has them."""

import contextlib
import sys
from collections.abc import Iterator, Mapping


@contextlib.contextmanager
def replaced(values: Mapping[str, object]) -> Iterator[None]:
    """Give numbers other values for a while.

    Args:
        values: by `module:NAME`, the module without `raytrace_jax.`.
    """
    undo = []
    try:
        for address, value in values.items():
            module, name = address.split(":")
            usual = getattr(sys.modules[f"raytrace_jax.{module}"], name)
            # Also where it was imported by name: such a module has the very same object.
            for place in [m for key, m in sys.modules.items() if key.startswith("raytrace_jax")]:
                if place.__dict__.get(name) is usual:
                    undo.append((place, name, usual))
                    setattr(place, name, value)
        yield
    finally:
        for place, name, usual in undo:
            setattr(place, name, usual)
