"""Do the tests notice when the code is broken? Twenty places that matter, each broken alone.

    .venv/bin/python experiments/suite/mutations.py -o output/mutations

Each result is written at once; the same command goes on after an interrupt. `--only NAME ...` takes some of them,
`--tree PATH` another checkout. A mutation is noticed if a test of its room fails: one of the fast suite, or else one of
the slow ones that CI runs.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]


class Mutation(NamedTuple):
    """A place in the code, what stands there and what is put in its place, and the files of tests of its room."""

    file: str
    old: str
    new: str
    tests: str


MUTATIONS = {
    "schlick_power": Mutation(
        "optics/fresnel.py", "(x_squared * x_squared * x)", "(x_squared * x_squared)", "optics optics_formulas classic"
    ),
    "fresnel_sign": Mutation(
        "optics/fresnel.py",
        "(c - eta * t) / perpendicular",
        "(c + eta * t) / perpendicular",
        "optics_formulas physical",
    ),
    "leaving_ratio": Mutation("tracer/shading/classic.py", "AIR_IOR / ior if", "ior / AIR_IOR if", "classic render"),
    "total_reflection": Mutation(
        "tracer/shading/classic.py", "jnp.where(total, 1, reflectance)", "reflectance", "classic render"
    ),
    "highlight_before_clamp": Mutation(
        "tracer/shading/classic.py", "return clamp01(color + self.highlight)", "return color", "classic render"
    ),
    "absorption_sign": Mutation("tracer/shading/physical.py", "jnp.exp(-jnp.where", "jnp.exp(jnp.where", "physical"),
    "nested_media": Mutation("tracer/shading/physical.py", "first = (own < size)", "first = (own > size)", "physical"),
    "lambert_falloff": Mutation(
        "tracer/shading/physical.py", "cos * (1 / light.squared_distance)", "cos * light.inverse_distance", "physical"
    ),
    "self_hit": Mutation(
        "tracer/geometry/solid.py",
        "hits = jnp.where(way.own, rays.inside, way.t_in < way.t_out)",
        "hits = way.t_in < way.t_out",
        "geometry classic",
    ),
    "packing_order": Mutation(
        "tracer/integrator.py", "rank - 1, wanted.size)", "rank, wanted.size)", "geometry render"
    ),
    "queue_place": Mutation(
        "tracer/integrator.py", "jnp.minimum(tail + slot,", "jnp.minimum(tail + slot + 1,", "classic render"
    ),
    "edge_of_a_ball": Mutation(
        "tracer/geometry/solid.py", "slope = -jnp.sum(n *", "slope = jnp.sum(n *", "visibility footprints"
    ),
    "pixel_row": Mutation(
        "tracer/geometry/camera.py", "from_bottom = (height - 1) - row", "from_bottom = height - row", "cameras render"
    ),
    "checker_edges": Mutation("tracer/shading/textures.py", "(i, j, i * j) for", "(i, j, abs(i * j)) for", "textures"),
    "cauchy_guard": Mutation(
        "inverse/problem/linearize.py", "large = squared > 1e-8", "large = squared > -1.0", "losses"
    ),
    "bounded_reach": Mutation("inverse/solve/solvers.py", "side * downhill > 0", "side * downhill < 0", "bounds"),
    "vuong_squares": Mutation(
        "inverse/judge/structure.py",
        "worse**2 - best**2",
        "worse**2 + best**2",
        "verdict model_check fit_options",
    ),
    "degrees_of_freedom": Mutation(
        "inverse/judge/uncertainty.py",
        "freedom = int(np.sum(linearization.matters)) - len(state.problem.unknowns.names)",
        "freedom = int(np.sum(linearization.matters)) // 3 - len(state.problem.unknowns.names)",
        "uncertainty observation",
    ),
    "bias_sign": Mutation(
        "inverse/problem/observation.py",
        "return (image + bias - target) * root",
        "return (image - bias - target) * root",
        "observation correction picture_changes",
    ),
    "gamma_chunk": Mutation(
        "images/png.py", 'SRGB_GAMMA if transfer == "srgb"', 'SRGB_GAMMA if transfer != "srgb"', "png"
    ),
}


def is_noticed(mutation: Mutation, tree: Path, cache: Path) -> tuple[bool, str]:
    """Whether a test fails in a copy of the tree that is broken so, and the first that does."""
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "tree"
        shutil.copytree(tree, copy, ignore=shutil.ignore_patterns(".git", ".venv", ".pytest_cache", "output"))
        path = copy / "raytrace_jax" / mutation.file
        text = path.read_text()
        if text.count(mutation.old) < 1:
            raise SystemExit(f"{mutation.file}: {mutation.old!r} is not there any more")
        path.write_text(text.replace(mutation.old, mutation.new))
        paths = [path for name in mutation.tests.split() for path in ROOT.glob(f"tests/*/test_{name}.py")]
        files = [str(path.relative_to(ROOT)) for path in paths]
        listed = (tree / ".ci" / "slow_tests").read_text().splitlines()
        slow = [test for test in listed if test.split("::")[0] in files]
        for tests in (files, ["-m", "slow", *slow]):
            command = [sys.executable, "-m", "pytest", "-q", "-x", "-n", "2", "-o", f"cache_dir={cache}", *tests]
            environment = os.environ | {"CI": "true", "PYTHONPATH": str(copy)}
            done = subprocess.run(command, cwd=copy, env=environment, capture_output=True, text=True, check=False)
            lines = done.stdout.splitlines()
            failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
            # Stopped at the first failure pytest says 1, or with several processes 2.
            if done.returncode and not failed:
                raise SystemExit(done.stdout + done.stderr)
            if failed or not slow:
                break
    return bool(failed), failed[0] if failed else ""


def main() -> None:
    """Break the places one after the other."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument("--only", nargs="*", choices=MUTATIONS, default=list(MUTATIONS))
    options.add_argument("--tree", type=Path, default=ROOT)
    chosen = options.parse_args()
    chosen.output.mkdir(parents=True, exist_ok=True)
    results = chosen.output / "mutations.json"
    found = json.loads(results.read_text()) if results.exists() else {}
    for name in chosen.only:
        if name not in found:
            began = time.monotonic()
            noticed, by = is_noticed(MUTATIONS[name], chosen.tree, (chosen.output / "cache").absolute())
            found[name] = {"noticed": noticed, "by": by, "seconds": round(time.monotonic() - began, 1)}
            results.write_text(json.dumps(found, indent=1) + "\n")
        print(
            f"{name:28s} {'noticed' if found[name]['noticed'] else 'NOT NOTICED':12s} {found[name]['by']}", flush=True
        )
    print(f"{sum(one['noticed'] for one in found.values())} of {len(found)} noticed")


if __name__ == "__main__":
    main()
