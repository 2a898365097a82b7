"""From a file's text to a `Scene`."""

import os
from pathlib import Path

from jax.typing import DTypeLike

from raytrace_jax.scene.assembly import assemble
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
        model: the one as which the scene is loaded and rendered, and whose defaults hold for what the file leaves
            out; None is that of its settings, or `classic`.
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
