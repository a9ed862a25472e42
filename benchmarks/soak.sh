#!/usr/bin/env bash
# Ten minutes in real time with two loggers in processes of their own beside the run's own, one of which is stopped for 5 s every
# minute: no sample may be lost in any of the three recordings, and the replay must agree.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
cargo build --release --quiet --bin bench
bench=target/release/bench
out=$(mktemp -d)
instance=soak-$$
trap 'kill $(jobs -p) 2>/dev/null || true; rm -rf "$out"' EXIT
$bench record --out "$out/steady.mcap" --instance "$instance" &
steady=$!
$bench record --out "$out/stalled.mcap" --instance "$instance" &
stalled=$!
sleep 2
$bench run benchmarks/soak.toml --realtime --instance "$instance" --out "$out/own.mcap" 2>"$out/said" &
run=$!
while sleep 55 && kill -0 "$run" 2>/dev/null; do
  kill -STOP "$stalled" && sleep 5
  kill -CONT "$stalled"
done
wait "$run"
wait "$steady"
wait "$stalled"
grep -c 'overrun' "$out/said" | sed 's/$/ lines of the flight recorder on the terminal/' || true
$bench replay "$out/own.mcap"
