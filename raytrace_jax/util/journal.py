"""The stages of a fit that are done, kept in a file, so that a fit goes on after an interrupt or a kill."""

import hashlib
import json
from collections.abc import Iterator, Mapping, MutableMapping
from pathlib import Path
from typing import Any

import numpy as np

from raytrace_jax._version import __version__
from raytrace_jax.errors import RaytraceError
from raytrace_jax.util.files import read_bytes, write_text


class FileJournal(MutableMapping[str, Any]):
    """A mapping of JSON values that is written, whole, at every change.

    Args:
        path: the file.
        belongs_to: what the fit is made of, by the names that a user knows; see `identity`.
        resume: whether to start from what the file holds; else it is started anew.

    Raises:
        RaytraceError: the file cannot be read or written, is broken, or belongs to another fit.
    """

    def __init__(self, path: Path, belongs_to: Mapping[str, str], *, resume: bool):
        self.path, self.belongs_to = path, dict(belongs_to)
        self.stages: dict[str, Any] = {}
        if resume and path.exists():
            self.stages = self._read()

    def __getitem__(self, name: str) -> Any:
        return self.stages[name]

    def __setitem__(self, name: str, stage: Any) -> None:
        self.stages[name] = stage
        self._write()

    def __delitem__(self, name: str) -> None:
        del self.stages[name]
        self._write()

    def __iter__(self) -> Iterator[str]:
        return iter(self.stages)

    def __len__(self) -> int:
        return len(self.stages)

    def _write(self) -> None:
        # NaN is allowed here, unlike in the results: only Python reads it.
        text = json.dumps({"belongs_to": self.belongs_to, "stages": self.stages})
        write_text(self.path, text + "\n")

    def _read(self) -> dict[str, Any]:
        try:
            kept = json.loads(read_bytes(self.path))
            owner, stages = dict(kept["belongs_to"]), dict(kept["stages"])
        except (ValueError, KeyError, TypeError) as cause:
            raise RaytraceError(f"{self.path}: is broken; without --resume the fit starts anew.") from cause
        different = [name for name in {**owner, **self.belongs_to} if owner.get(name) != self.belongs_to.get(name)]
        if different:
            raise RaytraceError(
                f"{self.path}: belongs to a fit with another {' and '.join(different)}; "
                "resume with the same arguments, or start anew without --resume."
            )
        return stages


def identity(parts: Mapping[str, object]) -> dict[str, str]:
    """A fingerprint of each part of a fit, and of this version: arrays by their numbers, the rest by its text."""

    def fingerprint(part: object) -> str:
        data = part.tobytes() if isinstance(part, np.ndarray) else repr(part).encode()
        return hashlib.sha256(data).hexdigest()[:16]

    return {**{name: fingerprint(part) for name, part in parts.items()}, "version": __version__}
