"""A scene as a file that any program of ours can read, with the pictures of its textures beside it."""

import dataclasses
import os
from pathlib import Path

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images.exr import write_exr
from raytrace_jax.images.pictures import read_picture
from raytrace_jax.scene.modelfile import format_scene
from raytrace_jax.scene.scene import Images, Scene
from raytrace_jax.scene.setting_words import ModelName
from raytrace_jax.util.files import write_text


def save_scene(
    scene: Scene, path: str | os.PathLike[str], *, model: ModelName | None = None, comments: str = ""
) -> str:
    """Write a scene's file, each file whole or not at all, and return its text.

    A texture whose file does not lie where the new scene's file would look for it is written beside that file, as
    `SCENE.TEXTURE.exr` in 32-bit floats; so is one that came as numbers.

    Args:
        scene: what to write.
        path: the scene's file; missing folders are made.
        model, comments: see `format_scene`.

    Raises:
        ModelFileError: the scene holds what no file can say.
        RaytraceError: a file cannot be written.
    """
    path = Path(path)
    moved = [k for k in range(len(scene.images.names)) if not _is_found(scene.images, k, path.parent)]
    files = {k: f"{path.stem}.{scene.images.names[k]}.exr" for k in moved}
    text = format_scene(_with_files(scene, files), model=model, comments=comments)
    for k, name in files.items():
        write_exr(path.parent / name, np.asarray(scene.images.texels[k]))
    write_text(path, text)
    return text


def _is_found(images: Images, k: int, folder: Path) -> bool:
    """Whether the file of a texture, as the scene has it, is in a folder, with the same picture."""
    if not images.file[k] or not (folder / images.file[k]).is_file():
        return False
    try:
        stored = read_picture(folder / images.file[k], transfer=images.transfer[k])
    except PictureError:
        return False
    return np.array_equal(stored.astype(images.texels[k].dtype), np.asarray(images.texels[k]))


def _with_files(scene: Scene, files: dict[int, str]) -> Scene:
    """The scene with other names of the files of some textures, which are EXR."""
    if not files:
        return scene
    images = scene.images
    file, transfer = (
        tuple(new(k) if k in files else old for k, old in enumerate(values))
        for values, new in ((images.file, files.get), (images.transfer, lambda _: None))
    )
    return dataclasses.replace(scene, images=dataclasses.replace(images, file=file, transfer=transfer))
