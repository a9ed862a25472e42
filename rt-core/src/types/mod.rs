//! The values that cross the loop's boundaries: what the sensors say, what the actuators are told,
//! and the sample that is published for every tick.
//!
//! Sign convention: `angle` > 0 expands chamber 1, `voltage` > 0 drives oil from chamber 2 through the pump into
//! chamber 1, pressures are absolute. Units stand in the names. A value that was not measured is `NaN`.

mod sample;
mod target_kind;

pub use sample::{BeyondRange, SAMPLE_VERSION, Sample, flags};
pub use target_kind::TargetKind;

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

    /// The same to be changed.
    pub fn value_mut(&mut self, input: Input) -> &mut f64 {
        match input {
            Input::Angle => &mut self.angle_deg,
            Input::Pressure1 => &mut self.pressure1_bar,
            Input::Pressure2 => &mut self.pressure2_bar,
            Input::Torque => &mut self.torque_nm,
            Input::Volume => &mut self.volume_ml,
        }
    }

    /// The same where an infinite value is none, and called wrong: nothing measures infinity, and no recording holds it.
    pub fn without_infinities(mut self) -> Measurement {
        for input in Input::ALL {
            if self.value(input).is_infinite() {
                *self.value_mut(input) = f64::NAN;
                self.faulty |= input.bit();
            }
        }
        self
    }

    /// The same where a value that the device calls wrong is none: for whoever decides by values alone.
    pub fn without_faulty(mut self) -> Measurement {
        for input in Input::ALL {
            if self.faulty & input.bit() != 0 {
                *self.value_mut(input) = f64::NAN;
            }
        }
        self
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_infinite_value_is_none_and_called_wrong() {
        for input in Input::ALL {
            for infinite in [f64::INFINITY, f64::NEG_INFINITY] {
                let mut measured = Measurement { angle_deg: 1.0, torque_nm: f64::MAX, ..Measurement::NONE };
                *measured.value_mut(input) = infinite;
                let others = measured.valid();
                let seen = measured.without_infinities();
                assert!(seen.value(input).is_nan() && !seen.is_valid(input));
                assert_eq!((seen.faulty, seen.valid()), (input.bit(), others), "the others are as they were");
            }
        }
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
        let sound = measured.without_faulty();
        assert!(sound.pressure1_bar.is_nan() && sound.angle_deg == 1.0 && sound.faulty == measured.faulty);
        for (number, input) in Input::ALL.into_iter().enumerate() {
            assert_eq!(input as usize, number);
        }
    }
}
