use super::*;
use crate::monitor::description::Description;
use crate::setup::{Knowledge, Setup};
use recordings::{Plane, Protocol, Role, RunMetadata};
use rt_core::{Input, Limits, PERIOD_NS, Sample, flags};
use std::time::Duration;

const PROFILE: &str = "name = \"short\"\nprotocol = \"square-wave\"\nrole = \"validate\"\nplane = \"horizontal\"\n\
    [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\nfill_bar = 2.8\n\
    [[step]]\nvoltage_v = 6.0\nfor_s = 500.0\n";

fn sample(tick: u64) -> Sample {
    let t = tick as f64 * 1e-3;
    Sample {
        run: 3,
        tick,
        scheduled_ns: tick * PERIOD_NS,
        woken_ns: 1 + tick * PERIOD_NS,
        lateness_ns: 23_000 + tick % 100 * 1_000,
        voltage_v: 12.0,
        angle_deg: 30.0 * (t * 2.0).sin(),
        pressure1_bar: 3.125,
        pressure2_bar: 2.5,
        age_ns: [1_500_000, 0, 0, 0, 0],
        quality: Input::Angle.bit() | Input::Pressure1.bit() | Input::Pressure2.bit(),
        flags: flags::BRAKE_OPEN,
        segment: 2,
        target: 30.0 * (t * 2.0 + 0.1).sin(),
        target_of: 6,
        ..Sample::BLANK
    }
}

/// 12.346 s of a run whose service says what it is.
fn followed(begin: Instant, change: impl Fn(&mut Sample)) -> State {
    let mut state = State::new("rig");
    let samples: Vec<Sample> = (0..12_346)
        .map(|tick| {
            let mut sample = sample(tick);
            if tick == 12_345 {
                change(&mut sample);
            }
            sample
        })
        .collect();
    state.take(&samples, begin);
    let limits = Limits { pressure_max_bar: 3.4, ..Limits::default() };
    let metadata = RunMetadata {
        profile: PROFILE.to_owned(),
        notes: Setup::of(1, 24.0, &limits, &Knowledge::Nothing).notes(),
        ..RunMetadata::new("short", Protocol::SquareWave, Role::Validate, Plane::Horizontal)
    };
    state.describe(3, Description::of(&metadata));
    state
}

fn text(state: &State, now: Instant, width: u16, height: u16) -> Vec<String> {
    as_text(state, &Look::new(false, false), now, width, height).expect("it can be drawn")
}

fn assert_shows(lines: &[String], parts: &[&str]) {
    let all = lines.join("\n");
    for part in parts {
        assert!(all.contains(part), "{part:?} is missing in\n{all}");
    }
}

#[test]
fn everything_that_matters_fits_80_by_24() {
    let begin = Instant::now();
    let state = followed(begin, |_| {});
    let lines = text(&state, begin, 80, 24);
    assert_eq!(lines.len(), 24);
    assert_shows(
        &lines,
        &[
            " RUNNING  run 3: short, square-wave, validate, horizontal; instance rig",
            "12.345 s  segment 2, step 0: ",
            "asked for ",
            "deg  angle",
            "voltage        12.000 V",
            "1.5 ms old",
            "pressure 1      3.125 bar",
            "p1 - p2         0.625 bar",
            "torque              - Nm",
            "brake OPEN    bypass closed",
            "angle, deg",
            "•• asked for",
            "⠒⠒ measured",
            "pressures, bar",
            "lateness p50 72 us, p99 121 us, max 122 us",
            "12346 samples, 0 missed here; overruns 0, ticks skipped 0",
            "run 3 begins",
            " q  quit",
        ],
    );
    assert!(!lines.join("\n").contains("EMERGENCY"), "keys that do nothing are not offered");
    let braille = lines.iter().flat_map(|line| line.chars()).filter(|c| ('\u{2801}'..='\u{28ff}').contains(c)).count();
    assert!(braille > 60, "the curves are drawn: {braille} cells");
}

#[test]
fn a_large_terminal_shows_more_curves_and_more_happenings() {
    let begin = Instant::now();
    let mut state = followed(begin, |_| {});
    for number in 0..12 {
        state.happenings.say(Severity::Info, format!("happening {number} of many"));
    }
    let lines = text(&state, begin, 200, 60);
    assert_shows(
        &lines,
        &["angle, deg", "pressures, bar", "voltage, V", "lateness, ms", "happening 0 of many", "happening 11 of many"],
    );
    assert!(!text(&state, begin, 80, 24).join("\n").contains("happening 0 of many"));
}

#[test]
fn every_situation_is_said_in_the_first_line() {
    let begin = Instant::now();
    let first = |change: fn(&mut Sample), after_ms: u64| {
        let state = followed(begin, change);
        text(&state, begin + Duration::from_millis(after_ms), 100, 24).swap_remove(0)
    };
    let waits = first(|s| s.flags |= flags::WAITING, 0);
    assert!(waits.contains("WAITS  for the people at the rig"), "{waits}");
    let tripped = first(|s| (s.flags, s.trip) = (flags::TRIPPED, 1 | 2 << 8), 0);
    assert!(tripped.contains("TRIPPED  pressure 1 above its limit"), "{tripped}");
    let ended = first(|s| s.flags |= flags::LAST, 5_000);
    assert!(ended.contains("ENDED  completed"), "{ended}");
    let silent = first(|_| {}, 1_300);
    assert!(silent.contains("SILENT  no samples for 1.3 s"), "{silent}");
    let mut state = followed(begin, |_| {});
    state.found_published(false);
    let gone = text(&state, begin + Duration::from_secs(12), 100, 24);
    assert_shows(
        &gone,
        &["GONE  no samples for 12.0 s, and nobody publishes", "X the service is gone without ending its run"],
    );
    let none = text(&State::new("rig"), begin, 80, 24);
    assert_shows(
        &none,
        &["NO RUN YET  waiting for a run of instance \"rig\"", "bench run PROFILE --realtime --instance rig"],
    );
}

#[test]
fn values_that_can_not_be_trusted_and_flags_are_marked_in_words() {
    let begin = Instant::now();
    let state = followed(begin, |s| {
        s.quality |= Input::Pressure2.bit() << 8;
        s.age_ns[1] = u32::MAX;
        s.flags |= flags::SLEW_LIMITED | flags::OVERRUN;
        s.skipped = 0;
    });
    let lines = text(&state, begin, 80, 24);
    assert_shows(
        &lines,
        &["2.500 bar WRONG", "> 4 s old", "overrun slew-limited", "! deadline missed, 0 ticks skipped", "overruns 1, "],
    );
}

#[test]
fn no_size_and_no_window_is_too_small_or_too_large() {
    let begin = Instant::now();
    let mut states = vec![State::new("rig"), followed(begin, |_| {})];
    // No value at all, and values beyond every scale.
    let mut odd = State::new("rig");
    odd.take(&[Sample { run: 1, voltage_v: f64::MAX, pressure1_bar: f64::MIN, target_of: 2, ..Sample::BLANK }], begin);
    states.push(odd);
    for state in &states {
        for (width, height) in [(1, 1), (2, 30), (20, 5), (40, 8), (65, 19), (66, 20), (80, 24), (81, 13), (500, 200)] {
            let mut look = Look::new(true, true);
            for _ in 0..8 {
                look.wider();
                look.turn();
                assert_eq!(as_text(state, &look, begin, width, height).expect("drawn").len(), usize::from(height));
            }
            (0..8).for_each(|_| look.narrower());
            as_text(state, &look, begin, width, height).expect("drawn");
        }
    }
    // What is left of it at the smallest: where things stand.
    assert!(text(&states[1], begin, 40, 3)[0].contains("RUNNING"));
    assert!(text(&states[1], begin, 60, 12).join("\n").contains("pressure 1"));
}

#[test]
fn without_colour_no_cell_has_one_and_with_it_a_trip_is_red() {
    let begin = Instant::now();
    let state = followed(begin, |s| (s.flags, s.trip) = (flags::TRIPPED, 9 | 6 << 8));
    for colour in [false, true] {
        let mut terminal = Terminal::new(TestBackend::new(80, 24)).expect("a backend of memory");
        terminal.draw(|frame| draw(frame, &state, &Look::new(true, colour), begin)).expect("drawn");
        let colours: std::collections::HashSet<_> =
            terminal.backend().buffer().content().iter().map(|cell| cell.fg).collect();
        let reset = ratatui::style::Color::Reset;
        assert_eq!(colours.iter().any(|c| *c != reset), colour, "{colours:?}");
        assert_eq!(colours.contains(&ratatui::style::Color::Red), colour);
    }
}
