//! A run that waits for people: what is taken and what is refused, what the samples say, what the supervisor judges meanwhile.
#![allow(clippy::unwrap_used, reason = "a helper of a test fails as the test does")]

use std::sync::atomic::Ordering;
use std::thread;
use std::time::Duration;

use rt_core::flight::recorder;
use rt_core::replay::Replay;
use rt_core::{
    Amount, Clock, Command, Confirmation, Demand, Device, DeviceError, Ended, Fixture, Input, Limits, Lockstep,
    LoopError, Measurement, OpenLoop, Operator, OverrunPolicy, RealTime, Reference, Refusal, Run, RunReport, Sample,
    Stages, Step, Supervisor, Switches, Target, Tick, Waiting, flags,
};

/// Five ticks, then it waits, then five ticks.
struct Asking {
    amount: Option<Amount>,
    confirmed: Option<u64>,
    /// What it drives with while it waits, V; people keep their hands off then.
    meanwhile_v: f64,
}

impl Asking {
    fn new(amount: Option<Amount>) -> Self {
        Asking { amount, confirmed: None, meanwhile_v: 0.0 }
    }
}

const REQUEST: u32 = 7;

impl Reference for Asking {
    fn confirmed(&mut self, now: Tick) {
        assert_eq!(self.confirmed, None, "said once");
        self.confirmed = Some(now.index);
    }

    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        let waits = now.index >= 5 && self.confirmed.is_none();
        Step {
            target: Target::VoltageV(if waits { self.meanwhile_v } else { 3.0 }),
            brake_open: true,
            bypass_open: false,
            fixture: Fixture::Free,
            segment: 0,
            index: 0,
            last: self.confirmed.is_some_and(|at| now.index >= at + 5),
            waiting: waits.then_some(Waiting { request: REQUEST, amount: self.amount }),
            hands_on: waits && self.meanwhile_v == 0.0,
        }
    }
}

/// Measures the same always, but what a test forges.
struct Still(fn(u64) -> Measurement);

const GOOD: Measurement = Measurement { angle_deg: 1.0, pressure1_bar: 2.5, pressure2_bar: 2.5, ..Measurement::NONE };

fn good(_: u64) -> Measurement {
    GOOD
}

impl Device for Still {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        Ok((self.0)(now.index))
    }

    fn write(&mut self, _now: Tick, _command: &Command) -> Result<(), DeviceError> {
        Ok(())
    }
}

/// Offers a confirmation at each of these ticks, and keeps what becomes of it.
#[derive(Default)]
struct People {
    switches: Switches,
    say: Vec<(u64, Confirmation)>,
    heard: Vec<(u64, Result<u64, Refusal>)>,
    stop_at: Option<u64>,
    emergency_at: Option<u64>,
}

impl Operator for People {
    fn demand(&mut self, now: Tick) -> Demand {
        if self.stop_at == Some(now.index) {
            self.switches.stop.store(true, Ordering::Relaxed);
        }
        if self.emergency_at == Some(now.index) {
            self.switches.emergency_stop.store(true, Ordering::Relaxed);
        }
        (&self.switches).demand(now)
    }

    fn confirmation(&mut self, now: Tick, waiting: Option<Waiting>, measured: &Measurement) -> Option<Confirmation> {
        let said = self.say.iter().find(|(at, _)| *at == now.index);
        if let Some((_, confirmation)) = said {
            assert!(self.switches.confirmations.offer(*confirmation));
        }
        let taken = (&self.switches).confirmation(now, waiting, measured);
        assert_eq!(self.switches.confirmations.waiting(), waiting);
        self.heard.extend(self.switches.confirmations.verdict().map(|verdict| (now.index, verdict)));
        taken
    }
}

fn drive(
    asking: Asking,
    people: &mut dyn Operator,
    measured: fn(u64) -> Measurement,
    limits: Limits,
    clock: &mut dyn Clock,
) -> (Vec<Sample>, Result<RunReport, LoopError>) {
    let mut samples: Vec<Sample> = Vec::new();
    let mut asking = asking;
    let report = {
        let stages = Stages {
            clock,
            device: &mut Still(measured),
            operator: people,
            supervisor: &mut Supervisor::new(limits).unwrap(),
            reference: &mut asking,
            controller: &mut OpenLoop,
            publish: &mut samples,
            flight: &mut recorder().0,
        };
        rt_core::run(stages, Run { number: 1, overrun: OverrunPolicy::Skip })
    };
    (samples, report)
}

fn waiting(samples: &[Sample]) -> Vec<u64> {
    samples.iter().filter(|s| s.waiting()).map(|s| s.tick).collect()
}

fn confirmed(samples: &[Sample]) -> Vec<u64> {
    samples.iter().filter(|s| s.confirmed()).map(|s| s.tick).collect()
}

fn with(request: Option<u32>, volume_ml: Option<f64>) -> Confirmation {
    Confirmation { request, volume_ml }
}

#[test]
fn what_comes_too_early_too_late_or_does_not_fit_is_refused_and_the_rest_is_taken_at_its_tick() {
    let say = vec![
        (2, with(None, None)),
        (8, with(Some(REQUEST + 1), Some(1.0))),
        (9, with(None, None)),
        (10, with(None, Some(f64::NAN))),
        (12, with(Some(REQUEST), Some(1.25))),
        (13, with(None, Some(9.0))),
    ];
    let mut people = People { say, ..People::default() };
    let asking = Asking::new(Some(Amount::VolumeMl));
    let (samples, report) = drive(asking, &mut people, good, Limits::default(), &mut Lockstep::default());
    assert_eq!(report.unwrap().ended, Ended::Completed);
    assert_eq!(
        people.heard,
        [
            (2, Err(Refusal::NothingWaits)),
            (8, Err(Refusal::OtherRequest)),
            (9, Err(Refusal::AmountMissing)),
            (10, Err(Refusal::AmountNotFinite)),
            (12, Ok(12)),
            (13, Err(Refusal::NothingWaits)),
        ]
    );
    assert_eq!(waiting(&samples), (5..12).collect::<Vec<_>>());
    assert_eq!(confirmed(&samples), [12]);
    for sample in &samples {
        let amount = if sample.tick == 12 { Some(1.25) } else { None };
        assert_eq!((sample.volume_ml.is_finite().then_some(sample.volume_ml), sample.tick), (amount, sample.tick));
        assert_eq!(sample.quality & Input::Volume.bit() != 0, amount.is_some());
    }
    let people = People { say: vec![(9, with(None, Some(1.0)))], ..People::default() };
    let mut people = People { stop_at: Some(20), ..people };
    drive(Asking::new(None), &mut people, good, Limits::default(), &mut Lockstep::default()).1.unwrap();
    assert_eq!(people.heard, [(9, Err(Refusal::AmountUnasked))]);
}

/// Measures a volume, and then one that it calls wrong and old.
fn measuring(tick: u64) -> Measurement {
    let mut measured = Measurement { volume_ml: 4.0, age_ns: [0, 0, 0, 0, 7_000_000], ..GOOD };
    measured.faulty = if tick < 10 { Input::Volume.bit() } else { 0 };
    measured
}

#[test]
fn an_amount_may_be_left_out_where_the_rig_measures_it_and_stands_in_for_what_it_calls_wrong() {
    let limits = Limits { age_max_ms: 20.0, ..Limits::default() };
    let run = |say| {
        let mut people = People { say, ..People::default() };
        let asking = Asking::new(Some(Amount::VolumeMl));
        let (samples, _) = drive(asking, &mut people, measuring, limits, &mut Lockstep::default());
        let at = samples.iter().find(|s| s.confirmed()).copied().unwrap();
        (people.heard, at.tick, at.volume_ml, at.age_ns[4], at.measurement().is_valid(Input::Volume))
    };
    let (refused, measured) = ((7, Err(Refusal::AmountMissing)), (11, Ok(11)));
    let nothing = with(None, None);
    assert_eq!(run(vec![(7, nothing), (11, nothing)]), (vec![refused, measured], 11, 4.0, 7_000_000, true));
    assert_eq!(run(vec![(8, with(None, Some(3.0)))]), (vec![(8, Ok(8))], 8, 3.0, 0, true));
}

#[test]
fn hands_on_the_rig_may_move_the_lever_and_unplug_sensors_but_no_limit_of_what_is_measured_is_lifted() {
    let limits = Limits { missing_max_ticks: 3, aftermath_ticks: 5, velocity_window_ticks: 1, ..Limits::default() };
    let tripped = |measured, confirm_at| {
        let mut people = People { say: vec![(confirm_at, with(None, None))], stop_at: Some(90), ..People::default() };
        let (samples, _) = drive(Asking::new(None), &mut people, measured, limits, &mut Lockstep::default());
        let first = samples.iter().find(|s| s.tripped()).map(|s| s.tick);
        let after =
            samples.iter().filter(|s| s.tripped()).all(|s| !s.waiting() && s.voltage_v == 0.0 && !s.brake_open());
        assert!(after, "a tripped rig waits for nobody");
        first
    };
    // 3 deg a tick is 3000 deg/s.
    assert_eq!(tripped(|tick| Measurement { angle_deg: if tick % 2 == 0 { 0.0 } else { 30.0 }, ..GOOD }, 80), Some(2));
    let by_hand = |tick: u64| Measurement {
        angle_deg: if (7..40).contains(&tick) { 3.0 * (tick % 9) as f64 } else { 0.0 },
        ..GOOD
    };
    assert_eq!(tripped(by_hand, 80), None);
    assert_eq!(tripped(|tick| if tick < 7 { GOOD } else { Measurement::NONE }, 200), None, "unplugged");
    assert_eq!(
        tripped(|tick| if tick < 7 { GOOD } else { Measurement::NONE }, 50),
        Some(54),
        "and still so when they say that it is done"
    );
    assert_eq!(tripped(|tick| Measurement { pressure1_bar: if tick < 30 { 2.0 } else { 9.0 }, ..GOOD }, 80), Some(30));
    assert_eq!(tripped(|tick| Measurement { torque_nm: if tick < 30 { 2.0 } else { 99.0 }, ..GOOD }, 80), Some(30));
    assert_eq!(tripped(|tick| Measurement { angle_deg: if tick < 30 { 2.0 } else { 70.0 }, ..GOOD }, 80), Some(30));
    let silent = |tick| Measurement { heartbeat_age_ns: if tick < 30 { 0 } else { u32::MAX }, ..GOOD };
    assert_eq!(tripped(silent, 80), Some(30));
}

#[test]
fn while_the_pump_is_driven_everything_is_judged_though_people_are_asked() {
    let limits = Limits { missing_max_ticks: 3, aftermath_ticks: 5, velocity_window_ticks: 1, ..Limits::default() };
    let tripped = |meanwhile_v, limits, measured| {
        let mut people = People { stop_at: Some(200), ..People::default() };
        let asking = Asking { meanwhile_v, ..Asking::new(None) };
        let (samples, _) = drive(asking, &mut people, measured, limits, &mut Lockstep::default());
        assert!(samples.iter().any(|s| s.waiting()));
        samples.iter().find(|s| s.tripped()).map(|s| s.tick)
    };
    let unplugged = |tick: u64| if tick < 10 { GOOD } else { Measurement::NONE };
    let moved = |tick: u64| Measurement { angle_deg: if tick < 10 { 0.0 } else { 3.0 * (tick % 9) as f64 }, ..GOOD };
    let old = |tick: u64| Measurement { age_ns: [if tick < 10 { 0 } else { 90_000_000 }; 5], ..GOOD };
    type Measured = fn(u64) -> Measurement;
    let cases: [(Measured, u64); 3] = [(unplugged, 13), (moved, 10), (old, 10)];
    for (measured, at) in cases {
        assert_eq!((tripped(2.0, limits, measured), tripped(0.0, limits, measured)), (Some(at), None));
    }
    // Up to 0.5 V by tick 4, then down by 0.1 V a tick: until that is over the pump does not rest.
    let slow = Limits { slew_max_v_s: 100.0, ..limits };
    assert_eq!(tripped(0.0, slow, |tick| if tick < 5 { GOOD } else { Measurement::NONE }), Some(8));
    assert_eq!(tripped(0.0, slow, |tick| if tick < 12 { GOOD } else { Measurement::NONE }), None);
}

#[test]
fn a_stop_and_an_emergency_stop_end_the_wait_and_who_confirms_at_that_tick_is_told() {
    for emergency in [false, true] {
        let mut people = People { say: vec![(20, with(None, None))], ..People::default() };
        if emergency {
            people.emergency_at = Some(20);
        } else {
            people.stop_at = Some(20);
        }
        let limits = Limits { aftermath_ticks: 5, ..Limits::default() };
        let (samples, report) = drive(Asking::new(None), &mut people, good, limits, &mut Lockstep::default());
        let ended = if emergency { Ended::Tripped } else { Ended::Stopped };
        assert_eq!((report.unwrap().ended, waiting(&samples).last()), (ended, Some(&19)));
        assert_eq!(people.heard, [(20, Err(Refusal::NothingWaits))]);
        assert_eq!(confirmed(&samples), [] as [u64; 0]);
    }
}

#[test]
fn a_run_with_confirmations_is_replayed_bit_for_bit() {
    let say = vec![(9, with(None, None)), (12, with(None, Some(1.25)))];
    for measured in [good, measuring] {
        let mut people = People { say: say.clone(), ..People::default() };
        let asking = || Asking::new(Some(Amount::VolumeMl));
        let (samples, _) = drive(asking(), &mut people, measured, Limits::default(), &mut Lockstep::default());
        assert_eq!(confirmed(&samples), [12]);
        let agreed = |samples: &[Sample]| {
            let replay = Replay::new(samples.iter().copied());
            let stages = Stages {
                clock: &mut replay.clock(),
                device: &mut replay.device(),
                operator: &mut replay.operator(),
                supervisor: &mut Supervisor::new(Limits::default()).unwrap(),
                reference: &mut asking(),
                controller: &mut OpenLoop,
                publish: &mut replay.comparison(),
                flight: &mut recorder().0,
            };
            let _ = rt_core::run(stages, Run { number: 1, overrun: OverrunPolicy::Skip });
            replay.verdict()
        };
        let verdict = agreed(&samples);
        assert_eq!((verdict.difference, verdict.agreed), (None, samples.len() as u64));
        // A confirmation that was not there is missed.
        let mut forged = samples.clone();
        forged[12].flags &= !flags::CONFIRMED;
        let difference = agreed(&forged).difference.unwrap();
        assert_eq!((difference.tick, difference.field), (12, "voltage_v"), "it would not drive yet");
    }
}

#[test]
fn threads_that_confirm_at_once_are_answered_one_by_one_and_exactly_one_is_taken() {
    let switches = Switches::new();
    let taken = thread::scope(|scope| {
        let threads: Vec<_> = (0..4)
            .map(|n| {
                let slot = &switches.confirmations;
                scope.spawn(move || {
                    while slot.waiting().is_none() {
                        thread::sleep(Duration::from_micros(200));
                    }
                    (n, slot.confirm(with(Some(REQUEST), Some(f64::from(n))), Duration::from_secs(30)))
                })
            })
            .collect();
        let stop = scope.spawn(|| {
            let verdicts: Vec<_> = threads.into_iter().map(|thread| thread.join().unwrap()).collect();
            switches.stop.store(true, Ordering::Relaxed);
            verdicts
        });
        // It never ends by itself while they are asked: those that come late must find a run that refuses them.
        struct Endless(Asking);
        impl Reference for Endless {
            fn confirmed(&mut self, now: Tick) {
                self.0.confirmed(now);
            }
            fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
                Step { last: false, ..self.0.step(now, measured) }
            }
        }
        let mut samples: Vec<Sample> = Vec::new();
        let stages = Stages {
            clock: &mut RealTime::default(),
            device: &mut Still(good),
            operator: &mut &switches,
            supervisor: &mut Supervisor::new(Limits::default()).unwrap(),
            reference: &mut Endless(Asking::new(Some(Amount::VolumeMl))),
            controller: &mut OpenLoop,
            publish: &mut samples,
            flight: &mut recorder().0,
        };
        rt_core::run(stages, Run { number: 1, overrun: OverrunPolicy::Skip }).unwrap();
        let verdicts = stop.join().unwrap();
        let at: Vec<&Sample> = samples.iter().filter(|s| s.confirmed()).collect();
        assert_eq!(at.len(), 1);
        let first = verdicts.iter().find(|(_, verdict)| verdict.is_ok()).unwrap();
        assert_eq!(
            (first.1, f64::from(first.0)),
            (Ok(at[0].tick), at[0].volume_ml),
            "the answer names tick and amount"
        );
        verdicts.iter().filter(|(_, verdict)| verdict.is_ok()).count()
    });
    assert_eq!(taken, 1);
    // No run: whoever waits is told, and leaves nothing behind.
    let slot = &switches.confirmations;
    assert_eq!(slot.confirm(Confirmation::default(), Duration::from_millis(5)), Err(Refusal::NoAnswer));
    assert_eq!(slot.take(Tick::at(0), Some(Waiting { request: 0, amount: None }), &GOOD), None);
}
