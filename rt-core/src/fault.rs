//! Faults that are injected where the loop meets its device: plain data. A profile says what happens when, a wrapper around any
//! device does it.
//!
//! A *frame* is a value of an input that the device gives anew. What a fault does is told at the device's boundary, where the loop
//! sees it, and it is what a sound driver would make of the same fault on its wire:
//!
//! | kind | at the boundary |
//! |---|---|
//! | `Lost` | the frame never comes: the value before it stays and its age grows |
//! | `Late` | the frame comes later, and is passed over where a newer one has come meanwhile |
//! | `Repeated` | in the place of the frame the one before it comes again |
//! | `Swapped` | the frame comes just after the one that follows it |
//! | `BitFlip` | one bit of the raw value is the other one, and no checksum has noticed |
//! | `CrcError` | the frame is refused: the value before it stays, its age grows, and at that tick the device calls the input wrong |
//! | `Stuck` | the value stays what it was, with the age of a fresh one |
//! | `Drift` | an offset is added that grows from 0 |
//! | `Nan` | the value is NaN |
//! | `PortGone` | the amplifier hears nothing: it keeps its voltage until its own time-out, then 0 V; its sign of life grows old; afterwards it stays at 0 V until it is armed |
//! | `BusOff` | nothing of CAN passes: all inputs grow old, and so does the sign of life; valves keep their command until the nodes time out into the safe state |
//! | `AmplifierFault` | the amplifier is at 0 V until it is armed, and a read fails with its code |
//! | `ValveStuck` | the valve does not follow its command |

use crate::types::Input;
use std::fmt;

/// Longest delay, ticks.
pub const MOST_DELAY_TICKS: u32 = 1000;
/// Most faults of a run: a driver's journal has room for the begin and the end of each.
pub const MOST_FAULTS: usize = 100;
/// Bits of a sensor's raw value.
pub const RAW_BITS: u8 = 16;
/// An amplifier's time-out where nothing is said, ticks.
pub const AMPLIFIER_TIMEOUT_TICKS: u32 = 100;
/// A valve node's time-out where nothing is said, ticks.
pub const NODE_TIMEOUT_TICKS: u32 = 50;

/// Something that goes wrong in a run, for a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fault {
    /// What goes wrong.
    pub kind: FaultKind,
    /// The first tick.
    pub from_tick: u64,
    /// For so many ticks, at least 1; `None` = to the end of the run.
    pub ticks: Option<u64>,
    /// Share of the frames that it hits, above 0 and up to 1; 1 for the kinds that hit no frames.
    pub probability: f64,
}

/// What can go wrong.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// Frames never arrive.
    Lost {
        /// Which ones.
        route: Route,
    },
    /// Frames arrive later.
    Late {
        /// Which ones.
        route: Route,
        /// Later by so many ticks, 1 ..= [`MOST_DELAY_TICKS`].
        ticks: u32,
        /// The driver can't tell (there is no counter in the frame): the value looks fresh when it comes. Inputs only.
        unnoticed: bool,
    },
    /// In the place of a frame the one before it comes again.
    Repeated {
        /// Of which sensor.
        input: Input,
        /// The driver can't tell: the old value looks fresh.
        unnoticed: bool,
    },
    /// A frame comes just after the one that follows it.
    Swapped {
        /// Of which sensor.
        input: Input,
        /// The driver can't tell: it takes the older one for the newer.
        unnoticed: bool,
    },
    /// A bit of the raw value flips: 0 .. 65535 over the sensor's range.
    BitFlip {
        /// Of which sensor.
        input: Input,
        /// Which bit, 0 (the least) .. 15; `None` = any, drawn for each frame.
        bit: Option<u8>,
        /// Value at raw 0, in the unit of the input.
        low: f64,
        /// Value at raw 65535, in the unit of the input, above `low`.
        high: f64,
    },
    /// Frames are refused by their checksum.
    CrcError {
        /// Of which sensor.
        input: Input,
    },
    /// The sensor shows what it showed.
    Stuck {
        /// Which one.
        input: Input,
    },
    /// The sensor's zero moves.
    Drift {
        /// Which one.
        input: Input,
        /// How fast, units of the input a second, not 0.
        per_s: f64,
    },
    /// The sensor says no number.
    Nan {
        /// Which one.
        input: Input,
    },
    /// The amplifier's port is gone.
    PortGone {
        /// The amplifier goes to 0 V by itself after so many ticks without a command.
        timeout_ticks: u32,
    },
    /// The bus is off.
    BusOff {
        /// The nodes put the valves into the safe state by themselves after so many ticks without a command.
        timeout_ticks: u32,
    },
    /// The amplifier reports a fault.
    AmplifierFault {
        /// Its code.
        code: u16,
    },
    /// A valve does not move.
    ValveStuck {
        /// Which one.
        valve: Valve,
        /// It stands open (`true`) or closed; `None` = as it stood.
        open: Option<bool>,
    },
}

/// What is on its way between loop and rig.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Route {
    /// A sensor's frames.
    Input(Input),
    /// Voltages to the amplifier.
    Voltage {
        /// It goes to 0 V by itself after so many ticks without a command.
        timeout_ticks: u32,
    },
    /// Commands to valves and fixture.
    Valves {
        /// The nodes go to the safe state by themselves after so many ticks without a command.
        timeout_ticks: u32,
    },
}

/// A valve of the rig.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Valve {
    /// In series with the pump.
    Brake,
    /// Parallel to the pump.
    Bypass,
}

/// A fault that can't be injected.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("fault {number} ({name}): {field} must be {expected}, got {got}")]
pub struct FaultError {
    /// Its place in the list, from 1.
    pub number: usize,
    /// Its kind.
    pub name: &'static str,
    /// Field of the fault.
    pub field: &'static str,
    /// What it must be.
    pub expected: String,
    /// What it is.
    pub got: f64,
}

impl FaultKind {
    /// As written in a profile.
    pub fn name(&self) -> &'static str {
        match self {
            FaultKind::Lost { .. } => "lost",
            FaultKind::Late { .. } => "late",
            FaultKind::Repeated { .. } => "repeated",
            FaultKind::Swapped { .. } => "swapped",
            FaultKind::BitFlip { .. } => "bit-flip",
            FaultKind::CrcError { .. } => "crc-error",
            FaultKind::Stuck { .. } => "stuck",
            FaultKind::Drift { .. } => "drift",
            FaultKind::Nan { .. } => "nan",
            FaultKind::PortGone { .. } => "port-gone",
            FaultKind::BusOff { .. } => "bus-off",
            FaultKind::AmplifierFault { .. } => "amplifier-fault",
            FaultKind::ValveStuck { .. } => "valve-stuck",
        }
    }

    /// The sensor that it hits, if it hits one.
    pub fn input(&self) -> Option<Input> {
        match *self {
            FaultKind::Lost { route: Route::Input(input) }
            | FaultKind::Late { route: Route::Input(input), .. }
            | FaultKind::Repeated { input, .. }
            | FaultKind::Swapped { input, .. }
            | FaultKind::BitFlip { input, .. }
            | FaultKind::CrcError { input }
            | FaultKind::Stuck { input }
            | FaultKind::Drift { input, .. }
            | FaultKind::Nan { input } => Some(input),
            _ => None,
        }
    }

    /// Whether it hits single frames, of which a share may be spared.
    pub fn hits_frames(&self) -> bool {
        match self {
            FaultKind::Lost { .. }
            | FaultKind::Late { .. }
            | FaultKind::Repeated { .. }
            | FaultKind::Swapped { .. }
            | FaultKind::BitFlip { .. }
            | FaultKind::CrcError { .. }
            | FaultKind::Nan { .. } => true,
            FaultKind::Stuck { .. }
            | FaultKind::Drift { .. }
            | FaultKind::PortGone { .. }
            | FaultKind::BusOff { .. }
            | FaultKind::AmplifierFault { .. }
            | FaultKind::ValveStuck { .. } => false,
        }
    }
}

impl Fault {
    /// Whether it acts at this tick.
    pub fn acts_at(&self, tick: u64) -> bool {
        tick >= self.from_tick && self.ticks.is_none_or(|ticks| tick - self.from_tick < ticks)
    }

    /// Whether its numbers are such that it can be injected; `number` is its place in the list, from 1.
    ///
    /// # Errors
    /// The first field that is out of its range.
    pub fn check(&self, number: usize) -> Result<(), FaultError> {
        let name = self.kind.name();
        let check = |valid: bool, field, expected: &str, got: f64| {
            if valid { Ok(()) } else { Err(FaultError { number, name, field, expected: expected.to_owned(), got }) }
        };
        let share = self.probability;
        check(share > 0.0 && share <= 1.0, "probability", "above 0 and up to 1", share)?;
        check(share == 1.0 || self.kind.hits_frames(), "probability", "1, as it hits no single frames", share)?;
        if let Some(ticks) = self.ticks {
            check(ticks > 0, "ticks", "at least 1", ticks as f64)?;
        }
        match self.kind {
            FaultKind::Late { route, ticks, unnoticed } => {
                let fits = (1..=MOST_DELAY_TICKS).contains(&ticks);
                check(fits, "ticks", &format!("a delay of 1 ..= {MOST_DELAY_TICKS}"), f64::from(ticks))?;
                let input = matches!(route, Route::Input(_));
                check(input || !unnoticed, "unnoticed", "0, as the rig hears commands by their counter", 1.0)
            }
            FaultKind::BitFlip { bit, low, high, .. } => {
                if let Some(bit) = bit {
                    check(bit < RAW_BITS, "bit", &format!("below {RAW_BITS}"), f64::from(bit))?;
                }
                check(low.is_finite(), "low", "a finite number", low)?;
                check(high.is_finite() && high > low, "high", &format!("a finite number above {low}"), high)
            }
            FaultKind::Drift { per_s, .. } => {
                check(per_s.is_finite() && per_s != 0.0, "per_s", "a finite number other than 0", per_s)
            }
            _ => Ok(()),
        }
    }
}

/// Range over which a sensor's raw value is taken to go where nothing is said, in the unit of the input.
pub fn full_scale(input: Input) -> (f64, f64) {
    match input {
        Input::Angle => (-180.0, 180.0),
        Input::Pressure1 | Input::Pressure2 => (0.0, 10.0),
        Input::Torque => (-100.0, 100.0),
        Input::Volume => (-500.0, 500.0),
    }
}

impl fmt::Display for Route {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Route::Input(input) => f.write_str(input.column()),
            Route::Voltage { .. } => f.write_str("the voltage's command"),
            Route::Valves { .. } => f.write_str("the valves' command"),
        }
    }
}

/// What goes wrong, without when.
impl fmt::Display for FaultKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let can_tell = |unnoticed| if unnoticed { ", unnoticed" } else { "" };
        write!(f, "{}: ", self.name())?;
        match self {
            FaultKind::Lost { route } => write!(f, "{route}"),
            FaultKind::Late { route, ticks, unnoticed } => write!(f, "{route} by {ticks} ms{}", can_tell(*unnoticed)),
            FaultKind::Repeated { input, unnoticed } | FaultKind::Swapped { input, unnoticed } => {
                write!(f, "{}{}", input.column(), can_tell(*unnoticed))
            }
            FaultKind::BitFlip { input, bit: Some(bit), low, high } => {
                write!(f, "{}, bit {bit} of {low} .. {high}", input.column())
            }
            FaultKind::BitFlip { input, bit: None, low, high } => {
                write!(f, "{}, any bit of {low} .. {high}", input.column())
            }
            FaultKind::CrcError { input } | FaultKind::Stuck { input } | FaultKind::Nan { input } => {
                f.write_str(input.column())
            }
            FaultKind::Drift { input, per_s } => write!(f, "{} by {per_s} a second", input.column()),
            FaultKind::PortGone { timeout_ticks } => write!(f, "amplifier, its time-out {timeout_ticks} ms"),
            FaultKind::BusOff { timeout_ticks } => write!(f, "CAN, time-out of the nodes {timeout_ticks} ms"),
            FaultKind::AmplifierFault { code } => write!(f, "code {code}"),
            FaultKind::ValveStuck { valve, open } => {
                let valve = match valve {
                    Valve::Brake => "brake",
                    Valve::Bypass => "bypass",
                };
                let stands = match open {
                    Some(true) => "open",
                    Some(false) => "closed",
                    None => "as it stands",
                };
                write!(f, "{valve} {stands}")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LOST: Fault = Fault {
        kind: FaultKind::Lost { route: Route::Input(Input::Angle) },
        from_tick: 10,
        ticks: Some(5),
        probability: 0.5,
    };

    #[test]
    fn it_acts_from_its_first_tick_for_its_length() {
        let acts = |fault: &Fault| (0..30).filter(|&tick| fault.acts_at(tick)).collect::<Vec<_>>();
        assert_eq!(acts(&LOST), [10, 11, 12, 13, 14]);
        assert_eq!(acts(&Fault { ticks: None, ..LOST }).len(), 20);
        assert!(Fault { ticks: Some(u64::MAX), ..LOST }.acts_at(u64::MAX - 1));
    }

    #[test]
    fn numbers_out_of_range_are_refused_by_name() {
        assert_eq!(LOST.check(1), Ok(()));
        let input = Input::Angle;
        let flip = |bit, low, high| FaultKind::BitFlip { input, bit, low, high };
        let late = |route, ticks, unnoticed| FaultKind::Late { route, ticks, unnoticed };
        let voltage = Route::Voltage { timeout_ticks: 100 };
        for (field, fault) in [
            ("probability", Fault { probability: 0.0, ..LOST }),
            ("probability", Fault { probability: f64::NAN, ..LOST }),
            ("probability", Fault { probability: 1.01, ..LOST }),
            ("probability", Fault { kind: FaultKind::Stuck { input }, ..LOST }),
            ("ticks", Fault { ticks: Some(0), ..LOST }),
            ("ticks", Fault { kind: late(voltage, 0, false), ..LOST }),
            ("ticks", Fault { kind: late(voltage, 1001, false), ..LOST }),
            ("unnoticed", Fault { kind: late(voltage, 3, true), ..LOST }),
            ("bit", Fault { kind: flip(Some(16), 0.0, 1.0), ..LOST }),
            ("low", Fault { kind: flip(None, f64::NAN, 1.0), ..LOST }),
            ("high", Fault { kind: flip(None, 1.0, 1.0), ..LOST }),
            ("per_s", Fault { kind: FaultKind::Drift { input, per_s: 0.0 }, probability: 1.0, ..LOST }),
        ] {
            let error = fault.check(7).expect_err(field);
            assert_eq!((error.number, error.field), (7, field), "{error}");
        }
    }
}
