"""Writes every sample of a run to CSV, for plots: `python examples/to_csv.py --out run.csv [--instance NAME]`.

Then, for instance: `pandas.read_csv("run.csv").plot("time_s", ["angle_deg", "target"])`. For measurements use the bench's own recording,
which is certified and complete; `bench export` makes CSV of it.
"""

import argparse
import csv
import math
import sys

from rec_bench import Subscriber

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--instance", default="bench")
parser.add_argument("--out", required=True)
parser.add_argument("--timeout-s", type=float, help="end with an error when no sample comes for so long")
arguments = parser.parse_args()

COLUMNS = ["voltage_v", "angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml", "target"]

# "x": a file that is there is never overwritten.
with Subscriber(arguments.instance) as subscriber, open(arguments.out, "x", newline="") as file:
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(["time_s", *COLUMNS, "target_of", "brake_open", "bypass_open", "segment"])
    for sample in subscriber.run(arguments.timeout_s):
        values = [getattr(sample, name) for name in COLUMNS]
        writer.writerow(
            [
                repr(sample.time_s),
                *("" if math.isnan(value) else repr(value) for value in values),
                sample.target_of,
                int(sample.has("brake_open")),
                int(sample.has("bypass_open")),
                sample.segment,
            ]
        )
    print(subscriber.certificate())
    # As `bench` does where samples were lost.
    sys.exit(6 if subscriber.gaps else 0)
