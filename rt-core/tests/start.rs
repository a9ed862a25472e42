//! What holds the lever before a run goes on holding it where the run goes safe at its very first tick.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use rt_core::flight::recorder;
use rt_core::{
    Command, Demand, Device, DeviceError, Fixture, Limits, Lockstep, LoopError, Measurement, OpenLoop, Operator,
    OverrunPolicy, Reference, Run, RunReport, Sample, Stages, Step, Supervisor, Target, Tick,
};

const HELD: Fixture = Fixture::Clamped { angle_deg: -20.0 };

/// Held at the start, let go by its first step.
struct LetsGo {
    voltage_v: f64,
}

impl Reference for LetsGo {
    fn fixture_at_start(&self) -> Fixture {
        HELD
    }

    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        Step {
            target: Target::VoltageV(self.voltage_v),
            brake_open: true,
            bypass_open: false,
            fixture: Fixture::Free,
            segment: 0,
            index: 0,
            last: now.index >= 9,
            waiting: None,
            hands_on: false,
        }
    }
}

/// Keeps what it was told; fails at its first tick, or measures this.
struct Told {
    commands: Vec<Command>,
    measured: Option<Measurement>,
}

impl Device for Told {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let what = "expected an answer, got none".to_owned();
        self.measured.ok_or(DeviceError { device: "told", tick: now.index, what })
    }

    fn write(&mut self, _now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.commands.push(*command);
        Ok(())
    }
}

struct From0(Demand);

impl Operator for From0 {
    fn demand(&mut self, _now: Tick) -> Demand {
        self.0
    }
}

fn run(measured: Option<Measurement>, demand: Demand, voltage_v: f64) -> (Vec<Command>, Result<RunReport, LoopError>) {
    let limits = Limits { aftermath_ticks: 3, ..Limits::default() };
    let mut device = Told { commands: Vec::new(), measured };
    let mut samples: Vec<Sample> = Vec::new();
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut device,
        operator: &mut From0(demand),
        supervisor: &mut Supervisor::new(limits).unwrap(),
        reference: &mut LetsGo { voltage_v },
        controller: &mut OpenLoop,
        publish: &mut samples,
        flight: &mut recorder().0,
    };
    let report = rt_core::run(stages, Run { number: 0, overrun: OverrunPolicy::Skip });
    (device.commands, report)
}

const GOOD: Measurement = Measurement { angle_deg: 1.0, pressure1_bar: 2.5, pressure2_bar: 2.5, ..Measurement::NONE };

#[test]
fn a_run_that_goes_safe_at_its_first_tick_opens_no_clamp() {
    let high = Measurement { pressure1_bar: 99.0, ..GOOD };
    for (what, measured, demand, voltage_v) in [
        ("the device fails", None, Demand::None, 0.0),
        ("a pressure trips", Some(high), Demand::None, 0.0),
        ("an emergency stop", Some(GOOD), Demand::EmergencyStop, 0.0),
        ("a stop", Some(GOOD), Demand::Stop, 0.0),
        ("a command that is no number", Some(GOOD), Demand::None, f64::NAN),
    ] {
        let (commands, _) = run(measured, demand, voltage_v);
        assert!(!commands.is_empty() && commands.iter().all(|c| c.fixture == HELD && c.voltage_v == 0.0), "{what}");
    }
    let (commands, report) = run(Some(GOOD), Demand::None, 1.0);
    assert!(report.is_ok() && commands[0].fixture == Fixture::Free, "it is let go where the run goes on");
}

#[test]
fn a_run_that_fails_says_how_many_ticks_it_had() {
    let (_, report) = run(None, Demand::None, 0.0);
    let Err(LoopError::Device { statistics, .. }) = report else { panic!("{report:?}") };
    assert_eq!(statistics.ticks, 1);
}
