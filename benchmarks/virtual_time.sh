#!/usr/bin/env bash
# A minute of the loop at 1 kHz, with publication and logger, on a machine of one processor in virtual time: not one deadline may be
# missed. Shows logic and instruction budget, not the latency of a real machine. Then the recording is replayed there.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
guest=drivers/tests/can-guest
# The machine is built by the script that runs it: a newer one builds it anew.
[ target/can-guest/initrd.gz -nt "$guest" ] || "$guest" prepare
cargo build --release --bin bench
# The progress bar is for people.
"$guest" run sh -c '
  target/release/bench run benchmarks/sixty_seconds.toml --realtime --require-rt --out /dev/shm/sixty.mcap 2>/dev/shm/said
  code=$?
  if [ $code -ne 0 ]; then tail -5 /dev/shm/said; exit $code; fi
  target/release/bench replay /dev/shm/sixty.mcap'
