"""Files of a scene for other renderers, with the pictures of its textures beside them."""

from pathlib import Path
from typing import get_args

import numpy as np

from ..errors import SceneError
from ..images.exr import write_exr
from ..scene.scene import Scene
from ..tracer.settings import RenderSettings, resolve_settings
from ..util.files import StrPath, write_text
from . import Format
from .described import describe_scene
from .mitsuba.export import MitsubaWriter
from .mitsuba.plugins import xml_text
from .pov import pov_text


def export_scene(scene: Scene, path: StrPath, to: Format, settings: RenderSettings | None = None) -> tuple[str, ...]:
    """Write a physical scene for another renderer.

    The file's head has the command that renders it. Pictures of textures are written beside it, as OpenEXR.

    Args:
        path: the file to write; missing folders are made.
        to: the program, `pov` or `mitsuba`.
        settings: what is rendered, and how; None is what the scene's file says.

    Returns:
        What the other program cannot be told, or does otherwise, a few words each; the file's head has it too.

    Raises:
        SceneError: the scene is of another model, or `to` is no format.
        RaytraceError: a file cannot be written.
    """
    if to not in get_args(Format):
        raise SceneError(f"there is no format {to!r}; there are {', '.join(get_args(Format))}.")
    path, described = Path(path), describe_scene(scene, resolve_settings(scene, settings))
    if to == "pov":
        text, files, lost = pov_text(described, path.name)
    else:
        writer = MitsubaWriter(described, path.stem)
        plugins, files, lost = writer.plugins(), writer.files, list(dict.fromkeys(writer.lost))
        text = xml_text(plugins, lost, path.name)
    for name, texels in files.items():
        write_exr(path.parent / name, np.asarray(texels, np.float32))
    write_text(path, text)
    return tuple(lost)
