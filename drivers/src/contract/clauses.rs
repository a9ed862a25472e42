//! The clauses, one function each.

use super::case::{Case, UNSEEN, moving};
use super::{Clause, Cut, FarEnd, Subject, Violation, Wire};
use rt_core::{Command, Device, Input, PERIOD_NS, SafeState, Tick};
use std::time::{Duration, Instant};

/// Ticks of a run in these tests.
const TICKS: u64 = 400;
/// A wire is cut at this tick.
const CUT_TICK: u64 = 100;
/// And mended at this one.
const MENDED_TICK: u64 = 400;
/// Ticks after a cut in which what was on its way may still arrive.
const SLACK_TICKS: u64 = 50;
/// Letting go takes less: anything longer is a hang.
const LONGEST_SHUTDOWN: Duration = Duration::from_secs(10);

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
