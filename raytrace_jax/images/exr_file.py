"""The picture in an OpenEXR file: which of its channels make it, in which primaries, and whence it is."""

import os
from collections.abc import Iterable
from functools import cached_property

import numpy as np

from raytrace_jax.errors import PictureError
from raytrace_jax.images import Transfer
from raytrace_jax.images.exr import (
    RGB,
    ExrPicture,
    by_layer,
    find_layer,
    opened,
    read_exr,
    read_metadata,
    refuse_not_finite,
)
from raytrace_jax.images.picture_file import PictureFile, PictureOrigin
from raytrace_jax.images.transfer import (
    LINEAR_SPACES,
    NEARLY,
    REC_709,
    Chromaticities,
    ColourSpace,
    linear_space,
    rgb_to_xyz,
)

CHROMA = ("RY", "Y", "BY")
"""The channels of colours that are stored as their luminance, and red and blue relative to it."""


class ExrFile(PictureFile):
    """The picture in an OpenEXR file. An alpha is left out: colours are premultiplied, that is, already over black."""

    format = "OpenEXR"

    def __init__(self, path: str | os.PathLike[str], layer: str | None = None) -> None:
        super().__init__(path)
        self.layer = layer

    @cached_property
    def picture(self) -> ExrPicture:
        """All of the file."""
        return read_exr(self.path)

    @cached_property
    def names(self) -> tuple[str, str, str]:
        """The channels that make the picture."""
        return _rgb_channels(self.picture.channels, self.layer, str(self.path))

    @cached_property
    def primaries(self) -> tuple[str, Chromaticities]:
        """What states the primaries, and these; a name of `LINEAR_SPACES` where it is an id of the Color Interop Forum.

        An id goes before chromaticities, which programs pass on when they are no longer right, and what is said to be a
        file of ACES before both (the Forum's "Identifying the Color Space of OpenEXR Files").
        """
        said = self.picture.attributes[self.names[0]]
        chromaticities = tuple(map(float, said.get("chromaticities", REC_709)))
        is_of_aces = said.get("acesImageContainerFlag") == 1
        space = "lin_ap0_scene" if is_of_aces else str(said.get("colorInteropID", "unknown"))
        if space == "data":
            return space, REC_709
        if space == "unknown":
            return "by chromaticities", chromaticities
        if space not in LINEAR_SPACES:
            raise self.error(
                f"says that its colours are {space!r} (colorInteropID), and linear light of a known space is wanted: "
                f"{', '.join(LINEAR_SPACES)}; oiiotool --colorconvert converts it"
            )
        primaries = LINEAR_SPACES[space]
        if "chromaticities" in said and not np.allclose(primaries, chromaticities, atol=NEARLY):
            self.tell(
                f"says that its colours are {space}, and has the chromaticities of others: it is read as {space}."
            )
        return space, primaries

    def numbers(self) -> np.ndarray:
        """The channels of the layer, a grey one three times, or the colours that luminance and chroma stand for."""
        for name in self.names:
            refuse_not_finite(f"{self.path}: cannot be used as a picture", name, self.picture.channels[name])
        stored = np.stack([self.picture.channels[name] for name in self.names], axis=-1)
        if self.names[0].rpartition(".")[2] == "RY":
            # RY = (R - Y) / Y and BY = (B - Y) / Y, and Y is the luminance in the file's own primaries.
            luminance = stored[..., 1].astype(np.float64)
            red, blue = (luminance * (1 + stored[..., k]) for k in (0, 2))
            try:
                of_red, of_green, of_blue = rgb_to_xyz(self.primaries[1])[1]
            except ValueError as cause:
                raise self.error(str(cause)) from cause
            stored = np.stack([red, (luminance - of_red * red - of_blue * blue) / of_green, blue], axis=-1)
        return stored.astype(np.float32, copy=False)

    def meaning(self) -> ColourSpace | None:
        """The space of its primaries, where these are not Rec. 709's and it has colours."""
        name, primaries = self.primaries
        try:
            is_grey = len(set(self.names)) == 1
            return None if is_grey else linear_space(name, primaries, adapts=name in LINEAR_SPACES)
        except ValueError as cause:
            raise self.error(str(cause)) from cause

    def pixel_aspect(self) -> float:
        """As of any file."""
        return float(self.picture.attributes[self.names[0]].get("pixelAspectRatio", 1.0))

    def light(self, transfer: Transfer | None = None) -> np.ndarray:
        """As of any file; no transfer changes floats."""
        return super().light()

    def origin(self) -> PictureOrigin:
        """The metadata of `write_exr`, and the attribute `generatedBy`."""
        try:
            header = opened(self.path, header_only=True).parts[0].header
        except (RuntimeError, ValueError, IndexError) as cause:
            raise self.error(f"is a truncated or broken OpenEXR file: {cause}") from cause
        return PictureOrigin(read_metadata(self.path, header), str(header.get("generatedBy", "")))


def _rgb_channels(names: Iterable[str], layer: str | None, where: str) -> tuple[str, str, str]:
    """Return the three channel names that make the picture, R, G and B or RY, Y and BY; a grey `Y` comes three times.

    Without `layer`, the picture is the channels without a layer if they have a colour, else the only layer
    with a colour, else the only one called `Combined`, as Blender has it.
    """
    components = by_layer(names)
    # A Y beside an X is a vector's second component (`normal.X normal.Y normal.Z`), not a grey picture.
    coloured = [one for one, has in components.items() if has.issuperset(RGB) or ("Y" in has and "X" not in has)]
    if layer is not None:
        chosen = find_layer(names, layer, where)
        if chosen not in coloured:
            has = ", ".join(sorted(components[chosen]))
            raise PictureError(
                f"{where}: the layer {chosen!r} has the channels {has}, and R, G, B or a grey Y is wanted"
            )
    elif not coloured:
        layers = "; ".join(f"{one!r} ({', '.join(sorted(has))})" for one, has in components.items())
        raise PictureError(f"{where}: has no layer with the channels R, G, B or a grey Y; its layers are {layers}")
    else:
        combined = [one for one in coloured if one.rpartition(".")[2] == "Combined"]
        obvious = [only for only in (coloured, combined) if len(only) == 1]
        if "" not in coloured and not obvious:
            raise PictureError(f"{where}: has several pictures, name one of the layers {str(coloured)[1:-1]}")
        chosen = "" if "" in coloured else obvious[0][0]
    prefix = f"{chosen}." if chosen else ""
    red, green, blue = next((names for names in (RGB, CHROMA) if components[chosen].issuperset(names)), ("Y", "Y", "Y"))
    return prefix + red, prefix + green, prefix + blue
