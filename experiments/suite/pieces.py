"""Long runs of the suite in pieces: all slow tests, file by file; or the property tests with one seed after the other.

    .venv/bin/python experiments/suite/pieces.py slow -o output/slow
    .venv/bin/python experiments/suite/pieces.py seeds -o output/seeds

Each result is written at once; the same command goes on after an interrupt. `--only NAME ...` takes some of the files,
or of the seeds.
"""

import argparse
import json
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).parents[2]
FILES = {path.stem.removeprefix("test_"): path for path in sorted(ROOT.glob("tests/*/test_*.py"))}
SEEDS = 20
MOST_SECONDS = 1200
"""Of one piece; what takes longer is stopped and said to have failed."""


def files_with(pattern: str) -> dict[str, Path]:
    """The files of tests in which something is found."""
    return {name: path for name, path in FILES.items() if re.search(pattern, path.read_text())}


def slow_pieces() -> dict[str, list[str]]:
    """The arguments of pytest for the slow tests of each file."""
    return {name: ["-m", "slow", str(path)] for name, path in files_with(r"mark\.slow|mark\.fast_cases").items()}


def seed_pieces() -> dict[str, list[str]]:
    """The arguments of pytest for the property tests of the fast suite, with each seed."""
    properties = [*map(str, files_with("@given").values())]
    common = ["-m", "hypothesis and not slow", "--hypothesis-profile", "explore"]
    return {str(seed): [*common, "--hypothesis-seed", str(seed), *properties] for seed in range(1, SEEDS + 1)}


PIECES = {"slow": slow_pieces, "seeds": seed_pieces}


def run(arguments: list[str], cache: Path) -> dict:
    """What pytest says last, which tests failed, and how long it took."""
    command = [sys.executable, "-m", "pytest", "-q", "-n", "2", "-o", f"cache_dir={cache}", *arguments]
    began = time.monotonic()
    try:
        done = subprocess.run(
            command,
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            timeout=MOST_SECONDS,
            stdin=subprocess.DEVNULL,
        )
        lines = done.stdout.splitlines() or [done.stderr]
        said, failed = lines[-1], [line.split(" - ")[0] for line in lines if line.startswith(("FAILED", "ERROR"))]
        if done.returncode and not failed:
            failed = [said]
    except subprocess.TimeoutExpired:
        said, failed = "stopped", [f"longer than {MOST_SECONDS} s"]
    return {"said": said, "failed": failed, "seconds": round(time.monotonic() - began, 1)}


def main() -> None:
    """Run one piece after the other."""
    options = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    options.add_argument("what", choices=PIECES)
    options.add_argument("-o", "--output", type=Path, required=True)
    options.add_argument("--only", nargs="*", metavar="NAME")
    chosen = options.parse_args()
    pieces = PIECES[chosen.what]()
    unknown = set(chosen.only or ()) - set(pieces)
    if unknown:
        options.error(f"{chosen.what} has no {', '.join(sorted(unknown))}; it has {', '.join(pieces)}")
    chosen.output.mkdir(parents=True, exist_ok=True)
    results = chosen.output / f"{chosen.what}.json"
    found = json.loads(results.read_text()) if results.exists() else {}
    for name in chosen.only or pieces:
        if name not in found:
            found[name] = run(pieces[name], (chosen.output / "cache").absolute())
            results.write_text(json.dumps(found, indent=1) + "\n")
        print(f"{name}: {found[name]['said']}", *found[name]["failed"], sep="\n  ", flush=True)
    failures = sum(bool(one["failed"]) for one in found.values())
    print(f"{len(found) - failures} of {len(found)} without a failure")
    sys.exit(bool(failures))


if __name__ == "__main__":
    main()
