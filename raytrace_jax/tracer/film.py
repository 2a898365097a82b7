"""What a rendered picture is, and the files that it is written into."""

import io
import os
from pathlib import Path

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int, Num
from PIL import Image as PillowImage

from ..errors import PictureError
from ..images import Transfer
from ..images.exr import write_exr
from ..images.hdr_ppm import write_ppm
from ..images.png import write_png
from ..images.transfer import encode_srgb
from ..util.numerics import is_traced
from .settings import AOVS

Image = Float[Array, "3 height width"]


class Film(eqx.Module):
    """A rendered picture and its arbitrary output variables; components first, then rows from the top, then columns.

    Args:
        image: scene-linear RGB; the course's models keep it within [0, 1].
        aov: the variables asked for, by name: `depth` (distance along the camera ray), `normal` (unit, as the shape
            has it), `position` (world units), `shape_index` (position in the file's order, -1 for none), `bounce_count`
            (the largest number of bounces after which a ray of the pixel still hit something). They belong to the
            pixel's own point, whatever the number of samples, and are 0 where nothing is hit.
        overflow: how many samples of pixels lack rays, which are black there. It can be positive only within a
            transformation of JAX, and if `throw` of the settings is off.
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
