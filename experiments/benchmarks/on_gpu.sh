#!/usr/bin/env bash
# A picture, a derivative and a small fit on an accelerator, beside what the CPU gave, and how long they take: one JSON.
#
#     experiments/benchmarks/on_gpu.sh on_gpu.json [WHEELS]
#
# For a machine that is bare and without a network: python3 there needs JAX for its accelerator, and WHEELS is a folder
# with wheels of what else is missing. Make it beforehand, where there is a network, from the names that the first run
# complains of:  pip download --no-deps -d WHEELS NAME ...
# Each measurement is written as it comes; what has no time left in LIMIT seconds is left out, and said.
set -euo pipefail
out=$(realpath -m "${1:?the JSON to write}")
here=$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)
site=$(mktemp -d)
trap 'rm -rf "$site"' EXIT
if [ -n "${2:-}" ]; then
    python3 -m pip install -q --no-index --no-deps --no-compile --target "$site" "$2"/*.whl
fi
export PYTHONPATH="$site:$here/../..${PYTHONPATH:+:$PYTHONPATH}"
export XDG_CACHE_HOME="$site/cache"
timeout --signal=INT "${LIMIT:-480}" "${PYTHON:-python3}" "$here/on_gpu.py" "$out"
