"""OpenEXR files of a render and of its derivatives, which say with their channels how they were made."""

import dataclasses
from os import PathLike
from pathlib import Path

import numpy as np

from .._version import __version__
from ..images import Transfer
from ..images.exr import write_exr
from ..scene.scene import Scene
from ..scene.writer import format_scene
from ..tracer.film import Film
from ..tracer.rendering import PictureDerivatives
from ..tracer.settings import RenderSettings, ResolvedSettings, resolve_settings
from ..util.checked import refuse_other
from ..util.files import strict
from .differences import Differences


def write_film(
    path: str | PathLike[str], film: Film, scene: Scene, settings: RenderSettings | None = None, *, half: bool = False
) -> None:
    """Write a film as OpenEXR: R, G, B, the channels of its AOVs, and how it was made, so that it can be made again.

    Args:
        path: missing folders are made, and the file appears only when it is whole.
        film: what `render` returned for this scene and these settings.
        scene: is written into the file's metadata as a `model.txt` text.
        settings: are written by their names; None is what the scene's file says.
        half: store 16-bit floats (largest value 65504) in place of 32-bit ones.

    Raises:
        PictureError: a channel holds NaN or infinity, or what a half cannot hold; the file cannot be written.
    """
    refuse_other(film, Film, "render")
    settings = resolve_settings(scene, settings)
    write_exr(path, film.channels(), metadata=how_made(scene, settings), half=half)


def write_derivatives(
    path: str | PathLike[str],
    found: PictureDerivatives,
    scene: Scene,
    settings: RenderSettings | None = None,
    differences: Differences | None = None,
) -> None:
    """Write OpenEXR: the picture in R, G, B, each derivative in a signed layer `d.<parameter>`, and how they were made.

    Finite differences of the same parameters are layers `difference.<parameter>`.

    Args:
        found: what `picture_derivatives` returned for this scene and these settings.
        differences: what `steady_differences` returned for these parameters; its steps and samples are written too.

    Raises:
        PictureError: a channel holds NaN or infinity; the file cannot be written.
    """
    refuse_other(found, PictureDerivatives, "picture_derivatives")
    settings = resolve_settings(scene, settings)
    channels = dict(zip("RGB", np.asarray(found.image), strict=True))
    layers = {f"d.{name}": values for name, values in zip(found.names, np.asarray(found.values), strict=True)}
    metadata = how_made(scene, settings)
    if differences is not None:
        layers |= {f"difference.{name}": values for name, values in zip(found.names, differences.values, strict=True)}
        steps = dict(zip(found.names, differences.steps, strict=True))
        metadata["differences"] = {"samples": differences.samples, "steps": steps}
    for name, values in layers.items():
        channels |= {f"{name}.{letter}": plane for letter, plane in zip("RGB", values, strict=True)}
    write_exr(path, channels, metadata=metadata)


def view_paths(path: Path, scene: Scene) -> dict[str, Path]:
    """The file of each camera's picture: `path` of the only one, of several `picture_left.exr` and so on."""
    if not scene.further_views:
        return {scene.camera.name: path}
    # A file's name has no slash.
    return {name: path.with_stem(f"{path.stem}_{name.replace('/', '%2F')}") for name in scene.cameras}


def screen_transfer(settings: ResolvedSettings) -> Transfer:
    """The transfer of a PNG of a picture: the course's for the course's models, else what screens expect."""
    return "srgb" if settings.model == "physical" else "course"


def how_made(scene: Scene | str, settings: ResolvedSettings) -> dict[str, object]:
    """The metadata of a picture's file: all that it takes to make it again; a scene may be its file's text."""
    return {
        "scene": scene if isinstance(scene, str) else format_scene(scene, model=settings.model),
        "settings": strict(dataclasses.asdict(settings.with_edges("point"))),
        "version": __version__,
    }
