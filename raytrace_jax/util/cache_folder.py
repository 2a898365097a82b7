"""The folder of compiled programs, and what is in it, without JAX: `--version` answers at once."""

import os
import sys
from pathlib import Path


def cache_folder() -> Path:
    """The folder for compiled programs: `raytrace-jax` in the user's cache folder, by the platform's custom."""
    usual = "~/Library/Caches" if sys.platform == "darwin" else "~/.cache"
    base = os.environ.get("XDG_CACHE_HOME") or os.environ.get("LOCALAPPDATA") or usual
    return Path(base).expanduser() / "raytrace-jax"


def program_files(folder: Path) -> list[Path]:
    """The files of programs: of what was traced, which are ours, and of what XLA made of it, which are JAX's."""
    return [*folder.glob("programs/*/*"), *folder.glob("jit_*-cache")]


def describe_cache() -> str:
    """Where the command line keeps compiled programs, how many are there, and whether more can be kept.

    It does not say whether JAX takes them: on some processors it compiles each anew (docs/limits.md), which only a
    second process that uses one can tell.
    """
    chosen = os.environ.get("JAX_COMPILATION_CACHE_DIR")
    folder = Path(chosen) if chosen else cache_folder()
    sizes = []
    for file in program_files(folder):
        try:
            sizes.append(file.stat().st_size)
        except OSError:  # Another process has removed it.
            continue
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    if not (there.is_dir() and os.access(there, os.W_OK | os.X_OK)):
        state = "it cannot be written, so that every start compiles anew"
    elif not sizes:
        state = "empty"
    else:
        state = f"{len(sizes)} files, {sum(sizes) / 1e6:.0f} MB"
    return f"compiled programs: {folder} ({state})"
