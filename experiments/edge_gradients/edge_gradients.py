"""Compare edge-aware derivative pictures with differences of supersampled pictures; print a table.

    python experiments/edge_gradients/edge_gradients.py [--cases NAME ...] [--samples 1 2 4] [--reference DIR]
        [--size 160 120]

The first run makes the references, which takes about an hour on two cores; they are kept in files, and a run that was
interrupted goes on where it stopped. Needs nothing but the package.
"""

import argparse
import pathlib
import sys

import jax
import numpy as np
from cases import CASES, Case, sized
from reference import reference_derivative, reference_picture

from raytrace_jax import RenderSettings, load_scene, picture_derivatives
from raytrace_jax.report.differences import correlation, relative_error

INSIDE = np.s_[..., 1:-1]
"""The first and the last column show where two planes of the course's scenes end exactly: rounding decides them."""


def rows(case: Case, samples: list[int], folder: pathlib.Path) -> tuple[list[list[str]], str]:
    """A row for each parameter, and a line about the picture itself."""
    scene, names = load_scene(case.path), list(case.steps)
    picture, target = (reference_picture(folder, case, moved)[INSIDE] for moved in (False, True))
    references = [reference_derivative(folder, case, name, halvings=1)[INSIDE] for name in names]
    coarser = [reference_derivative(folder, case, name)[INSIDE] for name in names]

    aware = {
        n: picture_derivatives(scene, names, RenderSettings(size=case.size, samples=n, edges="aware")) for n in samples
    }
    point = picture_derivatives(scene, names, RenderSettings(size=case.size))
    table = []
    for k, name in enumerate(names):
        reference = references[k]
        loss = 2 * np.sum((picture - target) * reference)
        row = [case.name, f"`{name}`", f"{relative_error(coarser[k], reference):.3f}"]
        row.append(f"{relative_error(point.values[k][INSIDE], reference):.2f}")
        for n in samples:
            values = aware[n].values[k][INSIDE]
            row.append(f"{correlation(values, reference):.3f}")
            row.append(f"{relative_error(values, reference):.3f}")
            by_loss = 2 * np.sum((aware[n].image[INSIDE] - target) * values)
            row.append(f"{100 * (values.sum() / reference.sum() - 1):+.1f}")
            row.append(f"{100 * (by_loss / loss - 1):+.1f}")
        table.append(row)
    errors = (f"{np.sqrt(np.mean((aware[n].image[INSIDE] - picture) ** 2)):.4f} at {n}x{n}" for n in samples)
    point_error = np.sqrt(np.mean((point.image[INSIDE] - picture) ** 2))
    return table, f"{case.name}: picture RMS {', '.join(errors)}; point-sampled {point_error:.4f}"


def main() -> None:
    """The command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=[case.name for case in CASES], help="default: all")
    parser.add_argument("--samples", nargs="+", type=int, default=[1, 2, 4], help="n x n edge-aware samples a pixel")
    parser.add_argument("--size", nargs=2, type=int, help="of all pictures; default: each case's own")
    parser.add_argument("--reference", type=pathlib.Path, default=pathlib.Path("edge_gradients_reference"))
    parser.add_argument("--reference-only", action="store_true", help="make the references and stop")
    arguments = parser.parse_args()
    jax.config.update("jax_enable_x64", True)

    cases = [case for case in CASES if not arguments.cases or case.name in arguments.cases]
    if arguments.size:
        cases = [sized(case, tuple(arguments.size)) for case in cases]
    head = ["scene", "parameter", "two steps", "point L2"]
    for n in arguments.samples:
        head += [f"{n}x{n} corr", "L2", "sum %", "loss %"]
    lines = []
    for case in cases:
        for name in case.steps:
            for halvings in (0, 1):
                reference_derivative(arguments.reference, case, name, halvings)
        for moved in (False, True):
            reference_picture(arguments.reference, case, moved)
    if arguments.reference_only:
        return
    print("| " + " | ".join(head) + " |\n" + "|---" * len(head) + "|")
    for case in cases:
        table, line = rows(case, arguments.samples, arguments.reference)
        lines.append(line)
        print("\n".join("| " + " | ".join(row) + " |" for row in table), flush=True)
    print("\n" + "\n\n".join(lines))


if __name__ == "__main__":
    sys.exit(main())
