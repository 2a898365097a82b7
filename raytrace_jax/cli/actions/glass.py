"""The command `glass`: which materials have an index, and what a material has."""

from collections.abc import Sequence

from ...optics import glass
from ...optics.dispersion import CHANNEL_WAVELENGTHS, LINE_C, LINE_D, LINE_F
from ...util.text import looks_like_number, quoted, value_and_deviation
from ..console import UsageError, print_table
from ..options.fits import read_prior
from ..options.scenes import Glass

CHANNELS = ("red", "green", "blue")


def run_glass(command: Glass) -> None:
    if not command.what:
        raise UsageError("an index with its error is wanted, as 1.5168+-0.0003, or a name, as N-BK7.")
    if looks_like_number(value_and_deviation(command.what)[0].strip()):
        _print_found(command)
    elif command.abbe or command.at or command.kind:
        raise UsageError(f"--abbe, --at and --kind go with an index, and {quoted(command.what)} is a name.")
    else:
        _print_material(glass.named(command.what))


def _print_found(command: Glass) -> None:
    index, error = _with_error("INDEX", command.what, "1.5168+-0.0003")
    abbe, abbe_error = _with_error("--abbe", command.abbe, "64+-2") if command.abbe else (None, None)
    found = glass.find(index, error, abbe=abbe, abbe_error=abbe_error, at=command.at or LINE_D, kind=command.kind)
    print_glasses(found, "1 material" if len(found) == 1 else f"{len(found)} materials")


def print_glasses(found: Sequence[glass.Glass], count: str) -> None:
    """Print the table of materials; `count` says how many they are."""
    heads = ("maker", "name", "n_d", "V_d", "errors", "other names")
    rows = [
        (g.maker, g.name, f"{g.n_d:.5f}", f"{g.V_d:.2f}", f"{g.deviations:.1f}", ", ".join(g.others)) for g in found
    ]
    print_table(f"{count} within {glass.FARTHEST:g} errors", heads, rows)


def _with_error(option: str, text: str, form: str) -> tuple[float, float]:
    try:
        return read_prior(text)
    except ValueError:
        raise UsageError(f"{option} {text}: write a number and its error, as {form}.") from None


def _print_material(material: glass.Glass) -> None:
    nm = {"d": LINE_D, "F": LINE_F, "C": LINE_C, **dict(zip(CHANNELS, CHANNEL_WAVELENGTHS, strict=True))}
    indices = {name: f"{material.index(wavelength):.6f}" for name, wavelength in nm.items()}
    rows = [(name, f"{nm[name]:g}", index) for name, index in indices.items()]
    birefringent = f", birefringent: the {material.ray} ray" if material.ray else ""
    print_table(f"{material}, V_d = {material.V_d:.2f}{birefringent}", ("line", "nm", "index"), rows)
    print("\n# one of these lines, in a scene's material; the last one by Cauchy's equation")
    print(f'glass "{material}"')
    print("ior", *(indices[name] for name in CHANNELS))
    print(f"ior {indices['d']} abbe {material.V_d:.2f}")
