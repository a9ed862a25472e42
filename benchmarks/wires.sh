#!/usr/bin/env bash
# A short campaign over wires in a machine of one processor in virtual time: `bench emulate` behind a pty and on vcan0, `bench campaign`
# with the very drivers of a real rig at the other end. Not one tick may be late. Then the same profiles in process, and the parameters
# identified from both must agree within three standard errors.
#
#   benchmarks/wires.sh [vesc|tmcl]
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
protocol=${1:-vesc}
guest=drivers/tests/can-guest
out=${CAN_GUEST_OUT:-${CAN_GUEST_DIR:-target/can-guest}/out}
# In the order in which each needs the results of the one before.
profiles=()
for name in torque_map volume_map pump_map clamp_steps constant_flow square_a random_a random_b; do
  profiles+=("benchmarks/wires/$name.toml")
done

# The machine is built by the script that runs it: a newer one builds it anew.
[ "${CAN_GUEST_DIR:-target/can-guest}/initrd.gz" -nt "$guest" ] || "$guest" prepare
cargo build --release --bin bench
rm -rf "$out/wires"
# A processor of 500 million instructions a second.
CAN_GUEST_SHIFT=1 CAN_GUEST_LIMIT_S=${CAN_GUEST_LIMIT_S:-1800} "$guest" run sh -c '
  protocol=$1
  shift
  target/release/bench emulate --serial /dev/shm/amplifier --can vcan0 --protocol "$protocol" --write-rig /dev/shm/rig \
    >/dev/shm/emulated 2>&1 &
  emulator=$!
  while [ ! -e /dev/shm/amplifier ] || [ ! -e /dev/shm/rig/rig.toml ]; do sleep 0.1; done
  target/release/bench campaign "$@" --rig /dev/shm/rig/rig.toml --realtime --require-rt --out /dev/shm/wires 2>/dev/shm/said
  code=$?
  kill $emulator
  wait $emulator
  if [ $code -ne 0 ]; then tail -n 20 /dev/shm/said; tail -n 20 /dev/shm/emulated; fi
  cp -r /dev/shm/wires "$CAN_GUEST_OUT/"
  exit $code' sh "$protocol" "${profiles[@]}"

compared=$(mktemp -d)
trap 'rm -rf "$compared"' EXIT
# Another seed: other noise, as the comparison of two campaigns assumes.
target/release/bench campaign "${profiles[@]}" --out "$compared/in_process" --seed 2
target/release/bench identify "$out/wires" --out "$compared/wires.out"
target/release/bench identify "$compared/in_process" --out "$compared/in_process.out"
target/release/bench compare "$compared/wires.out/model.toml" "$compared/in_process.out/model.toml"
