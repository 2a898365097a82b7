"""Mitsuba's perspective sensor as a camera of ours."""

import math

import numpy as np

from raytrace_jax.errors import SceneError
from raytrace_jax.exchange.mitsuba.plugins import Plugin, number_of, transform_of
from raytrace_jax.images.lens import DIAGONAL_OF_FILM
from raytrace_jax.scene import build
from raytrace_jax.scene.rows import Description


def read_camera(sensor: Plugin, name: str, lost: list[str]) -> Description:
    """The camera of a sensor; what it has and we have not is added to `lost`."""
    if sensor.kind == "thinlens":
        lost.append("sensor thinlens: all is in focus")
    said = sensor.values.get("film")
    film = said if isinstance(said, Plugin) else Plugin("film", "hdrfilm", "", {})
    # Mitsuba's film has 768 x 576 pixels where nothing is said.
    width, height = (int(number_of(film, key, side)) for key, side in (("width", 768), ("height", 576)))
    lost += [f"film {key}" for key in film.values if key.startswith("crop_")]
    pixels = film.values.get("rfilter")
    if not isinstance(pixels, Plugin) or pixels.kind != "box":
        kind = pixels.kind if isinstance(pixels, Plugin) else "gaussian"
        lost.append(f"rfilter {kind}: a pixel is the mean over its square, as of a box")
    channels = film.values.get("pixel_format", "rgb")
    if str(channels).lower() not in ("rgb", "rgba"):
        lost.append(f"film pixel_format {channels}: a picture is red, green and blue")
    matrix = transform_of(sensor)
    origin, up, forward = matrix[:3, 3], matrix[:3, 1], matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
    # The axis' point that is nearest to the world's origin, if it is ahead: far off, so that little is rounded away.
    target = origin + max(1.0, float(-origin @ forward)) * forward
    if np.linalg.det(matrix[:3, :3]) < 0:
        lost.append("sensor to_world: the picture is mirrored there")
    aside, below = (number_of(sensor, f"principal_point_offset_{axis}", 0.0) for axis in "xy")
    center = {}
    if aside or below:
        center = {"center": ((0.5 - aside) * width - 0.5, (0.5 - below) * height - 0.5)}
    return build.camera(
        name,
        pixeldim=(width, height),
        viewpoint=tuple(map(float, origin)),
        lookat=tuple(map(float, target)),
        up=tuple(map(float, up)),
        fov=_horizontal_fov(sensor, width, height),
        **center,
    )


def _horizontal_fov(sensor: Plugin, width: int, height: int) -> float:
    """The horizontal angle of view in degrees, from an angle along any side or from a focal length."""
    if sensor.values.get("fov") is not None:
        fov, axis = number_of(sensor, "fov", 0.0), str(sensor.values.get("fov_axis", "x"))
    else:
        length = str(sensor.values.get("focal_length", 50.0)).removesuffix("mm")
        try:
            millimetres = float(length)
        except ValueError as cause:
            raise SceneError(f"focal_length is {length!r}, and a number of millimetres is wanted, as 50mm.") from cause
        fov, axis = math.degrees(2 * math.atan(DIAGONAL_OF_FILM / (2 * millimetres))), "diagonal"
    if axis in ("smaller", "larger"):
        axis = "x" if (width < height) == (axis == "smaller") else "y"
    sides = {"x": width, "y": height, "diagonal": math.hypot(width, height)}
    if axis not in sides:
        raise SceneError(f"fov_axis is {axis!r}, and there are {', '.join(sides)}, smaller, larger.")
    side = sides[axis]
    if side == width:
        return fov
    return math.degrees(2 * math.atan(math.tan(math.radians(fov) / 2) * width / side))
