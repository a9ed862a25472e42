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
    /// Number of the 1 ms period since the run's start, from 0. The loop may pass over periods; it never goes back.
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

/// A measured quantity. The number is its place in [`Measurement::age_ns`] and its bit in [`Measurement::faulty`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Input {
    /// Absolute encoder on the lever.
    Angle = 0,
    /// Chamber 1.
    Pressure1 = 1,
    /// Chamber 2.
    Pressure2 = 2,
    /// Torque on the clamp.
    Torque = 3,
    /// Measuring cylinder.
    Volume = 4,
}

impl Input {
    /// All of them, in the order of their numbers.
    pub const ALL: [Input; 5] = [Input::Angle, Input::Pressure1, Input::Pressure2, Input::Torque, Input::Volume];

    /// Its bit in a set of inputs.
    pub const fn bit(self) -> u32 {
        1 << self as usize
    }

    /// Name of its column, with the unit.
    pub fn column(self) -> &'static str {
        ["angle_deg", "pressure1_bar", "pressure2_bar", "torque_nm", "volume_ml"][self as usize]
    }
}

/// What the sensors said at a tick, and how far to trust it. `NaN` = this quantity was not measured at this tick.
///
/// Built with `..Measurement::NONE`, a value is fresh and sound.
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
    /// How old each value is at the tick, ns, by [`Input`]; 0 where the device measures at the tick itself,
    /// `u32::MAX` for 4.3 s and more.
    pub age_ns: [u32; 5],
    /// Values that the device itself calls wrong (a sensor's status, a failed checksum), as bits of [`Input`].
    pub faulty: u32,
    /// Age of the oldest sign of life among the device's drivers, ns; 0 where there is none to wait for.
    pub heartbeat_age_ns: u32,
}

impl Measurement {
    /// Nothing measured.
    pub const NONE: Measurement = Measurement {
        angle_deg: f64::NAN,
        pressure1_bar: f64::NAN,
        pressure2_bar: f64::NAN,
        torque_nm: f64::NAN,
        volume_ml: f64::NAN,
        age_ns: [0; 5],
        faulty: 0,
        heartbeat_age_ns: 0,
    };

    /// The value of an input, in its unit.
    pub fn value(&self, input: Input) -> f64 {
        match input {
            Input::Angle => self.angle_deg,
            Input::Pressure1 => self.pressure1_bar,
            Input::Pressure2 => self.pressure2_bar,
            Input::Torque => self.torque_nm,
            Input::Volume => self.volume_ml,
        }
    }

    /// Whether there is a value that the device does not call wrong.
    pub fn is_valid(&self, input: Input) -> bool {
        self.value(input).is_finite() && self.faulty & input.bit() == 0
    }

    /// The valid inputs, as bits of [`Input`].
    pub fn valid(&self) -> u32 {
        Input::ALL.iter().filter(|&&input| self.is_valid(input)).fold(0, |bits, input| bits | input.bit())
    }
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

impl Fixture {
    /// What is left of the operator's part when the rig goes safe: nothing is moved or drained any more, but no clamp opens
    /// by itself.
    pub fn at_rest(self) -> Fixture {
        match self {
            Fixture::Free | Fixture::PumpBench { .. } => self,
            Fixture::Clamped { angle_deg }
            | Fixture::Driven { angle_deg }
            | Fixture::Filled { angle_deg, .. }
            | Fixture::Released { angle_deg, .. } => Fixture::Clamped { angle_deg },
        }
    }
}

/// How the valves stand in the safe state; the pump is at 0 V in any. A setting of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SafeState {
    /// Valve in series with the pump.
    pub brake_open: bool,
    /// Valve parallel to the pump.
    pub bypass_open: bool,
}

impl Default for SafeState {
    /// Brake closed, bypass open: the pump is cut off and the chambers are level.
    fn default() -> Self {
        SafeState { brake_open: false, bypass_open: true }
    }
}

impl SafeState {
    /// The safe command after one that had this fixture and segment.
    pub fn command(self, fixture: Fixture, segment: u32) -> Command {
        let SafeState { brake_open, bypass_open } = self;
        Command { voltage_v: 0.0, brake_open, bypass_open, fixture: fixture.at_rest(), segment }
    }
}

/// Version of [`Sample`]'s layout; a subscriber refuses another.
pub const SAMPLE_VERSION: u32 = 2;

/// One tick as it is published. Fixed size, versioned; the type name is part of the service's contract with other
/// languages. Durations of 4.3 s and more read `u32::MAX`.
#[derive(Clone, Copy, Debug, PartialEq, ZeroCopySend)]
#[repr(C)]
#[type_name("RecBenchSample")]
pub struct Sample {
    /// [`SAMPLE_VERSION`].
    pub version: u32,
    /// Number of the run within the service's life; samples of different runs share the service.
    pub run: u32,
    /// Tick number, from 0: the number of the period. Gaps only where `skipped` grows.
    pub tick: u64,
    /// Scheduled time since the run's start, ns.
    pub scheduled_ns: u64,
    /// `CLOCK_MONOTONIC` at the wake-up, ns; 0 in virtual time.
    pub woken_ns: u64,
    /// Wake-up later than scheduled by, ns (0 in virtual time).
    pub lateness_ns: u64,
    /// Ticks of this run that were passed over up to here, because those before them took too long.
    pub skipped: u64,
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
    /// Age of each measured value at the tick, ns, in the order of [`Input`].
    pub age_ns: [u32; 5],
    /// Age of the oldest sign of life among the device's drivers, ns.
    pub heartbeat_age_ns: u32,
    /// Part of the lateness that earlier ticks caused: the loop itself came late to its wait, ns.
    pub behind_ns: u32,
    /// Duration of the stage "read inputs", ns. This and the other stages: 0 in virtual time.
    pub read_ns: u32,
    /// Duration of the supervisor's check, ns.
    pub check_ns: u32,
    /// Duration of the reference (profile), ns.
    pub reference_ns: u32,
    /// Duration of the controller, with the supervisor's release of its command, ns.
    pub control_ns: u32,
    /// Duration of the stage "write outputs", ns.
    pub write_ns: u32,
    /// Duration of the hand-over at the tick before this one, ns.
    pub publish_ns: u32,
    /// Segment of the protocol.
    pub segment: u32,
    /// Active step of the profile, counted through its unrolled loops from 0.
    pub step: u32,
    /// Bits: see [`flags`].
    pub flags: u32,
    /// Bits of [`Input`]: 0..5 valid values; shifted by 8: values that the device itself calls wrong.
    pub quality: u32,
    /// Why the supervisor tripped: 0 = it has not, otherwise [`Trip::code`](crate::supervisor::Trip::code).
    pub trip: u32,
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
    /// The tick before this one ended after this one, or one before it, should have begun.
    pub const OVERRUN: u32 = 1 << 5;
    /// Somebody asked for a stop: the command is the safe state.
    pub const STOPPED: u32 = 1 << 6;
    /// The supervisor let the voltage follow no faster than its slew limit.
    pub const SLEW_LIMITED: u32 = 1 << 7;
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

    /// The tick before this one ended too late.
    pub fn overrun(&self) -> bool {
        self.flags & flags::OVERRUN != 0
    }

    /// Seconds since the run's start.
    pub fn time_s(&self) -> f64 {
        self.scheduled_ns as f64 * 1e-9
    }

    /// Number of this sample within its run: the ticks that were run before it. Loss is seen by gaps of this number.
    pub fn sequence(&self) -> u64 {
        self.tick.saturating_sub(self.skipped)
    }

    /// The measurement that this sample carries, as the device gave it.
    pub fn measurement(&self) -> Measurement {
        Measurement {
            angle_deg: self.angle_deg,
            pressure1_bar: self.pressure1_bar,
            pressure2_bar: self.pressure2_bar,
            torque_nm: self.torque_nm,
            volume_ml: self.volume_ml,
            age_ns: self.age_ns,
            faulty: self.quality >> 8,
            heartbeat_age_ns: self.heartbeat_age_ns,
        }
    }

    /// From wake-up to the last stage before publication, ns.
    pub fn execution_ns(&self) -> u64 {
        [self.read_ns, self.check_ns, self.reference_ns, self.control_ns, self.write_ns].map(u64::from).iter().sum()
    }

    /// A sample in which nothing is set but the version and nothing is measured. For readers and tests.
    pub const BLANK: Sample = Sample {
        version: SAMPLE_VERSION,
        run: 0,
        tick: 0,
        scheduled_ns: 0,
        woken_ns: 0,
        lateness_ns: 0,
        skipped: 0,
        voltage_v: 0.0,
        angle_deg: f64::NAN,
        pressure1_bar: f64::NAN,
        pressure2_bar: f64::NAN,
        torque_nm: f64::NAN,
        volume_ml: f64::NAN,
        age_ns: [0; 5],
        heartbeat_age_ns: 0,
        behind_ns: 0,
        read_ns: 0,
        check_ns: 0,
        reference_ns: 0,
        control_ns: 0,
        write_ns: 0,
        publish_ns: 0,
        segment: 0,
        step: 0,
        flags: 0,
        quality: 0,
        trip: 0,
    };
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::mem::{align_of, offset_of, size_of};

    /// The layout is a contract with subscribers in other languages and with recordings: changing it is a new
    /// [`SAMPLE_VERSION`].
    #[test]
    fn layout_of_version_2() {
        assert_eq!(SAMPLE_VERSION, 2);
        assert_eq!((size_of::<Sample>(), align_of::<Sample>()), (168, 8));
        let offsets = [
            ("version", offset_of!(Sample, version), 0),
            ("run", offset_of!(Sample, run), 4),
            ("tick", offset_of!(Sample, tick), 8),
            ("scheduled_ns", offset_of!(Sample, scheduled_ns), 16),
            ("woken_ns", offset_of!(Sample, woken_ns), 24),
            ("lateness_ns", offset_of!(Sample, lateness_ns), 32),
            ("skipped", offset_of!(Sample, skipped), 40),
            ("voltage_v", offset_of!(Sample, voltage_v), 48),
            ("angle_deg", offset_of!(Sample, angle_deg), 56),
            ("pressure1_bar", offset_of!(Sample, pressure1_bar), 64),
            ("pressure2_bar", offset_of!(Sample, pressure2_bar), 72),
            ("torque_nm", offset_of!(Sample, torque_nm), 80),
            ("volume_ml", offset_of!(Sample, volume_ml), 88),
            ("age_ns", offset_of!(Sample, age_ns), 96),
            ("heartbeat_age_ns", offset_of!(Sample, heartbeat_age_ns), 116),
            ("behind_ns", offset_of!(Sample, behind_ns), 120),
            ("read_ns", offset_of!(Sample, read_ns), 124),
            ("check_ns", offset_of!(Sample, check_ns), 128),
            ("reference_ns", offset_of!(Sample, reference_ns), 132),
            ("control_ns", offset_of!(Sample, control_ns), 136),
            ("write_ns", offset_of!(Sample, write_ns), 140),
            ("publish_ns", offset_of!(Sample, publish_ns), 144),
            ("segment", offset_of!(Sample, segment), 148),
            ("step", offset_of!(Sample, step), 152),
            ("flags", offset_of!(Sample, flags), 156),
            ("quality", offset_of!(Sample, quality), 160),
            ("trip", offset_of!(Sample, trip), 164),
        ];
        for (field, offset, documented) in offsets {
            assert_eq!(offset, documented, "offset of {field}");
        }
        use flags::*;
        let bits = [BRAKE_OPEN, BYPASS_OPEN, TRIPPED, LAST, FAULT, OVERRUN, STOPPED, SLEW_LIMITED];
        assert_eq!(bits, [1, 2, 4, 8, 16, 32, 64, 128]);
        // SAFETY: the function reads no data; it is unsafe only because the trait's implementor vouches for the name.
        assert_eq!(unsafe { Sample::type_name() }, "RecBenchSample");
    }

    #[test]
    fn a_value_is_valid_when_it_is_there_and_not_called_wrong() {
        let measured = Measurement {
            angle_deg: 1.0,
            pressure1_bar: 2.0,
            faulty: Input::Pressure1.bit() | Input::Torque.bit(),
            ..Measurement::NONE
        };
        assert_eq!(measured.valid(), Input::Angle.bit());
        for (number, input) in Input::ALL.into_iter().enumerate() {
            assert_eq!(input as usize, number);
        }
    }
}
