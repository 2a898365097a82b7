"""A picture from a scene: refused where there is no memory for it, rendered, and what a film is."""

import dataclasses
import io
import os
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Num
from PIL import Image as PillowImage

from raytrace_jax.errors import PictureError
from raytrace_jax.images import Transfer
from raytrace_jax.images.exr import write_exr
from raytrace_jax.images.hdr_ppm import write_ppm
from raytrace_jax.images.png import write_png
from raytrace_jax.images.transfer import encode_srgb
from raytrace_jax.scene.checks import check_values
from raytrace_jax.scene.response import develop_compiled, without_idle
from raytrace_jax.scene.scene import Scene, map_scenes
from raytrace_jax.tracer.pixels import mean_of_samples, picture_pixels, pixel_outputs
from raytrace_jax.tracer.resolved_settings import ResolvedSettings, resolve_settings
from raytrace_jax.tracer.run import Capacity
from raytrace_jax.tracer.settings import AOVS, RenderSettings
from raytrace_jax.util.numerics import is_traced
from raytrace_jax.util.session import lack_of_memory

Image = Float[Array, "3 height width"]


class Film(eqx.Module):
    """A rendered picture and its arbitrary output variables; components first, then rows from the top, then columns.

    Args:
        image: scene-linear RGB; the course's models keep it within [0, 1].
        aov: the variables asked for, by name: `depth` (distance along the camera ray), `normal` (unit, as the shape
            has it), `position` (world units), `shape_index` (position in the file's order, -1 for none), `bounce_count`
            (the largest number of bounces after which a ray of the pixel still hit something). They belong to the
            pixel's own point, whatever the number of samples, and are 0 where nothing is hit.
        overflow: how many rays too many the batch had that wanted most; those are black. `render` makes it zero: it can
            be positive only of a renderer within a transformation of JAX.
    """

    image: Image
    aov: dict[str, Num[Array, "..."]]
    overflow: Int[Array, ""]

    def channels(self) -> dict[str, Float[np.ndarray, "height width"]]:
        """R, G and B, and the channels of the variables, by the names that OpenEXR files have for them."""
        found = dict(zip("RGB", np.asarray(self.image), strict=True))
        for name, values in self.aov.items():
            planes = np.asarray(values).reshape(-1, *self.image.shape[1:])
            found |= dict(zip(AOVS[name].channels, planes, strict=True))
        return found

    def save(self, path: str | os.PathLike[str], *, half: bool = False, transfer: Transfer = "srgb") -> None:
        """Write the film: all channels as OpenEXR (`.exr`), or the picture as PNG (`.png`) or PPM (`.ppm`).

        `write_film` writes beside them how they were made.

        Args:
            half: of OpenEXR, store 16-bit floats.
            transfer: of PNG and PPM, `srgb`, what screens expect, or `course`, without a gamma.

        Raises:
            PictureError: the name ends in none of them, a channel is not finite, or the file cannot be written.
        """
        suffix = Path(path).suffix.lower()
        if suffix in (".png", ".ppm"):
            write = write_png if suffix == ".png" else write_ppm
            write(path, np.asarray(self.image), transfer=transfer)
        elif suffix == ".exr":
            write_exr(path, self.channels(), half=half)
        else:
            raise PictureError(f"{path}: a film's file ends in .exr, .png or .ppm, not in {suffix or 'none'!r}.")

    def show(self) -> PillowImage.Image:
        """The picture in sRGB for a screen, as a Pillow image: a notebook draws it, `film.show().show()` opens it."""
        return PillowImage.fromarray(np.ascontiguousarray(np.moveaxis(encode_srgb(np.asarray(self.image)), 0, -1)))

    def _repr_png_(self) -> bytes | None:
        if is_traced(self.image) or np.ndim(self.image) != 3:
            return None
        with io.BytesIO() as file:
            self.show().save(file, "png")
            return file.getvalue()


def refuse_too_large(scene: Scene, settings: ResolvedSettings, derivatives: int = 0) -> None:
    """Raise PictureError where there is no memory for a picture, and SettingsError of a crop outside of it."""
    _, _, width, height = settings.window(scene.camera.pixeldim)
    channels = 3 * (1 + derivatives) + sum(len(AOVS[name].channels) for name in settings.aov)
    # A channel of a pixel is rendered and written in several copies. Between pictures of 1024 and 2048 pixels a side
    # the peak grows by 34 bytes (OpenEXR), 32 (PNG), 37 (64 bits) and, with a derivative, 31.
    if lack := lack_of_memory(30 * channels * width * height):
        by = f" with derivatives by {derivatives} numbers" if derivatives else ""
        raise PictureError(
            f"a picture of {width} x {height} pixels{by} {lack}: render it in parts (--crop), or smaller (--size)."
        )


def render(scene: Scene, settings: RenderSettings | None = None) -> Film:
    """Render a scene.

    Pixels are the colours at their points (or the mean of `samples` x `samples` of them); `edges="aware"` has the
    values of areas. Within a transformation of JAX (`jit`, `grad`, `jvp`, `vmap`) use `make_renderer`.

    Args:
        scene: the scene, with concrete values; its arrays' dtype (float32 or float64) is that of the picture.
        settings: what to render. None is what the scene's file says. No size or crop compiles the tracer anew, nor does
            a number of point samples; the effects of a film are compiled for each size.

    Returns:
        The film: `film.image` and the AOVs that were asked for.

    Raises:
        ValueError: the scene is traced.
        SettingsError: a crop outside of the picture.
        SceneError: a number of the scene is not finite, or not a value that its attribute can have.
        PictureError: there is no memory for such a picture.
    """
    settings = resolve_settings(scene, settings)
    if is_traced(scene):
        raise ValueError("render() needs a scene's values: inside of a JAX transformation use make_renderer(scene)")
    check_values(scene)
    refuse_too_large(scene, settings)
    return render_concrete(scene, settings.of_points)


def render_radiance(scene: Scene, settings: ResolvedSettings, room: Capacity | None = None) -> Film:
    """The picture of a scene before the camera's response, by settings that say `edges`; the scene was checked."""
    numpy: Any = np if room is None else jnp
    _, _, width, height = settings.window(scene.camera.pixeldim)
    scenes = map_scenes(lambda x: numpy.asarray(x)[None], dataclasses.replace(scene, film=None))
    pixels = picture_pixels(scene, settings, numpy)
    found: dict[str, Any] = {}
    overflow: Any = 0
    if settings.samples == 1 or settings.aov:
        # The variables are those of the pixels' own points: their means would mean nothing.
        found, overflow = pixel_outputs(scenes, pixels, settings, room)
    if settings.samples > 1:

        def colors(points):
            without = dataclasses.replace(settings, aov=())
            found, overflow = pixel_outputs(scenes, pixels._replace(points=points), without, room)
            return [found["color"]], overflow

        [found["color"]], more = mean_of_samples(pixels, settings.samples, colors)
        overflow = numpy.maximum(overflow, more)
    aov = {name: x[0].reshape(*x.shape[1:-1], height, width) for name, x in found.items()}
    if room is None:
        # Put there as they are: `jnp.asarray` would compile a program for each size.
        aov, overflow = jax.device_put((aov, np.int32(overflow)))
    return Film(aov.pop("color"), aov, overflow)


def render_concrete(scene: Scene, settings: ResolvedSettings) -> Film:
    radiance = render_radiance(scene, settings)
    if scene.film is None:
        return radiance
    # No effect of the response that does nothing is computed.
    frame = settings.frame(scene.camera.pixeldim)
    return dataclasses.replace(radiance, image=develop_compiled(radiance.image, without_idle(scene.film), frame))
