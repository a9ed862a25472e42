#!/bin/sh
# The joint fit against scipy.optimize.least_squares with a numba-compiled right-hand side, in one run. Needs python3 with venv; the
# packages of requirements.txt go into an environment below target. Exit code 3: a target is missed.
set -eu
cd "$(dirname "$0")/../.."
target=${CARGO_TARGET_DIR:-target}
venv=$target/scipy-venv
if ! cmp -s benchmarks/scipy/requirements.txt "$venv/requirements.txt"; then
    python3 -m venv "$venv"
    "$venv/bin/pip" install --quiet -r benchmarks/scipy/requirements.txt
    cp benchmarks/scipy/requirements.txt "$venv/requirements.txt"
fi
exec cargo run --release -p benchmarks --bin against_scipy -- "$venv/bin/python" benchmarks/scipy/fit.py
