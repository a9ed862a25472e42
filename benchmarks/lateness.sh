#!/usr/bin/env bash
# Lateness of the loop's wake-ups against cyclictest, on an idle machine and under load, with a verdict for each target.
#
#   benchmarks/lateness.sh [SECONDS]      seconds for each of the two, 180 by default
#
# Needs cyclictest (package rt-tests), stress-ng, and the right to real-time priorities. Build nothing else meanwhile.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
seconds="${1:-180}"

for program in cyclictest stress-ng; do
  if ! command -v "$program" >/dev/null; then
    echo "$program is missing: apt-get install rt-tests stress-ng" >&2
    exit 2
  fi
done

cargo build --release --quiet -p bench -p benchmarks
out="$(mktemp -d)"
load=""
finish() {
  if [ -n "$load" ]; then kill "$load" 2>/dev/null || true; fi
  rm -rf "$out"
}
trap finish EXIT

cargo run --release --quiet -- latency --seconds "$seconds" --cyclictest --json >"$out/idle.json"

stress-ng --cpu 2 --vm 1 --hdd 1 --temp-path "$out" --quiet &
load=$!
cargo run --release --quiet -- latency --seconds "$seconds" --cyclictest --json >"$out/loaded.json"
kill "$load" && wait "$load" 2>/dev/null || true
load=""

# The verdict of both, even where the first one misses a target.
cd "$out"
cargo run --release --quiet --manifest-path "$OLDPWD/Cargo.toml" -p benchmarks --bin lateness -- idle.json loaded.json
