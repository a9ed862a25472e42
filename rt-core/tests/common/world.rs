//! A rig, a profile and a controller whose every stage can be made slow: time passes only where a test says so.

use std::cell::{Cell, RefCell};
use std::collections::HashMap;
use std::rc::Rc;
use std::sync::atomic::Ordering;

use rt_core::flight::{FlightLog, recorder};
use rt_core::{
    Clock, Command, Controller, Demand, Device, DeviceError, Fixture, FlightRecorder, Handover, Limits, Lockstep,
    LoopError, Measurement, Operator, OverrunPolicy, PERIOD_NS, Publish, Reference, Run, RunReport, Sample, Stages,
    Step, Supervisor, Switches, Target, Tick, Wake, run,
};

/// `CLOCK_MONOTONIC` at tick 0 of a scripted run, ns: no run begins at the boot.
pub const ORIGIN_NS: u64 = 7_000_000_000;

/// A place where a tick may lose time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum At {
    Wake,
    Read,
    Reference,
    Control,
    Write,
    Publish,
}

/// The time and the calls that all stages of one test share.
#[derive(Clone, Default)]
pub struct World {
    now_ns: Rc<Cell<u64>>,
    delays: Rc<RefCell<HashMap<(At, u64), u64>>>,
    calls: Rc<RefCell<Vec<String>>>,
}

impl World {
    /// Lets this stage of this tick take so long.
    pub fn delay(&self, at: At, tick: u64, ms: f64) {
        self.delays.borrow_mut().insert((at, tick), (ms * 1e6).round() as u64);
    }

    /// Every call, as "stage tick".
    pub fn calls(&self) -> Vec<String> {
        self.calls.borrow().clone()
    }

    fn pass(&self, at: At, tick: u64) {
        let ns = self.delays.borrow().get(&(at, tick)).copied().unwrap_or(0);
        self.now_ns.set(self.now_ns.get() + ns);
    }

    fn called(&self, what: &str, at: At, now: Tick) {
        self.calls.borrow_mut().push(format!("{what} {}", now.index));
        self.pass(at, now.index);
    }
}

/// A clock that is late only by what the stages, or the test, let pass.
impl Clock for World {
    fn start(&mut self) {
        self.now_ns.set(0);
    }

    fn wait(&mut self, index: u64) -> Wake {
        let tick = Tick::at(index);
        let behind_ns = self.now_ns.get().saturating_sub(tick.scheduled_ns);
        if behind_ns == 0 {
            self.now_ns.set(tick.scheduled_ns);
        }
        self.pass(At::Wake, index);
        let now_ns = self.now_ns.get();
        Wake { tick, woken_ns: ORIGIN_NS + now_ns, lateness_ns: now_ns - tick.scheduled_ns, behind_ns }
    }

    fn now_ns(&mut self) -> u64 {
        self.now_ns.get()
    }
}

/// Changes what a sensor says.
pub type Forge = fn(&mut Measurement);

/// A tank whose pressure 1 rises by 0.01 bar per volt and tick.
#[derive(Default)]
pub struct Tank {
    pub world: World,
    pub pressure_bar: f64,
    pub acting_v: f64,
    pub written: Vec<(u64, Command)>,
    pub fail_read_at: Option<u64>,
    pub fail_write_at: Option<u64>,
    /// What a sensor says instead, from a tick on.
    pub forge: Option<(u64, Forge)>,
    /// Noise on everything, values that come and go, ages, sensors that call themselves wrong.
    pub noisy: bool,
    /// Blocks the thread for 5 ms in the read of this tick: for real time.
    pub block_at: Option<u64>,
}

fn broken(now: Tick) -> DeviceError {
    DeviceError { device: "tank", tick: now.index, what: "expected an answer, got none".to_owned() }
}

/// The same number for the same arguments, in 0..1.
fn chance(tick: u64, of: u64) -> f64 {
    let mut x = (tick << 8 | of).wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    x = (x ^ x >> 29).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    (x >> 11) as f64 / (1u64 << 53) as f64
}

fn make_noisy(measured: &mut Measurement, tick: u64) {
    let noise = |of| 0.02 * (chance(tick, of) - 0.5);
    measured.angle_deg = if chance(tick, 1) < 0.1 { f64::NAN } else { noise(2) };
    measured.pressure1_bar += noise(3);
    measured.pressure2_bar += noise(4);
    measured.torque_nm = if chance(tick, 5) < 0.5 { -0.0 } else { f64::NAN };
    measured.volume_ml = f64::INFINITY;
    measured.age_ns = std::array::from_fn(|k| (1e6 * chance(tick, 10 + k as u64)) as u32);
    measured.heartbeat_age_ns = (5e6 * chance(tick, 20)) as u32;
    measured.faulty = if chance(tick, 21) < 0.1 { (32.0 * chance(tick, 22)) as u32 } else { 0 };
}

impl Device for Tank {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        self.world.called("read", At::Read, now);
        if self.block_at == Some(now.index) {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        if self.fail_read_at == Some(now.index) {
            return Err(broken(now));
        }
        self.pressure_bar += 0.01 * self.acting_v;
        let pressure1_bar = 2.0 + self.pressure_bar;
        let mut measured = Measurement { angle_deg: 0.0, pressure1_bar, pressure2_bar: 2.0, ..Measurement::NONE };
        if self.noisy {
            make_noisy(&mut measured, now.index);
        }
        if let Some((_, forge)) = self.forge.filter(|(from, _)| now.index >= *from) {
            forge(&mut measured);
        }
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.world.called("write", At::Write, now);
        if self.fail_write_at == Some(now.index) {
            return Err(broken(now));
        }
        self.acting_v = command.voltage_v;
        self.written.push((now.index, *command));
        Ok(())
    }
}

/// A constant voltage over some ticks; the segment counts from 7, the steps from 0.
pub struct Script {
    pub world: World,
    pub ticks: u64,
    pub voltage_v: f64,
    /// What holds the lever, from tick to tick.
    pub fixture: fn(u64) -> Fixture,
}

impl Reference for Script {
    fn fixture_at_start(&self) -> Fixture {
        (self.fixture)(0)
    }

    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        self.world.called("reference", At::Reference, now);
        Step {
            target: Target::VoltageV(self.voltage_v),
            brake_open: true,
            bypass_open: false,
            fixture: (self.fixture)(now.index),
            segment: 7 + now.index as u32 / 10,
            index: now.index as u32 / 5,
            last: now.index + 1 >= self.ticks,
            waiting: None,
            hands_on: false,
        }
    }
}

/// Passes the target on, plus a part of the measured pressure; remembers a little.
pub struct Follow {
    pub world: World,
    pub gain_v_bar: f64,
    /// What it says instead, from a tick on.
    pub answer: Option<(u64, f64)>,
    pub remembered: f64,
}

impl Controller for Follow {
    fn begin_run(&mut self) {
        self.remembered = 0.0;
    }

    fn control(&mut self, now: Tick, measured: &Measurement, step: &Step) -> f64 {
        self.world.called("control", At::Control, now);
        let Target::VoltageV(voltage_v) = step.target else { return f64::NAN };
        if let Some((_, answer)) = self.answer.filter(|(from, _)| now.index >= *from) {
            return answer;
        }
        if measured.pressure1_bar.is_finite() {
            self.remembered += 0.1 * (measured.pressure1_bar - 2.0 - self.remembered);
        }
        voltage_v - self.gain_v_bar * self.remembered
    }
}

/// Keeps the samples; has no more room after some.
pub struct Book {
    pub world: World,
    pub samples: Vec<Sample>,
    pub room: usize,
    /// The queue is emptied after the run.
    pub patient: bool,
}

impl Publish for Book {
    fn publish(&mut self, sample: &Sample) -> Handover {
        self.world.called("publish", At::Publish, Tick::at(sample.tick));
        if self.samples.len() >= self.room {
            return Handover::Lost;
        }
        self.samples.publish(sample)
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.world.calls.borrow_mut().push(format!("publish patiently {}", sample.tick));
        if self.patient { self.samples.publish(sample) } else { Handover::Lost }
    }
}

/// Ask for something from a tick on.
pub struct People(pub Vec<(u64, Demand)>);

impl Operator for People {
    fn demand(&mut self, now: Tick) -> Demand {
        let People(demands) = self;
        demands.iter().rev().find(|(from, _)| now.index >= *from).map_or(Demand::None, |(_, demand)| *demand)
    }
}

/// Throws the switch of the emergency stop at a tick, as another thread or a signal handler would.
pub struct Thrower {
    pub at: u64,
    pub switches: Switches,
}

impl Operator for Thrower {
    fn demand(&mut self, now: Tick) -> Demand {
        if now.index == self.at {
            self.switches.emergency_stop.store(true, Ordering::Relaxed);
        }
        (&self.switches).demand(now)
    }
}

/// Everything a run needs, and what it left.
pub struct Rig {
    pub world: World,
    pub tank: Tank,
    pub people: Box<dyn Operator>,
    pub script: Script,
    pub follow: Follow,
    pub supervisor: Supervisor,
    pub book: Book,
    pub flight: FlightRecorder,
    pub log: FlightLog,
    pub overrun: OverrunPolicy,
}

/// Limits that a tank of 2 bar keeps, with a short aftermath.
pub fn limits() -> Limits {
    Limits { pressure_max_bar: 3.0, aftermath_ticks: 5, missing_max_ticks: 3, ..Limits::default() }
}

impl Rig {
    pub fn new(ticks: u64, voltage_v: f64) -> Self {
        Self::with(limits(), ticks, voltage_v)
    }

    pub fn with(limits: Limits, ticks: u64, voltage_v: f64) -> Self {
        let world = World::default();
        let (flight, log) = recorder();
        Rig {
            tank: Tank { world: world.clone(), ..Tank::default() },
            people: Box::new(()),
            script: Script { world: world.clone(), ticks, voltage_v, fixture: |_| Fixture::Free },
            follow: Follow { world: world.clone(), gain_v_bar: 0.0, answer: None, remembered: 0.0 },
            supervisor: Supervisor::new(limits).unwrap(),
            book: Book { world: world.clone(), samples: Vec::new(), room: usize::MAX, patient: true },
            flight,
            log,
            overrun: OverrunPolicy::default(),
            world,
        }
    }

    /// A run on the scripted clock.
    pub fn run(&mut self, number: u32) -> Result<RunReport, LoopError> {
        let mut clock = self.world.clone();
        self.run_by(&mut clock, number)
    }

    /// A run in lockstep, where no stage takes time.
    pub fn run_in_lockstep(&mut self, number: u32) -> Result<RunReport, LoopError> {
        self.run_by(&mut Lockstep::default(), number)
    }

    pub fn run_by(&mut self, clock: &mut dyn Clock, number: u32) -> Result<RunReport, LoopError> {
        let stages = Stages {
            clock,
            device: &mut self.tank,
            operator: &mut *self.people,
            supervisor: &mut self.supervisor,
            reference: &mut self.script,
            controller: &mut self.follow,
            publish: &mut self.book,
            flight: &mut self.flight,
        };
        run(stages, Run { number, overrun: self.overrun })
    }

    /// Ticks of the samples.
    pub fn ticks(&self) -> Vec<u64> {
        self.book.samples.iter().map(|s| s.tick).collect()
    }

    /// The sample of a tick that was run.
    pub fn sample(&self, tick: u64) -> Sample {
        *self.book.samples.iter().find(|s| s.tick == tick).unwrap_or_else(|| panic!("no sample of tick {tick}"))
    }
}

/// Milliseconds as the loop counts time.
pub fn ms(ms: f64) -> u64 {
    (ms * PERIOD_NS as f64).round() as u64
}
