//! What the loop makes of faults: dangerous ones end in the safe state, harmless ones end no run, and a replay agrees.

use crate::played::{fault, rig};
use drivers::faults::Faulty;
use drivers::journal::{JournalReader, Occurrence};
use rt_core::fault::{Fault, FaultKind, Route, Valve, full_scale};
use rt_core::replay::Replay;
use rt_core::{
    Breach, Channel, Command, Device, Ended, Fixture, Input, Limits, Lockstep, LoopError, Measurement, OpenLoop,
    OverrunPolicy, Reference, Run, RunReport, SafeState, Sample, Stages, Step, Supervisor, Target, Tick, flight,
};

/// A free lever that is driven to and fro.
struct ToAndFro {
    ticks: u64,
}

impl Reference for ToAndFro {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        let voltage_v = if (now.index / 250).is_multiple_of(2) { 6.0 } else { -6.0 };
        Step {
            target: Target::VoltageV(voltage_v),
            brake_open: now.index % 100 >= 5,
            bypass_open: now.index % 100 < 10,
            fixture: Fixture::Free,
            segment: (now.index / 250) as u32,
            index: 0,
            last: now.index + 1 >= self.ticks,
            waiting: None,
            hands_on: false,
        }
    }
}

fn limits() -> Limits {
    Limits { aftermath_ticks: 50, ..Limits::default() }
}

const TICKS: u64 = 1500;
const AT: u64 = 600;

/// The loop on the emulated rig with these faults: its end, its samples, what the rig has in force at last, what was told.
fn run(faults: &[Fault]) -> (Result<RunReport, LoopError>, Vec<Sample>, Command, Vec<Occurrence>) {
    let mut journals = JournalReader::default();
    let mut device = Faulty::new(rig(2), faults, 8, journals.journal("faults")).unwrap();
    let mut samples = Vec::new();
    let (mut flight, _log) = flight::recorder();
    let outcome = rt_core::run(
        Stages {
            clock: &mut Lockstep::default(),
            device: &mut device,
            operator: &mut (),
            supervisor: &mut Supervisor::new(limits()).unwrap(),
            reference: &mut ToAndFro { ticks: TICKS },
            controller: &mut OpenLoop,
            publish: &mut samples,
            flight: &mut flight,
        },
        Run { number: 0, overrun: OverrunPolicy::Skip },
    );
    device.end_run().unwrap();
    let in_force = device.device().command();
    (outcome, samples, in_force, journals.read())
}

/// What a replay of these samples finds.
fn replay(samples: Vec<Sample>) -> rt_core::replay::Verdict {
    let replay = Replay::new(samples.into_iter());
    let (mut flight, _log) = flight::recorder();
    let _ = rt_core::run(
        Stages {
            clock: &mut replay.clock(),
            device: &mut replay.device(),
            operator: &mut replay.operator(),
            supervisor: &mut Supervisor::new(limits()).unwrap(),
            reference: &mut ToAndFro { ticks: TICKS },
            controller: &mut OpenLoop,
            publish: &mut replay.comparison(),
            flight: &mut flight,
        },
        Run { number: 0, overrun: OverrunPolicy::Skip },
    );
    replay.verdict()
}

#[test]
fn dangerous_faults_end_in_the_safe_state_in_time_and_a_replay_agrees() {
    let (required, all) = ([Input::Angle, Input::Pressure1, Input::Pressure2], Route::Input);
    let channel = |input| [Channel::Angle, Channel::Pressure1, Channel::Pressure2][input as usize];
    let Limits { age_max_ms, missing_max_ticks, heartbeat_max_ms, .. } = limits();
    let (age, missing, heartbeat) = (age_max_ms as u64, u64::from(missing_max_ticks), heartbeat_max_ms as u64);
    // The fault, who trips, how, and after how many ticks at the latest; no one: the read fails.
    let mut cases = vec![];
    for input in required {
        let who = Some(channel(input));
        cases.push((FaultKind::Lost { route: all(input) }, who, age + 1));
        cases.push((FaultKind::Repeated { input, unnoticed: false }, who, age + 1));
        cases.push((FaultKind::Late { route: all(input), ticks: 40, unnoticed: false }, who, age + 1));
        cases.push((FaultKind::Nan { input }, who, missing + 1));
        cases.push((FaultKind::CrcError { input }, who, missing + 1));
    }
    cases.push((FaultKind::PortGone { timeout_ticks: 100 }, Some(Channel::Heartbeat), heartbeat + 1));
    cases.push((FaultKind::BusOff { timeout_ticks: 50 }, Some(Channel::Pressure1), age + 1));
    cases.push((FaultKind::AmplifierFault { code: 3 }, None, 0));
    for (kind, who, within) in cases {
        let forever = Fault { ticks: None, ..fault(kind, AT, 1) };
        let (outcome, samples, in_force, told) = run(&[forever]);
        let last = samples.last().unwrap();
        match (who, outcome) {
            (Some(who), Ok(report)) => {
                let trip = report.trip.unwrap_or_else(|| panic!("{kind}: no trip"));
                assert_eq!((report.ended, trip.channel), (Ended::Tripped, who), "{kind}: {trip}");
                assert!((AT..=AT + within).contains(&trip.tick), "{kind}: {trip}");
                assert!(matches!(trip.breach, Breach::Stale(_) | Breach::Missing(_)), "{kind}: {trip}");
                assert_eq!(last.tick, trip.tick + 50);
            }
            (None, Err(LoopError::Device { source, safe_state, .. })) => {
                assert!(source.tick == AT && source.what.contains("fault code 3"), "{source}");
                assert_eq!(safe_state, Ok(()));
            }
            (_, outcome) => panic!("{kind}: {outcome:?}"),
        }
        let safe = SafeState::default();
        assert_eq!(last.voltage_v, 0.0);
        assert_eq!(
            (in_force.voltage_v, in_force.brake_open, in_force.bypass_open),
            (0.0, safe.brake_open, safe.bypass_open),
            "{kind}: what the rig has in force"
        );
        assert_eq!(told.len(), 2, "{kind}: begin and end");
        let count = samples.len() as u64;
        let verdict = replay(samples);
        assert_eq!((verdict.difference, verdict.agreed), (None, count), "{kind}");
    }
}

#[test]
fn harmless_faults_end_no_run_and_a_replay_agrees() {
    let (low, high) = full_scale(Input::Angle);
    let share = |kind| Fault { probability: 0.2, ..fault(kind, AT, 500) };
    let short = |kind, ticks| fault(kind, AT, ticks);
    let mut cases = vec![
        fault(FaultKind::BitFlip { input: Input::Angle, bit: Some(2), low, high }, AT, 500),
        fault(FaultKind::ValveStuck { valve: Valve::Brake, open: Some(true) }, AT, 500),
        fault(FaultKind::ValveStuck { valve: Valve::Bypass, open: None }, AT, 500),
        share(FaultKind::Lost { route: Route::Voltage { timeout_ticks: 100 } }),
        share(FaultKind::Lost { route: Route::Valves { timeout_ticks: 50 } }),
        fault(FaultKind::Late { route: Route::Voltage { timeout_ticks: 100 }, ticks: 5, unnoticed: false }, AT, 500),
        short(FaultKind::PortGone { timeout_ticks: 100 }, 50),
        short(FaultKind::BusOff { timeout_ticks: 50 }, 15),
    ];
    for input in Input::ALL {
        cases.extend([
            share(FaultKind::Lost { route: Route::Input(input) }),
            fault(FaultKind::Late { route: Route::Input(input), ticks: 5, unnoticed: false }, AT, 500),
            share(FaultKind::Repeated { input, unnoticed: true }),
            share(FaultKind::Swapped { input, unnoticed: false }),
            share(FaultKind::CrcError { input }),
            share(FaultKind::Nan { input }),
            short(FaultKind::Stuck { input }, 100),
            fault(FaultKind::Drift { input, per_s: 0.05 }, AT, 500),
        ]);
    }
    let (_, untouched, ..) = run(&[]);
    for fault in cases {
        let (outcome, samples, _, told) = run(&[fault]);
        let report = outcome.unwrap_or_else(|error| panic!("{}: {error}", fault.kind));
        assert_eq!((report.ended, report.trip), (Ended::Completed, None), "{}", fault.kind);
        assert_eq!((samples.len() as u64, told.len()), (TICKS, 2), "{}", fault.kind);
        let free_lever = matches!(fault.kind.input(), Some(Input::Torque | Input::Volume));
        let read = |samples: &[Sample]| format!("{:?}", samples.iter().map(Sample::measurement).collect::<Vec<_>>());
        let same = read(&samples) == read(&untouched);
        assert!(!same || free_lever, "{}: nothing happened", fault.kind);
        let verdict = replay(samples);
        assert_eq!((verdict.difference, verdict.agreed), (None, TICKS), "{}", fault.kind);
    }
}
