//! What every device of the loop owes it, as functions that test a device: the emulated rig, the wired rig against an emulated one,
//! a wrapper, your own.
//!
//! A test implements [`Subject`] for a device with what is at its far end, and calls [`check`]. What a device can't be tested for, its
//! subject says with the reason ([`Subject::exempt`]).
//!
//! | clause | |
//! |---|---|
//! | [`Clause::Freshness`] | a value is as old as its age says, and no older than the wires make it |
//! | [`Clause::Ordering`] | no value is followed by an older one; ticks may be passed over |
//! | [`Clause::TimeOuts`] | what is silent grows old or fails, and nothing is invented |
//! | [`Clause::LastCommand`] | of several commands the last counts |
//! | [`Clause::SafeOnDrop`] | a device that is dropped leaves 0 V and the safe valves |
//! | [`Clause::Rearm`] | after a cut of the amplifier's wire 0 V, until the operator's word |
//! | [`Clause::Shutdown`] | dropped, it lets go, and can be opened again |
//! | [`Clause::TimeGoesOn`] | a tick of before is refused or does no harm |

use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, PERIOD_NS, SafeState, Tick};
use std::time::{Duration, Instant};

/// Ticks of a run in these tests.
const TICKS: u64 = 400;
/// A wire is cut at this tick.
const CUT_TICK: u64 = 100;
/// And mended at this one.
const MENDED_TICK: u64 = 400;
/// Ticks after a cut in which what was on its way may still arrive.
const SLACK_TICKS: u64 = 50;
/// What was commanded is in force after so many ticks at most.
const OBEYED_TICKS: u64 = 200;
/// Letting go takes less: anything longer is a hang.
const LONGEST_SHUTDOWN: Duration = Duration::from_secs(10);

const UNSEEN: &str = "expected a view of the rig, got none: exempt the subject, with the reason";

/// What is tested.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "the module's table says it")]
pub enum Clause {
    Freshness,
    Ordering,
    TimeOuts,
    LastCommand,
    SafeOnDrop,
    Rearm,
    Shutdown,
    TimeGoesOn,
}

/// A way to the rig that can be cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Wire {
    /// To the pump's amplifier.
    Amplifier,
    /// To valves and sensors.
    Bus,
}

/// A wire that carries nothing from one tick to another.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Cut {
    /// Which one.
    pub wire: Wire,
    /// Nothing passes from this tick on.
    pub from_tick: u64,
    /// From this tick on everything passes again.
    pub until_tick: u64,
}

/// What the rig has in force.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FarEnd {
    /// At the amplifier, V.
    pub voltage_v: f64,
    /// As the valve stands.
    pub brake_open: bool,
    /// As the valve stands.
    pub bypass_open: bool,
}

/// What went wrong outside the device.
pub type Trouble = Box<dyn std::error::Error>;

/// A device, and the hands at its far end.
pub trait Subject {
    /// What is tested.
    type Device: Device;

    /// Opens the device with its rig at rest, arms it and begins a run (`begin_run` is called here): tick 0 is now or soon. `cut` is
    /// done in the course of that run, by [`Subject::wait`] where nothing else does it.
    ///
    /// # Errors
    /// The rig or the device can't be had.
    fn open(&mut self, cut: Option<Cut>) -> Result<Self::Device, Trouble>;

    /// Returns when this tick of the run begins; at once in virtual time. Also called with the tick after the last.
    fn wait(&mut self, index: u64) -> Tick {
        Tick::at(index)
    }

    /// What the rig has in force now, after everything that was sent has arrived. `None` where it can't be seen.
    fn far_end(&mut self) -> Option<FarEnd>;

    /// What the rig showed at this tick of the run, as its sensors measured it; `None` where that is not known.
    fn shown(&mut self, tick: u64) -> Option<Measurement>;

    /// Whether [`Subject::shown`] knows most ticks. Where it does not (a real rig), values are judged by their ages alone.
    fn knows_what_was_shown(&self) -> bool {
        true
    }

    /// How far a value that is read may be from what was shown, in the unit of the input: the wire's resolution.
    fn resolution(&self, _input: Input) -> f64 {
        0.0
    }

    /// Oldest age of a value on sound wires, ticks: 0 where it is measured at the tick itself.
    fn age_ticks(&self) -> u64 {
        0
    }

    /// How far the rig's voltage may be from the command, V: the wire's resolution.
    fn voltage_resolution_v(&self) -> f64 {
        0.0
    }

    /// Where the valves go.
    fn safe_state(&self) -> SafeState {
        SafeState::default()
    }

    /// The operator's word after a cut, and the begin of another run, without a cut: tick 0 is now or soon.
    ///
    /// # Errors
    /// The device refuses.
    fn arm(&mut self, device: &mut Self::Device) -> Result<(), Trouble>;

    /// Why this can't be tested here; `None` = it can.
    fn exempt(&self, _clause: Clause) -> Option<&'static str> {
        None
    }
}

/// A clause that a device does not keep.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{clause:?}: {what}")]
pub struct Violation {
    /// Which clause.
    pub clause: Clause,
    /// Expected and got.
    pub what: String,
}

/// Tests every clause; returns those from which the subject is exempt, with its reasons.
///
/// # Errors
/// The first clause that is not kept.
pub fn check<S: Subject>(subject: &mut S) -> Result<Vec<(Clause, &'static str)>, Violation> {
    type Test<S> = fn(&mut S) -> Result<(), Violation>;
    let clauses: [(Clause, Test<S>); 8] = [
        (Clause::Freshness, freshness),
        (Clause::Ordering, ordering),
        (Clause::TimeOuts, time_outs),
        (Clause::LastCommand, last_command),
        (Clause::SafeOnDrop, safe_on_drop),
        (Clause::Rearm, rearm),
        (Clause::Shutdown, shutdown),
        (Clause::TimeGoesOn, time_goes_on),
    ];
    let mut exempt = vec![];
    for (clause, test) in clauses {
        match subject.exempt(clause) {
            Some(reason) => exempt.push((clause, reason)),
            None => test(subject)?,
        }
    }
    Ok(exempt)
}

/// A free lever that the pump moves at once: every value changes from tick to tick.
fn moving(tick: u64) -> Command {
    let voltage_v = if (tick / 200).is_multiple_of(2) { 10.0 } else { -10.0 };
    Command { voltage_v, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 }
}

struct Case<'a, S: Subject> {
    subject: &'a mut S,
    clause: Clause,
    /// Values that were held against what the rig showed.
    compared: u64,
}

impl<S: Subject> Case<'_, S> {
    fn violation(&self, what: impl Into<String>) -> Violation {
        Violation { clause: self.clause, what: what.into() }
    }

    fn open(&mut self, cut: Option<Cut>) -> Result<S::Device, Violation> {
        self.subject.open(cut).map_err(|error| self.violation(format!("expected a device, got: {error}")))
    }

    fn sound<T>(&self, tick: u64, answer: Result<T, DeviceError>) -> Result<T, Violation> {
        answer.map_err(|error| self.violation(format!("tick {tick}, on sound wires: {error}")))
    }

    /// The command of each of these ticks is written, and what is read before it goes to `heard`.
    fn drive(
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
    fn tick(&mut self, device: &mut S::Device, tick: u64, commands: &[Command]) -> Result<(), Violation> {
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
    fn until_in_force(&mut self, device: &mut S::Device, tick: &mut u64, command: Command) -> Result<(), Violation> {
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
    fn is_true(&mut self, now: Tick, measured: &Measurement) -> Result<(), Violation> {
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

/// A value is as old as its age says, and no older than the wires make it.
///
/// # Errors
/// It is not.
pub fn freshness<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let most_ns = subject.age_ticks() * PERIOD_NS;
    let mut case = Case { subject, clause: Clause::Freshness, compared: 0 };
    let mut device = case.open(None)?;
    let mut moved = [f64::NAN; 2];
    let mut late = 0;
    case.drive(&mut device, 0..TICKS, |case, now, measured| {
        if !measured.angle_deg.is_finite() || !measured.pressure1_bar.is_finite() {
            return Err(case.violation(format!("tick {}: no angle or no pressure on sound wires", now.index)));
        }
        late += u64::from([0, 1, 2].iter().any(|&input: &usize| u64::from(measured.age_ns[input]) > most_ns));
        moved = [moved[0].min(measured.angle_deg), moved[1].max(measured.angle_deg)];
        case.is_true(now, measured)
    })?;
    if case.subject.knows_what_was_shown() && case.compared < TICKS {
        return Err(case.violation(format!("only {} values could be held against what the rig showed", case.compared)));
    }
    if moved[1] - moved[0] < 0.5 {
        return Err(case.violation(format!("the lever did not move: {:?} deg", moved)));
    }
    // The host may stall a wire; as a rule it is in time.
    if late > TICKS / 4 {
        return Err(case.violation(format!("{late} of {TICKS} readings are older than {most_ns} ns")));
    }
    Ok(())
}

/// No value is followed by an older one; ticks may be passed over.
///
/// # Errors
/// One is.
pub fn ordering<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::Ordering, compared: 0 };
    let mut device = case.open(None)?;
    let mut newest_ns = [i64::MIN; 5];
    // Now and then some are passed over.
    let ticks = (0..TICKS).filter(|tick| tick % 50 < 45);
    case.drive(&mut device, ticks, |case, now, measured| {
        for input in Input::ALL.into_iter().filter(|&input| measured.value(input).is_finite()) {
            let measured_ns = now.scheduled_ns as i64 - i64::from(measured.age_ns[input as usize]);
            let before_ns = std::mem::replace(&mut newest_ns[input as usize], measured_ns);
            if measured_ns < before_ns {
                let column = input.column();
                let what = format!("tick {}, {column}: measured at {measured_ns} ns after {before_ns} ns", now.index);
                return Err(case.violation(what));
            }
        }
        case.is_true(now, measured)
    })
}

/// What is silent grows old, or the read fails; nothing is invented.
///
/// # Errors
/// Something stays young, or was never shown.
pub fn time_outs<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    for wire in [Wire::Bus, Wire::Amplifier] {
        let mut case = Case { subject: &mut *subject, clause: Clause::TimeOuts, compared: 0 };
        let cut = Cut { wire, from_tick: CUT_TICK, until_tick: MENDED_TICK };
        let mut device = case.open(Some(cut))?;
        for tick in 0..CUT_TICK + 250 {
            let now = case.subject.wait(tick);
            let measured = match device.read(now) {
                Ok(measured) => measured,
                Err(error) if tick < CUT_TICK => {
                    return Err(case.violation(format!("tick {tick}, on sound wires: {error}")));
                }
                // A device may say at once that it can't go on, and then no value of it counts.
                Err(_) => break,
            };
            // Whether a command can be sent into a cut wire is the device's business.
            let _ = device.write(now, &moving(tick));
            case.is_true(now, &measured)?;
            let least_ns = tick.saturating_sub(CUT_TICK + SLACK_TICKS) * PERIOD_NS;
            let heartbeat_ns = u64::from(measured.heartbeat_age_ns);
            let mut ages_ns = vec![heartbeat_ns];
            if wire == Wire::Bus {
                ages_ns = [Input::Angle, Input::Pressure1, Input::Pressure2]
                    .map(|input| u64::from(measured.age_ns[input as usize]))
                    .to_vec();
            }
            if let Some(young_ns) = ages_ns.into_iter().find(|&age_ns| age_ns < least_ns) {
                let what = format!(
                    "{wire:?} cut at tick {CUT_TICK}: at tick {tick} an age of {young_ns} ns, expected {least_ns} ns or more"
                );
                return Err(case.violation(what));
            }
        }
    }
    Ok(())
}

/// Of several commands the last counts.
///
/// # Errors
/// Another one does.
pub fn last_command<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::LastCommand, compared: 0 };
    let mut device = case.open(None)?;
    let mut tick = 0;
    for round in 0..8u32 {
        let last = Command { voltage_v: f64::from(round) - 3.5, brake_open: round % 2 == 0, ..moving(0) };
        let other = Command { voltage_v: 7.0, bypass_open: true, ..last };
        for of_round in 0..25 {
            let commands: &[Command] = match of_round {
                // As after an emergency: another one in the same tick.
                12 => &[other, last],
                _ if of_round % 2 == 0 && of_round < 24 => &[other],
                _ => &[last],
            };
            case.tick(&mut device, tick, commands)?;
            tick += 1;
        }
        case.until_in_force(&mut device, &mut tick, last)?;
    }
    Ok(())
}

/// A device that is dropped in the midst of a run leaves 0 V and the safe valves.
///
/// # Errors
/// It does not.
pub fn safe_on_drop<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::SafeOnDrop, compared: 0 };
    let mut device = case.open(None)?;
    let mut tick = 0;
    case.until_in_force(&mut device, &mut tick, moving(0))?;
    drop(device);
    let far_end = case.subject.far_end().ok_or_else(|| case.violation(UNSEEN))?;
    let SafeState { brake_open, bypass_open } = case.subject.safe_state();
    if far_end != (FarEnd { voltage_v: 0.0, brake_open, bypass_open }) {
        return Err(case.violation(format!("expected 0 V and the safe valves, the rig has {far_end:?}")));
    }
    Ok(())
}

/// After a cut of the amplifier's wire it gets 0 V, whatever is commanded, until the operator's word.
///
/// # Errors
/// It moves by itself, or does not after the word.
pub fn rearm<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::Rearm, compared: 0 };
    let cut = Cut { wire: Wire::Amplifier, from_tick: CUT_TICK, until_tick: MENDED_TICK };
    let mut device = case.open(Some(cut))?;
    for tick in 0..MENDED_TICK + 150 {
        let now = case.subject.wait(tick);
        // It may fail; the loop would write the safe state then, a defect in the loop might go on.
        let _ = device.read(now);
        let _ = device.write(now, &Command { voltage_v: 5.0, ..moving(0) });
        if [CUT_TICK + 280, MENDED_TICK + 50, MENDED_TICK + 149].contains(&tick) {
            let far_end = case.subject.far_end().ok_or_else(|| case.violation(UNSEEN))?;
            if far_end.voltage_v != 0.0 {
                let what = format!("tick {tick}, cut at {CUT_TICK}, mended at {MENDED_TICK}: {} V", far_end.voltage_v);
                return Err(case.violation(what));
            }
        }
    }
    case.subject.arm(&mut device).map_err(|error| case.violation(format!("armed again: {error}")))?;
    let mut tick = 0;
    case.until_in_force(&mut device, &mut tick, moving(0))
}

/// Dropped, it lets go, and can be opened again: at work, and where a wire is cut.
///
/// # Errors
/// It hangs, or can't.
pub fn shutdown<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::Shutdown, compared: 0 };
    let cuts = [None, Some(Wire::Amplifier), Some(Wire::Bus), None];
    for wire in cuts {
        let cut = wire.map(|wire| Cut { wire, from_tick: 20, until_tick: 70 });
        let mut device = case.open(cut)?;
        case.drive(&mut device, 0..20, |_, _, _| Ok(()))?;
        if wire.is_some() {
            for tick in 20..60 {
                let now = case.subject.wait(tick);
                let _ = device.read(now);
                let _ = device.write(now, &moving(tick));
            }
        }
        let began = Instant::now();
        drop(device);
        let took = began.elapsed();
        if took > LONGEST_SHUTDOWN {
            return Err(case.violation(format!("{wire:?} cut: letting go took {took:?}")));
        }
        // What is cut in the run is mended behind it.
        case.subject.wait(70);
    }
    Ok(())
}

/// A tick of before is refused or does no harm: it shows nothing that is younger than it was, and the run goes on.
///
/// # Errors
/// It did harm.
pub fn time_goes_on<S: Subject>(subject: &mut S) -> Result<(), Violation> {
    let mut case = Case { subject, clause: Clause::TimeGoesOn, compared: 0 };
    let mut device = case.open(None)?;
    case.drive(&mut device, 0..40, |_, _, _| Ok(()))?;
    // Whether it is refused is the device's choice.
    let _ = device.read(Tick::at(20));
    case.drive(&mut device, 40..80, |case, now, measured| case.is_true(now, measured))
}
