"""Methods of a lower floor's objects that do what a higher floor does: `scene.save` writes what `modelfile` formats."""

import importlib
from typing import Any

PACKAGE = __name__.partition(".")[0]


def above(module: str) -> Any:
    """A module of this package that lies higher than the caller, imported when a method of the caller's is called.

    Functions are at home where they belong, and nothing imports upwards; an object only offers what users look for.

    Args:
        module: its name within the package, as `scene.modelfile`.
    """
    return importlib.import_module(f"{PACKAGE}.{module}")
