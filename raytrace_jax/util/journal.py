"""The stages of a fit that are done, kept in a file, so that a fit goes on after an interrupt or a kill."""

import contextlib
import hashlib
import json
import warnings
from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any, Literal

import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.files import read_bytes, write_text

Resume = Literal["always", "unfinished", "never"]


class FileJournal(MutableMapping[str, Any]):
    """A mapping of JSON values that is written, whole, at every change.

    A file that cannot be written must not end a fit: there is a warning then, and the stage is not kept.

    Args:
        path: the file.
        belongs_to: what the fit is made of, by the names that a user knows; see `identity`.
        resume: whether to start from what the file holds: `always`, `never`, or `unfinished`, if that fit has no end.

    Attributes:
        goes_on: whether it started from what the file held.

    Raises:
        RaytraceError: the file cannot be read, is broken, or what it holds and would be gone on with is another fit's.

    Warns:
        UserWarning: the file cannot be written.
    """

    def __init__(self, path: Path, belongs_to: Mapping[str, str], *, resume: Resume):
        self.path, self.belongs_to = path, dict(belongs_to)
        self.stages: dict[str, Any] = {}
        self.is_finished = False
        self.goes_on = False
        self.has_warned = False
        if resume != "never" and path.exists():
            kept = self._read()
            if resume == "always" or not kept.get("finished", False):
                self.stages = self._own(kept)
                self.goes_on = len(self.stages) > 0

    def __getitem__(self, name: str) -> Any:
        return self.stages[name]

    def __setitem__(self, name: str, stage: Any) -> None:
        self.stages[name] = stage
        try:
            self._write()
        except RaytraceError as reason:
            del self.stages[name]
            self._warn(reason)

    def __delitem__(self, name: str) -> None:
        del self.stages[name]
        self._write()

    def __iter__(self) -> Iterator[str]:
        return iter(self.stages)

    def __len__(self) -> int:
        return len(self.stages)

    def finish(self) -> None:
        """Note that the fit has come to its end: another one may take the file's place."""
        self.is_finished = True
        if self.stages:
            with contextlib.suppress(RaytraceError):  # Who begins another fit here is asked once more, no harm is done.
                self._write()

    def _warn(self, reason: RaytraceError) -> None:
        if not self.has_warned:
            warnings.warn(f"{reason}; should the fit be interrupted, it cannot go on from here.", stacklevel=3)
        self.has_warned = True

    def _write(self) -> None:
        # NaN is allowed here, unlike in the results: only Python reads it.
        text = json.dumps({"belongs_to": self.belongs_to, "finished": self.is_finished, "stages": self.stages})
        write_text(self.path, text + "\n")

    def _read(self) -> dict[str, Any]:
        """What the file holds."""
        try:
            kept = json.loads(read_bytes(self.path))
            return {**kept, "belongs_to": dict(kept["belongs_to"]), "stages": dict(kept["stages"])}
        except (ValueError, KeyError, TypeError) as cause:
            raise RaytraceError(f"{self.path}: is broken; --restart begins the fit anew.") from cause

    def _own(self, kept: dict[str, Any]) -> dict[str, Any]:
        """The stages that it holds, if they are this fit's."""
        owner = kept["belongs_to"]
        different = [name for name in {**owner, **self.belongs_to} if owner.get(name) != self.belongs_to.get(name)]
        if different:
            raise RaytraceError(
                f"{self.path}: belongs to a fit with another {' and '.join(different)}; "
                "go on with its own arguments, write elsewhere, or begin anew with --restart."
            )
        return kept["stages"]


def identity(parts: Mapping[str, object]) -> dict[str, str]:
    """A fingerprint of each part of a fit, and of this version: arrays by their numbers, the rest by its text."""

    def fingerprint(part: object) -> str:
        data = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        return hashlib.sha256(data).hexdigest()[:16]

    return {**{name: fingerprint(part) for name, part in parts.items()}, "version": __version__}
