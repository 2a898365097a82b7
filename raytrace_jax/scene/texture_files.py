"""The pictures of textures: read from files beside the scene's, or given as numbers."""

import hashlib
import os
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from raytrace_jax.errors import PictureError
from raytrace_jax.images.pictures import read_picture, states_colours
from raytrace_jax.scene.description import Description
from raytrace_jax.scene.scene import Scene
from raytrace_jax.scene.schema import Attribute
from raytrace_jax.scene.values import is_traced
from raytrace_jax.util.text import quoted, sentence


def file_name(value: Any) -> str:
    """The name of a texture's file as it is written; empty for numbers."""
    return os.fspath(value) if isinstance(value, str | os.PathLike) else ""


def read_texels(block: Description, attribute: Attribute, dtype: np.dtype) -> Float[Array, "3 height width"]:
    """The picture of a texture, scene-linear.

    Args:
        block: the texture, complete: its file's name, relative to `Origin.folder`, or from Python an array.
        attribute: which of its values that is.
        dtype: of the scene's numbers.

    Raises:
        RaytraceError: of the block's origin: a file that is missing, broken or does not say how its numbers were made;
            an absolute path in a scene's file; an array that is no picture.
    """

    def refuse(what: object) -> Exception:
        return block.origin.error(attribute.name, sentence(f"in {block}, {what}"))

    value = block.values[attribute.name]
    if not isinstance(value, str | os.PathLike):
        return _as_picture(value, dtype, refuse)
    path = Path(value)
    if path.is_absolute() and block.origin.wants_relative_paths:
        raise refuse(f"{quoted(str(path))} is an absolute path: a texture's is relative to the scene file")
    found = block.origin.folder / path
    try:
        transfer = block.values["transfer"]
        if transfer is None and not states_colours(found):
            how = "does not say how its numbers were made: add transfer srgb or course"
            raise refuse(f"the picture {quoted(str(value))} {how}")
        return jnp.asarray(read_picture(found, transfer=transfer), dtype)
    except PictureError as reason:
        raise refuse(f"the texture cannot be read: {reason}") from None


def fingerprint(scene: Scene) -> str:
    """16 hexadecimal digits that tell the pictures of a scene's textures from others; empty where it has none."""
    found = hashlib.sha256()
    for texels in scene.images.texels:
        found.update(repr(texels.shape).encode() + np.asarray(texels).tobytes())
    return found.hexdigest()[:16] if scene.images.names else ""


def _as_picture(value: Any, dtype: np.dtype, refuse: Any) -> Float[Array, "3 height width"]:
    """Numbers from Python as a picture."""
    shape = np.shape(value)
    if len(shape) != 3 or shape[0] != 3 or 0 in shape:
        raise refuse(f"file takes a path or an array of shape (3, height, width), got one of shape {shape}")
    picture = jnp.asarray(value, dtype)
    if not is_traced(value) and not bool(jnp.all(jnp.isfinite(picture))):
        raise refuse("file has an array with numbers that are not finite")
    return picture
