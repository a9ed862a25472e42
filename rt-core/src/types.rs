//! The values that cross the loop's boundaries: what the sensors say, what the actuators are told,
//! and the sample that is published for every tick.
//!
//! Sign convention: `angle` > 0 expands chamber 1, `voltage` > 0 drives oil from chamber 2 through the pump into
//! chamber 1, pressures are absolute. Units stand in the names. A value that was not measured is `NaN`.

use iceoryx2::prelude::ZeroCopySend;

/// Period of the loop, nanoseconds (1 kHz).
pub const PERIOD_NS: u64 = 1_000_000;

/// A tick of the loop. The only notion of time inside a step: no step reads a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Counts from 0 at the run's start, without gaps.
    pub index: u64,
    /// Scheduled time since the run's start, nanoseconds.
    pub scheduled_ns: u64,
}

impl Tick {
    /// The tick with this index at the loop's fixed period.
    pub fn at(index: u64) -> Self {
        Tick { index, scheduled_ns: index * PERIOD_NS }
    }

    /// Scheduled time since the run's start, seconds.
    pub fn seconds(&self) -> f64 {
        self.scheduled_ns as f64 * 1e-9
    }
}

/// What the sensors said at a tick. `NaN` = this channel was not measured at this tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measurement {
    /// Absolute encoder on the lever, degrees.
    pub angle_deg: f64,
    /// Chamber 1, bar absolute (on the pump bench: port 1, discharge for u > 0).
    pub pressure1_bar: f64,
    /// Chamber 2, bar absolute (on the pump bench: port 2).
    pub pressure2_bar: f64,
    /// Torque that the clamp holds, Nm; `NaN` while the lever moves.
    pub torque_nm: f64,
    /// Measuring cylinder, ml; `NaN` where it was not read.
    pub volume_ml: f64,
}

impl Measurement {
    /// Nothing measured.
    pub const NONE: Measurement = Measurement {
        angle_deg: f64::NAN,
        pressure1_bar: f64::NAN,
        pressure2_bar: f64::NAN,
        torque_nm: f64::NAN,
        volume_ml: f64::NAN,
    };
}

/// What holds the lever and what the chambers are connected to: the operator's part of an experiment. On a real rig
/// the operator is asked for it; the emulated rig does it by itself.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fixture {
    /// The lever is free; the plane decides whether gravity acts.
    Free,
    /// The lever is held at this angle (degrees) and the force sensor reads.
    Clamped {
        /// Angle of the lever, degrees.
        angle_deg: f64,
    },
    /// The lever is led to this angle (degrees) by an external torque; the force sensor does not read.
    Driven {
        /// Angle of the lever, degrees.
        angle_deg: f64,
    },
    /// The lever is held at this angle (degrees) while the chambers are filled or drained to these pressures (bar
    /// absolute); afterwards the amount of oil in chamber 1 is known (`volume_ml` = oil in chamber 1).
    Filled {
        /// Angle of the lever, degrees.
        angle_deg: f64,
        /// Chamber 1, bar absolute.
        pressure1_bar: f64,
        /// Chamber 2, bar absolute.
        pressure2_bar: f64,
    },
    /// The lever is held while oil flows out of chamber 1 into the measuring cylinder at this rate (ml/s); `volume_ml` =
    /// released so far since the last `Filled`, read while the rate is 0.
    Released {
        /// Angle of the lever, degrees.
        angle_deg: f64,
        /// Oil out of chamber 1, ml/s.
        flow_ml_s: f64,
    },
    /// The pump is taken out and runs between two reservoirs at these pressures (bar absolute); `volume_ml` =
    /// delivered so far in this segment, positive in the direction of u.
    PumpBench {
        /// Reservoir at port 1, bar absolute.
        pressure1_bar: f64,
        /// Reservoir at port 2, bar absolute.
        pressure2_bar: f64,
    },
}

/// What the loop tells the rig for one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Command {
    /// Command to the motor amplifier, V.
    pub voltage_v: f64,
    /// Valve in series with the pump: open = oil can pass.
    pub brake_open: bool,
    /// Valve parallel to the pump: open = chambers are connected.
    pub bypass_open: bool,
    /// The operator's part.
    pub fixture: Fixture,
    /// Counts the set points of the protocol; a device may restart a measuring cylinder on a new one.
    pub segment: u32,
}

impl Command {
    /// The safe state: pump at 0, brake closed, bypass open, lever free.
    pub const SAFE: Command =
        Command { voltage_v: 0.0, brake_open: false, bypass_open: true, fixture: Fixture::Free, segment: 0 };
}

/// Version of [`Sample`]'s layout; a subscriber refuses another.
pub const SAMPLE_VERSION: u32 = 1;

/// One tick as it is published. Fixed size, versioned; the type name is part of the service's contract with other
/// languages.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchSample")]
pub struct Sample {
    /// [`SAMPLE_VERSION`].
    pub version: u32,
    /// Number of the run within the service's life; samples of different runs share the service.
    pub run: u32,
    /// Tick number, from 0, without gaps.
    pub tick: u64,
    /// Scheduled time since the run's start, ns.
    pub scheduled_ns: u64,
    /// Wake-up later than scheduled by, ns (0 in virtual time).
    pub lateness_ns: u64,
    /// Age of the input, ns (0 where the device measures at the tick itself).
    pub input_age_ns: u64,
    /// Command, V.
    pub voltage_v: f64,
    /// Measured angle, degrees; NaN = not measured.
    pub angle_deg: f64,
    /// Measured pressure, bar absolute; NaN = not measured.
    pub pressure1_bar: f64,
    /// Measured pressure, bar absolute; NaN = not measured.
    pub pressure2_bar: f64,
    /// Measured torque, Nm; NaN = not measured.
    pub torque_nm: f64,
    /// Measured volume, ml; NaN = not measured.
    pub volume_ml: f64,
    /// Segment of the protocol.
    pub segment: u32,
    /// Bits: see [`flags`].
    pub flags: u32,
}

/// Bits of [`Sample::flags`].
pub mod flags {
    /// The brake valve is commanded open.
    pub const BRAKE_OPEN: u32 = 1 << 0;
    /// The bypass valve is commanded open.
    pub const BYPASS_OPEN: u32 = 1 << 1;
    /// The supervisor has tripped: the command is the safe state.
    pub const TRIPPED: u32 = 1 << 2;
    /// Last sample of its run.
    pub const LAST: u32 = 1 << 3;
    /// The device failed within this tick: the sample holds no measurement, and the safe state was ordered.
    pub const FAULT: u32 = 1 << 4;
}

impl Sample {
    /// Brake valve commanded open.
    pub fn brake_open(&self) -> bool {
        self.flags & flags::BRAKE_OPEN != 0
    }

    /// Bypass valve commanded open.
    pub fn bypass_open(&self) -> bool {
        self.flags & flags::BYPASS_OPEN != 0
    }

    /// The run's last sample.
    pub fn last(&self) -> bool {
        self.flags & flags::LAST != 0
    }

    /// The supervisor has tripped.
    pub fn tripped(&self) -> bool {
        self.flags & flags::TRIPPED != 0
    }

    /// The device failed within this tick.
    pub fn fault(&self) -> bool {
        self.flags & flags::FAULT != 0
    }

    /// Seconds since the run's start.
    pub fn time_s(&self) -> f64 {
        self.scheduled_ns as f64 * 1e-9
    }
}

/// A sample in which nothing is set but the version.
#[cfg(test)]
pub(crate) fn blank_sample() -> Sample {
    Sample {
        version: SAMPLE_VERSION,
        run: 0,
        tick: 0,
        scheduled_ns: 0,
        lateness_ns: 0,
        input_age_ns: 0,
        voltage_v: 0.0,
        angle_deg: 0.0,
        pressure1_bar: 0.0,
        pressure2_bar: 0.0,
        torque_nm: 0.0,
        volume_ml: 0.0,
        segment: 0,
        flags: 0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    /// The layout is a contract with subscribers in other languages and with recordings: changing it is a new
    /// [`SAMPLE_VERSION`].
    #[test]
    fn layout_of_version_1() {
        assert_eq!(SAMPLE_VERSION, 1);
        assert_eq!((size_of::<Sample>(), align_of::<Sample>()), (96, 8));
        let offsets = [
            ("version", offset_of!(Sample, version), 0),
            ("run", offset_of!(Sample, run), 4),
            ("tick", offset_of!(Sample, tick), 8),
            ("scheduled_ns", offset_of!(Sample, scheduled_ns), 16),
            ("lateness_ns", offset_of!(Sample, lateness_ns), 24),
            ("input_age_ns", offset_of!(Sample, input_age_ns), 32),
            ("voltage_v", offset_of!(Sample, voltage_v), 40),
            ("angle_deg", offset_of!(Sample, angle_deg), 48),
            ("pressure1_bar", offset_of!(Sample, pressure1_bar), 56),
            ("pressure2_bar", offset_of!(Sample, pressure2_bar), 64),
            ("torque_nm", offset_of!(Sample, torque_nm), 72),
            ("volume_ml", offset_of!(Sample, volume_ml), 80),
            ("segment", offset_of!(Sample, segment), 88),
            ("flags", offset_of!(Sample, flags), 92),
        ];
        for (field, offset, documented) in offsets {
            assert_eq!(offset, documented, "offset of {field}");
        }
        assert_eq!(
            (flags::BRAKE_OPEN, flags::BYPASS_OPEN, flags::TRIPPED, flags::LAST, flags::FAULT),
            (1, 2, 4, 8, 16)
        );
        // SAFETY: the function reads no data; it is unsafe only because the trait's implementor vouches for the name.
        assert_eq!(unsafe { Sample::type_name() }, "RecBenchSample");
    }
}
