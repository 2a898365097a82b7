"""From a file, or its text, to a `Scene`."""

import os
from pathlib import Path

from jax.typing import DTypeLike

from raytrace_jax.errors import ModelFileError
from raytrace_jax.scene.assembly import assemble
from raytrace_jax.scene.bundled import no_such_scene, scene_path
from raytrace_jax.scene.modelfile.grammar import read_blocks
from raytrace_jax.scene.modelfile.tokens import Token, TokenStream
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.scene.values import floating


def parse_scene(
    text: str,
    *,
    source: str = "<string>",
    dtype: DTypeLike | None = None,
    model: ModelName | None = None,
    folder: str | os.PathLike[str] = ".",
) -> Scene:
    """Read a scene from the text of a `model.txt`.

    Args:
        text: the file's text; white space and line breaks only separate tokens.
        source: the file's name for error messages.
        dtype: floating dtype of the scene's arrays; None means JAX's default.
        model: the shading model with which the scene is rendered; its defaults fill in what the file leaves out. None
            is the model of the file's settings, else `classic`.
        folder: where the paths of its textures begin.

    Returns:
        The scene; lights, materials and shapes keep the order of the file.

    Raises:
        ModelFileError: the text is not a scene; the message says where, what came and what is valid.
        TypeError: `dtype` is not a floating type.
    """
    float_dtype = floating(dtype)
    text = text.removeprefix("\ufeff")  # the byte order mark that some editors write
    tokens = TokenStream(text, source)
    if "\0" in text:
        raise tokens.error(Token("\0", text.index("\0")), "a NUL byte: this is a binary file, not a model.txt.")
    if not tokens.current.text:
        raise tokens.error(tokens.current, "the file is empty: a scene has at least a camera block.")

    # A generator: the first error in the order of the file is raised, be it within a block or between two.
    blocks = read_blocks(tokens, float_dtype, model, Path(folder))
    return assemble(blocks, float_dtype, model, lambda message: tokens.error(tokens.current, message))


LARGEST_FILE = 64 * 2**20
"""Bytes of a file at most, so that a picture or an endless device given by mistake fails at once."""


def load_scene(
    path: str | os.PathLike[str], *, dtype: DTypeLike | None = None, model: ModelName | None = None
) -> Scene:
    """Read the scene in a `model.txt` file (UTF-8, with or without a byte order mark).

    Args:
        path: the file, or where there is none the name of a scene that comes with the package, as `glass_on_board`.
        dtype: floating dtype of the scene's arrays; None means JAX's default.
        model: the shading model with which the scene is rendered; its defaults fill in what the file leaves out. None
            is the model of the file's settings, else `classic`.

    Returns:
        The scene, as `parse_scene`.

    Raises:
        ModelFileError: the file cannot be read or is not a scene, as `parse_scene`.
    """
    path = scene_path(path)
    content = _read_bytes(path)
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        column = error.start - content.rfind(b"\n", 0, error.start)
        raise ModelFileError(
            f"{path}:{line}:{column}: byte 0x{content[error.start]:02x} is not UTF-8: a model.txt is plain text."
        ) from None
    return parse_scene(text, source=str(path), dtype=dtype, model=model, folder=Path(path).parent)


def _read_bytes(path: str | os.PathLike[str]) -> bytes:
    try:
        with Path(path).open("rb") as file:
            content = file.read(LARGEST_FILE + 1)
    except FileNotFoundError:
        raise ModelFileError(no_such_scene(path)) from None
    except IsADirectoryError:
        raise ModelFileError(f"{path}: this is a directory, a model.txt file is wanted.") from None
    except (OSError, ValueError) as error:  # ValueError: a path with a NUL character
        raise ModelFileError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or error}.") from None
    if len(content) > LARGEST_FILE:
        raise ModelFileError(f"{path}: larger than {LARGEST_FILE // 2**20} MiB, this is not a model.txt.")
    return content
