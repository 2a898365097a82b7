"""Which glass a fit has found: index and Abbe's number of materials with free colours, and the catalogue's names."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from ..errors import RaytraceError
from ..optics import glass
from ..optics.dispersion import CHANNEL_WAVELENGTHS, Dispersion, cauchy_index, dispersion
from ..scene.parameters import blocks_of, resolve
from ..scene.scene import Scene
from ..scene.structs import AbbeMaterials, ChannelMaterials
from ..util.digits import with_error
from ..util.text import listed
from .problem.unknowns import Covariance


def fitted_dispersions(scene: Scene, names: Sequence[str], covariance: Covariance) -> dict[str, Dispersion]:
    """The dispersion by name of each material whose Abbe's number is free, or whose three indices are.

    It is that of the indices that the picture's channels have shown, so what a catalogue would say of them: Abbe's
    number as a scene has it, by Cauchy's equation, may be 5 % off that of a glass whose three indices it meets.

    Args:
        scene: the fitted one.
        covariance: that of the free numbers, in the order of their names.
    """
    dispersive = [b for b in blocks_of(scene, "material") if b.type.struct in (AbbeMaterials, ChannelMaterials)]
    free = {resolve(scene, name).address: k for k, name in enumerate(names)} if dispersive else {}
    found = {}
    for block in dispersive:
        by_abbe = block.type.struct is AbbeMaterials
        channels = [block.address("ior", channel) for channel in range(3)]
        numbers = [block.address("ior"), block.address("abbe")] if by_abbe else channels
        if not all(number in free for number in (numbers[1:] if by_abbe else numbers)):
            continue
        values = np.array([float(number.read(scene)) for number in numbers])
        # An index that is not free counts as exact.
        places = [free.get(number, -1) for number in numbers]
        known = np.pad(covariance, (0, 1))[np.ix_(places, places)]
        index, slopes = _channels(values) if by_abbe else (values, np.eye(3))
        if np.all(np.isfinite(known)) and index.min() > 1:
            found[block.name] = dispersion(index, slopes @ known @ slopes.T)
    return found


def _channels(numbers: Float[np.ndarray, "2"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3 2"]]:
    """The indices of the channels by index and Abbe's number, and their derivatives."""

    def index(numbers: np.ndarray) -> np.ndarray:
        n_d, abbe = numbers
        return cauchy_index(n_d, abbe, np.array(CHANNEL_WAVELENGTHS))

    steps = 1e-5 * np.diag(numbers)
    slopes = [(index(numbers + step) - index(numbers - step)) / (2 * step.sum()) for step in steps]
    return index(numbers), np.stack(slopes, axis=1)


def dispersion_words(material: str, found: Dispersion) -> str:
    """A sentence of what a catalogue has of a material's dispersion; empty where the picture tells none."""
    if not found.is_told:
        return ""
    # Melts of a glass differ, and so do what makers call the same glass.
    error, abbe_error = np.hypot(found.errors, [glass.ALIKE[0], 0.0]).tolist()
    n_d, abbe = with_error(found.n_d, error), with_error(found.abbe, abbe_error)
    red, green, blue = CHANNEL_WAVELENGTHS
    words = f"{material} has n_d {n_d} and V_d {abbe} if its colours are light of {red:g}, {green:g} and {blue:g} nm"
    try:
        rows = glass.find(found.n_d, error, abbe=found.abbe, abbe_error=abbe_error)
    except RaytraceError as missing:
        return f"{words}. Which glasses these are: {missing}"
    names = [name for row in rows for name in (str(row), *row.others)]
    return f"{words}; what the catalogue has within {glass.FARTHEST:g} errors, nearest first: {listed(names)}"
