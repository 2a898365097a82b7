"""Do property tests fail by chance? Those of the fast suite with other random examples, seed after seed.

    .venv/bin/python experiments/suite/seeds.py -o output/seeds

Each result is written at once; the same command goes on after an interrupt. `--seeds 3` takes fewer.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]


def run(seed: int, cache: Path, files: list[Path]) -> tuple[str, list[str]]:
    """The last line of a run with a seed, and which tests failed."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-m", "hypothesis and not slow"]
    command += ["--hypothesis-profile", "explore", "--hypothesis-seed", str(seed), "-o", f"cache_dir={cache}"]
    done = subprocess.run([*command, *files], cwd=ROOT, capture_output=True, text=True, check=False)
    lines = done.stdout.splitlines()
    failed = [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
    if done.returncode and not failed:
        raise SystemExit(done.stdout + done.stderr)
    return lines[-1], failed


def main() -> None:
    """Take one seed after the other."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument("--seeds", type=int, default=20, help="how many")
    options.add_argument("--files", nargs="*", type=Path, help="of tests; default: all that have a property")
    chosen = options.parse_args()
    files = chosen.files or [path for path in sorted(ROOT.glob("tests/test_*.py")) if "@given" in path.read_text()]
    chosen.output.mkdir(parents=True, exist_ok=True)
    results = chosen.output / "seeds.json"
    found = json.loads(results.read_text()) if results.exists() else {}
    for seed in range(1, chosen.seeds + 1):
        if str(seed) not in found:
            began = time.monotonic()
            said, failed = run(seed, (chosen.output / "cache").absolute(), files)
            found[str(seed)] = {"said": said, "failed": failed, "seconds": round(time.monotonic() - began, 1)}
            results.write_text(json.dumps(found, indent=1) + "\n")
        print(f"seed {seed}: {found[str(seed)]['said']}", *found[str(seed)]["failed"], sep="\n  ", flush=True)
    print(f"{sum(not one['failed'] for one in found.values())} of {len(found)} without a failure")


if __name__ == "__main__":
    main()
