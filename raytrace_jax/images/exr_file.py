"""The picture in an OpenEXR file: which of its channels make it, in which primaries, and whence it is."""

import os
from collections.abc import Iterable
from functools import cached_property

import numpy as np

from ..errors import PictureError
from . import Transfer, exr
from . import transfer as transfers
from .picture_file import MEMORY, PictureFile, PictureOrigin, refuse_beyond_memory
from .transfer import LINEAR_SPACES, REC_709, Chromaticities, ColourSpace


class ExrFile(PictureFile):
    """The picture in an OpenEXR file. An alpha is left out: colours are premultiplied, that is, already over black."""

    format = "OpenEXR"

    def __init__(self, path: str | os.PathLike[str], layer: str | None = None) -> None:
        super().__init__(path)
        self.layer = layer

    @cached_property
    def picture(self) -> exr.ExrPicture:
        return exr.read_exr(self.path)

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
        if "chromaticities" in said and not np.allclose(primaries, chromaticities, atol=transfers.NEARLY):
            self.tell(f"says that its colours are {space}, and has the chromaticities of others: it is read as said.")
        return space, primaries

    def numbers(self) -> np.ndarray:
        """The channels of the layer, a grey one three times."""
        height, width = self.picture.channels[self.names[0]].shape
        refuse_beyond_memory(self.path, "display window", width, height, bytes_per_pixel=MEMORY)
        for name in self.names:
            exr.refuse_not_finite(f"{self.path}: cannot be used as a picture", name, self.picture.channels[name])
        stored = np.stack([self.picture.channels[name] for name in self.names], axis=-1)
        return stored.astype(np.float32, copy=False)

    def stated(self) -> ColourSpace | None:
        """The space of its primaries, where these are not Rec. 709's and it has colours."""
        name, primaries = self.primaries
        is_grey = len(set(self.names)) == 1
        return None if is_grey else transfers.linear_space(name, primaries, adapts=name in LINEAR_SPACES)

    def pixel_aspect(self) -> float:
        return float(self.picture.attributes[self.names[0]].get("pixelAspectRatio", 1.0))

    def light(self, transfer: Transfer | None = None) -> np.ndarray:
        light = super().light()  # No transfer changes floats.
        headers = (self.picture.attributes[name] for name in self.names)
        absent = ~np.all([exr.stored_pixels(self.path, header) for header in headers], axis=0)
        return np.ma.array(light, mask=np.broadcast_to(absent, light.shape)) if absent.any() else light

    def origin(self) -> PictureOrigin:
        """The metadata of `write_exr`, and the attribute `generatedBy`."""
        try:
            header = exr.opened(self.path, header_only=True).parts[0].header
        except (RuntimeError, ValueError, IndexError) as cause:
            raise self.error(f"is a truncated or broken OpenEXR file: {cause}") from cause
        return PictureOrigin(exr.read_metadata(self.path, header), str(header.get("generatedBy", "")))


def _rgb_channels(names: Iterable[str], layer: str | None, where: str) -> tuple[str, str, str]:
    """The three channel names that make the picture, R, G and B; a grey `Y` comes three times.

    Without `layer`, the picture is the channels without a layer if they have a colour, else the only layer
    with a colour, else the only one called `Combined`, as Blender has it.
    """
    components = exr.by_layer(names)
    # A Y beside an X is a vector's second component (`normal.X normal.Y normal.Z`), not a grey picture, and beside RY
    # and BY it is a luminance with chroma.
    is_grey = {name: "Y" in has and has.isdisjoint(("X", "RY", "BY")) for name, has in components.items()}
    coloured = [name for name, has in components.items() if has.issuperset(exr.RGB) or is_grey[name]]
    if layer is not None:
        chosen = [one for one in coloured if one == exr.find_layer(names, layer, where)]
    else:
        combined = [one for one in coloured if one.rpartition(".")[2] == "Combined"]
        chosen = [""] if "" in coloured else coloured if len(coloured) == 1 else combined
    if len(chosen) != 1:
        layers = "; ".join(f"{one!r} ({', '.join(sorted(has))})" for one, has in components.items())
        wanted = "one layer with the channels R, G, B or a grey Y is wanted"
        raise PictureError(f"{where}: {wanted}: name it; its layers are {layers}")
    prefix = f"{chosen[0]}." if chosen[0] else ""
    red, green, blue = exr.RGB if components[chosen[0]].issuperset(exr.RGB) else ("Y", "Y", "Y")
    return prefix + red, prefix + green, prefix + blue
