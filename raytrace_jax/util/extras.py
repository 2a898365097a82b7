"""What the package's extras install, for messages: its name is on no package index."""

import contextlib
import importlib.metadata
import shlex


def install(extra: str) -> str:
    """The command that installs what an extra needs, wherever this package came from: a checkout or a wheel."""
    needed: list[str] = []
    with contextlib.suppress(importlib.metadata.PackageNotFoundError):  # A checkout on the path that is not installed.
        rows = (row.replace('"', "'").partition(";") for row in importlib.metadata.requires("raytrace-ior") or ())
        needed = [package.strip() for package, _, when in rows if when.split()[-1:] == [repr(extra)]]
    return shlex.join(["pip", "install", *needed]) if needed else f"pip install '.[{extra}]' in the checkout"
