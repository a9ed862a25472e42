"""The sample that the loop publishes for every tick, as it lies in shared memory.

Layout and names are those of `rt_core::Sample`; a test of the bench compares every offset, and every value of a run.
"""

import ctypes
import math

#: Version of the layout.
VERSION = 3

#: Bits of `flags`, by name.
FLAGS = {
    "brake_open": 1 << 0,
    "bypass_open": 1 << 1,
    "tripped": 1 << 2,
    "last": 1 << 3,
    "fault": 1 << 4,
    "overrun": 1 << 5,
    "stopped": 1 << 6,
    "slew_limited": 1 << 7,
    "waiting": 1 << 8,
    "confirmed": 1 << 9,
}

#: Measured values, in the order of `age_ns` and of the bits of `quality`.
INPUTS = ("angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml")

#: What `target` is of, by `target_of`: name and unit. 0 = there is none.
TARGETS = {
    1: ("voltage", "V"),
    2: ("flow", "ml/s"),
    3: ("pressure of chamber 1", "bar"),
    4: ("pressure of chamber 2", "bar"),
    5: ("pressure difference", "bar"),
    6: ("angle", "deg"),
}

#: Why the supervisor tripped: the low byte of `trip` ...
TRIP_CHANNELS = {
    1: "pressure 1",
    2: "pressure 2",
    3: "angle",
    4: "velocity",
    5: "torque",
    6: "voltage",
    7: "heartbeat of the drivers",
    8: "deadline",
    9: "emergency stop",
}

#: ... and the next one.
TRIP_BREACHES = {1: "below", 2: "above", 3: "not finite", 4: "missing", 5: "stale", 6: "demanded"}


class RecBenchSample(ctypes.Structure):
    """One tick. Units stand in the names; a value that was not measured is NaN."""

    _fields_ = [
        ("version", ctypes.c_uint32),
        ("run", ctypes.c_uint32),
        ("tick", ctypes.c_uint64),
        ("scheduled_ns", ctypes.c_uint64),
        ("woken_ns", ctypes.c_uint64),
        ("lateness_ns", ctypes.c_uint64),
        ("skipped", ctypes.c_uint64),
        ("voltage_v", ctypes.c_double),
        ("angle_deg", ctypes.c_double),
        ("pressure1_bar", ctypes.c_double),
        ("pressure2_bar", ctypes.c_double),
        ("torque_nm", ctypes.c_double),
        ("volume_ml", ctypes.c_double),
        ("age_ns", ctypes.c_uint32 * 5),
        ("heartbeat_age_ns", ctypes.c_uint32),
        ("behind_ns", ctypes.c_uint32),
        ("read_ns", ctypes.c_uint32),
        ("check_ns", ctypes.c_uint32),
        ("reference_ns", ctypes.c_uint32),
        ("control_ns", ctypes.c_uint32),
        ("write_ns", ctypes.c_uint32),
        ("publish_ns", ctypes.c_uint32),
        ("segment", ctypes.c_uint32),
        ("step", ctypes.c_uint32),
        ("flags", ctypes.c_uint32),
        ("quality", ctypes.c_uint32),
        ("trip", ctypes.c_uint32),
        ("target", ctypes.c_double),
        ("target_of", ctypes.c_uint32),
        ("reserved", ctypes.c_uint32),
    ]

    @staticmethod
    def type_name():
        """Name of the type in the service; part of the contract with the publisher."""
        return "RecBenchSample"

    @property
    def time_s(self):
        """Scheduled time since the run's start, s."""
        return self.scheduled_ns * 1e-9

    @property
    def sequence(self):
        """Number of the sample within its run, from 0. A gap of this number is a loss; ticks that the loop skipped are none."""
        return self.tick - self.skipped

    def has(self, flag):
        """Whether the flag of this name (see `FLAGS`) is set."""
        return bool(self.flags & FLAGS[flag])

    @property
    def last(self):
        """The run's last sample."""
        return self.has("last")

    def is_valid(self, name):
        """Whether the measured value of this name (see `INPUTS`) is there and not called wrong by its device."""
        return bool(self.quality & 1 << INPUTS.index(name))

    def age_ms(self, name):
        """Age of the measured value of this name at the tick, ms; None where there is none, infinite from 4.3 s on."""
        if math.isnan(getattr(self, name)):
            return None
        age_ns = self.age_ns[INPUTS.index(name)]
        return math.inf if age_ns == 0xFFFFFFFF else age_ns * 1e-6

    @property
    def asked_for(self):
        """What the profile asks for: value, name and unit; None where it asks for nothing."""
        if self.target_of not in TARGETS:
            return None
        return (self.target, *TARGETS[self.target_of])

    @property
    def trip_text(self):
        """Why the supervisor tripped; None where it has not."""
        if self.trip == 0:
            return None
        channel = TRIP_CHANNELS.get(self.trip & 0xFF, "?")
        return f"{channel}: {TRIP_BREACHES.get(self.trip >> 8, '?')}"

    def as_dict(self):
        """Every field by its name; `age_ns` as a list."""
        values = {name: getattr(self, name) for name, _ in self._fields_}
        values["age_ns"] = list(self.age_ns)
        return values


def layout():
    """What a publisher must agree with."""
    fields = {
        name: {"offset": getattr(RecBenchSample, name).offset, "size": getattr(RecBenchSample, name).size}
        for name, _ in RecBenchSample._fields_
    }
    return {
        "type_name": RecBenchSample.type_name(),
        "version": VERSION,
        "size": ctypes.sizeof(RecBenchSample),
        "alignment": ctypes.alignment(RecBenchSample),
        "fields": fields,
        "flags": FLAGS,
        "inputs": list(INPUTS),
        "targets": [[code, *names] for code, names in TARGETS.items()],
        "trip_channels": [[code, name] for code, name in TRIP_CHANNELS.items()],
    }
