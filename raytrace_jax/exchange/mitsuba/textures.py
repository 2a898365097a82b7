"""Mitsuba's textures and environments as pictures and boards of ours."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from raytrace_jax.errors import PictureError, SceneError
from raytrace_jax.exchange.mitsuba.plugins import UPSIDE_DOWN, Color, Plugin, transform_of
from raytrace_jax.exchange.textures import Texture
from raytrace_jax.images.pictures import read_picture

CLOSE = 1e-5
"""Rows that are the mean of their neighbours but for this share lie between rows of ours."""


def read_texture(plugin: Plugin, path: Path, halves: np.ndarray, lost: list[str]) -> Texture | None:
    """A texture on a rectangle whose sides are twice `halves`; None where it is of a kind that we have not.

    Raises:
        SceneError: its picture cannot be read.
    """
    to_uv = transform_of(plugin, "to_uv")
    if plugin.kind == "checkerboard":
        return _checkerboard(plugin, to_uv, halves, lost)
    if plugin.kind != "bitmap":
        lost.append(f"a texture of type {plugin.kind}")
        return None
    texels = _picture(plugin, path)
    if not np.allclose(to_uv, UPSIDE_DOWN):
        texels = texels[:, ::-1]
        if not np.allclose(to_uv, np.eye(4)):
            lost.append("a bitmap with a to_uv; it lies on the whole rectangle")
    wrap = str(plugin.values.get("wrap_mode", "repeat"))
    if wrap == "mirror":
        lost.append("a bitmap that is mirrored beyond its border; its border goes on")
    smooth = str(plugin.values.get("filter_type", "bilinear"))
    return Texture(plugin.name, texels=texels, filter=smooth, wrap="repeat" if wrap == "repeat" else "clamp")


def _checkerboard(plugin: Plugin, to_uv: np.ndarray, halves: np.ndarray, lost: list[str]) -> Texture | None:
    colors = []
    for key, default in (("color0", 0.4), ("color1", 0.2)):
        color = plugin.values.get(key, default)
        if not isinstance(color, Color | int | float):
            lost.append("a checkerboard of textures")
            return None
        colors.append(color.values if isinstance(color, Color) else (float(color),) * 3)
    scales, shifts = np.diag(to_uv)[:2], to_uv[:2, 3]
    if np.any(to_uv[[0, 1], [1, 0]]) or not np.all(scales > 0):
        lost.append("a checkerboard that is turned")
        return None
    # A square is half a unit of Mitsuba's; the numbers are the shortest that give its transform.
    squares = halves / scales
    if abs(squares[0] / squares[1] - 1) > CLOSE:
        lost.append("a checkerboard whose fields are no squares; those of its width are taken")
    square = shortest(float(squares[0]), lambda side: halves[0] / side == scales[0])
    offset = [
        shortest(
            float(-2 * square * shift - half),
            lambda start, half=half, shift=shift: -(half + start) / (2 * square) == shift,
        )
        for half, shift in zip(halves, shifts, strict=True)
    ]
    return Texture(plugin.name, colors=tuple(colors), square=square, offset=tuple(offset))


def shortest(number: float, gives: Callable[[float], bool]) -> float:
    """The number near another one that has the fewest digits of those that give the same; else the number."""
    tried = (float(f"{number:.{digits}g}") for digits in range(1, 18))
    return next((candidate for candidate in tried if gives(candidate)), number)


def read_sky(plugin: Plugin, path: Path, lost: list[str]) -> np.ndarray:
    """The picture all around, as `background` takes it.

    Mitsuba's first and last row lie at the poles; ours are in the middle of as many strips.
    """
    texels = _picture(plugin, path)
    turn = transform_of(plugin)
    if not np.allclose(turn[1, [0, 2]], 0) or not np.isclose(turn[1, 1], 1):
        lost.append("envmap: it is turned about another axis than y; it stands upright")
        turn = np.eye(4)
    # Ours is theirs after half a turn: what is left of the turn moves columns.
    angle = np.arctan2(turn[0, 2], turn[0, 0]) + np.pi
    columns = angle / (2 * np.pi) * texels.shape[2]
    whole = round(columns)
    if abs(columns - whole) > CLOSE:
        lost.append("envmap: its turn is no whole number of columns; the nearest is taken")
    texels = np.roll(texels, -whole % texels.shape[2], axis=2)
    between, means = texels[:, 1::2], (texels[:, :-1] + texels[:, 1:]) / 2
    if texels.shape[1] % 2 and texels.shape[1] > 1:
        inner = (between[:, :-1] + between[:, 1:]) / 2
        poles = np.stack([between[:, 0], between[:, -1]], axis=1)
        scale = CLOSE * max(float(np.abs(texels).max()), 1e-30)
        if np.allclose(texels[:, 2:-1:2], inner, 0, scale) and np.allclose(texels[:, [0, -1]], poles, 0, scale):
            return between
    lost.append("envmap: its rows lie at the poles; the means of each two are taken")
    return means if means.shape[1] else texels


def _picture(plugin: Plugin, path: Path) -> np.ndarray:
    name = plugin.values.get("filename")
    if not isinstance(name, str):
        raise SceneError(f"{path}: {plugin.tag} {plugin.name or plugin.kind}: has no filename.")
    found = path.parent / name
    try:
        return read_picture(found, transfer="course" if plugin.values.get("raw") is True else "srgb")
    except PictureError as cause:
        raise SceneError(f"{path}: {plugin.tag} {plugin.name or plugin.kind}: {cause}") from cause
