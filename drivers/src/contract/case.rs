//! A clause under way: the subject, and what is driven and compared on its behalf.

use super::{Clause, Cut, FarEnd, Subject, Violation};
use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, PERIOD_NS, Tick};

/// What was commanded is in force after so many ticks at most.
const OBEYED_TICKS: u64 = 200;

pub(super) const UNSEEN: &str = "expected a view of the rig, got none: exempt the subject, with the reason";

/// A free lever that the pump moves at once: every value changes from tick to tick.
pub(super) fn moving(tick: u64) -> Command {
    let voltage_v = if (tick / 200).is_multiple_of(2) { 10.0 } else { -10.0 };
    Command { voltage_v, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 }
}

pub(super) struct Case<'a, S: Subject> {
    pub(super) subject: &'a mut S,
    pub(super) clause: Clause,
    /// Values that were held against what the rig showed.
    pub(super) compared: u64,
}

impl<S: Subject> Case<'_, S> {
    pub(super) fn violation(&self, what: impl Into<String>) -> Violation {
        Violation { clause: self.clause, what: what.into() }
    }

    pub(super) fn open(&mut self, cut: Option<Cut>) -> Result<S::Device, Violation> {
        self.subject.open(cut).map_err(|error| self.violation(format!("expected a device, got: {error}")))
    }

    pub(super) fn sound<T>(&self, tick: u64, answer: Result<T, DeviceError>) -> Result<T, Violation> {
        answer.map_err(|error| self.violation(format!("tick {tick}, on sound wires: {error}")))
    }

    /// The command of each of these ticks is written, and what is read before it goes to `heard`.
    pub(super) fn drive(
        &mut self,
        device: &mut S::Device,
        ticks: impl Iterator<Item = u64>,
        mut heard: impl FnMut(&mut Self, Tick, &Measurement) -> Result<(), Violation>,
    ) -> Result<(), Violation> {
        for tick in ticks {
            let now = self.subject.wait(tick);
            let measured = self.sound(tick, device.read(now))?;
            let written = device.write(now, &moving(tick));
            self.sound(tick, written)?;
            heard(self, now, &measured)?;
        }
        Ok(())
    }

    /// One tick with these commands, on sound wires.
    pub(super) fn tick(&mut self, device: &mut S::Device, tick: u64, commands: &[Command]) -> Result<(), Violation> {
        let now = self.subject.wait(tick);
        let read = device.read(now);
        self.sound(tick, read)?;
        for command in commands {
            let written = device.write(now, command);
            self.sound(tick, written)?;
        }
        Ok(())
    }

    /// Ticks with this command until the rig has it in force.
    pub(super) fn until_in_force(
        &mut self,
        device: &mut S::Device,
        tick: &mut u64,
        command: Command,
    ) -> Result<(), Violation> {
        let near_v = self.subject.voltage_resolution_v();
        let mut seen = None;
        for _ in 0..OBEYED_TICKS {
            self.tick(device, *tick, &[command])?;
            *tick += 1;
            let far_end = self.subject.far_end().ok_or_else(|| self.violation(UNSEEN))?;
            let FarEnd { voltage_v, brake_open, bypass_open } = far_end;
            let obeys = (brake_open, bypass_open) == (command.brake_open, command.bypass_open);
            if obeys && (voltage_v - command.voltage_v).abs() <= near_v {
                return Ok(());
            }
            seen = Some(far_end);
        }
        Err(self.violation(format!("tick {tick}: expected {command:?} in force, the rig has {seen:?}")))
    }

    /// A reading against what the rig showed at the time that its age says.
    pub(super) fn is_true(&mut self, now: Tick, measured: &Measurement) -> Result<(), Violation> {
        for input in Input::ALL {
            let value = measured.value(input);
            let age_ns = u64::from(measured.age_ns[input as usize]);
            // A tick that was shown may have begun a little before or after the bench's.
            let Some(measured_ns) = now.scheduled_ns.checked_sub(age_ns).filter(|_| value.is_finite()) else {
                continue;
            };
            let (before, after) = (measured_ns / PERIOD_NS, measured_ns.div_ceil(PERIOD_NS));
            let (Some(before), Some(after)) = (self.subject.shown(before), self.subject.shown(after)) else { continue };
            let (a, b) = (before.value(input), after.value(input));
            let near = self.subject.resolution(input);
            self.compared += 1;
            if !(value >= a.min(b) - near && value <= a.max(b) + near) {
                let what = format!(
                    "tick {}, {}: {value} with an age of {age_ns} ns, when the rig showed {a} .. {b}",
                    now.index,
                    input.column()
                );
                return Err(self.violation(what));
            }
        }
        Ok(())
    }
}
