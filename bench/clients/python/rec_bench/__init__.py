"""Samples of a running rec-bench, from shared memory.

    from rec_bench import Subscriber

    with Subscriber("bench") as subscriber:
        for sample in subscriber.run():
            print(sample.time_s, sample.angle_deg)
        print(subscriber.certificate())
"""

from .sample import (
    FLAGS,
    INPUTS,
    TARGETS,
    TRIP_BREACHES,
    TRIP_CHANNELS,
    VERSION,
    RecBenchSample,
    layout,
)
from .subscriber import Gap, LinkError, Silence, Subscriber, VersionMismatch

__all__ = [
    "FLAGS",
    "INPUTS",
    "TARGETS",
    "TRIP_BREACHES",
    "TRIP_CHANNELS",
    "VERSION",
    "Gap",
    "LinkError",
    "RecBenchSample",
    "Silence",
    "Subscriber",
    "VersionMismatch",
    "layout",
]
