"""Prints some values of a run as it goes: `python examples/print_values.py [--instance NAME] [--every MS] [--count N]`."""

import argparse

from rec_bench import Subscriber

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--instance", default="bench")
parser.add_argument("--every", type=int, default=100, help="ticks between two lines")
parser.add_argument("--count", type=int, help="end after so many lines")
parser.add_argument("--timeout-s", type=float, help="end with an error when no sample comes for so long")
arguments = parser.parse_args()

with Subscriber(arguments.instance) as subscriber:
    lines, next_tick = 0, 0
    for sample in subscriber.run(arguments.timeout_s):
        if sample.tick < next_tick and not sample.last:
            continue
        next_tick = sample.tick + arguments.every
        asked = "" if sample.asked_for is None else "asked for {:.3f} {} ({})".format(*sample.asked_for[::2], sample.asked_for[1])
        print(
            f"{sample.time_s:9.3f} s  {sample.voltage_v:7.2f} V  {sample.angle_deg:8.3f} deg  "
            f"{sample.pressure1_bar:6.3f} bar  {sample.pressure2_bar:6.3f} bar  {asked}",
            flush=True,
        )
        if sample.trip_text is not None:
            print(f"tripped: {sample.trip_text}", flush=True)
        lines += 1
        if lines == arguments.count:
            break
    print(subscriber.certificate())
