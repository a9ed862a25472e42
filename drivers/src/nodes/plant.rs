//! The plant between two SYNCs. No clock, no I/O: times are arguments, of one clock that never goes back.
//!
//! | what comes | what happens |
//! |---|---|
//! | SYNC k of a run | the state at tick k is measured and answered; its valves and fixture act from k on |
//! | a command of the amplifier within half a tick after SYNC k, or before SYNC k + 1 where that comes sooner | acts from k on |
//! | a later one | acts from k + 1 on |
//! | a SYNC whose counter went on by n | the plant moves by n ticks; where that is far more than the time that passed, by that time |
//! | a SYNC whose counter stands, or is one of before | is answered with the state as it is; it is no sign of life |
//! | no sign of life for the nodes' time-out | valves go to their safe state, the fixture to rest, and the plant goes on in the time that passes |
//! | a SYNC after that | nodes obey again; the plant moves to where the counter or the time that passed has it, whichever is further |
//! | a SYNC while no run goes on | the plant stands at tick 0 of a run, prepared as it was last said |
//!
//! So the measurements of a run are those of the same rig in process, bit for bit, as long as every command comes in time.
//!
//! A new preparation is a new value of `run`; another start, plane or filling before the run's first tick; or [`STOPPED_SYNCS`] SYNCs in a
//! row without a run after one. In a run the counter is the tick's number: the plant moves to that tick with its first SYNC.

use super::exchange::{Answer, Counted, Counter, News, Sync};
use crate::emulated::{EmulatedError, EmulatedRig, Pump};
use crate::wired::Preparation;
use rt_core::{Command, Device, Input, Measurement, PERIOD_NS, SafeState, Tick};

/// Makes the rig of a preparation.
pub type PlantFactory = Box<dyn FnMut(&Preparation) -> Result<EmulatedRig, EmulatedError> + Send>;

/// After a run, so many SYNCs in a row that say that none goes on are a new preparation: a single one may be a fault of the wire.
pub const STOPPED_SYNCS: u32 = 3;

/// A command of the amplifier counts for a SYNC until so long after it, ns.
const CUT_OFF_NS: u64 = PERIOD_NS / 2;

/// No frame of a bus comes later than this, ns, however patient nodes are.
const MOST_LATE_NS: u64 = 1_000_000_000;

/// See the module.
pub struct Plant {
    factory: PlantFactory,
    rig: EmulatedRig,
    /// What the rig was made for; `None` before the first preparation that was asked for.
    prepared: Option<Preparation>,
    node_timeout_ns: u64,
    safe_state: SafeState,
    /// The run's first SYNC has come.
    begun: bool,
    /// SYNCs in a row that said that no run goes on.
    stopped: u32,
    tick: u64,
    measured: Measurement,
    /// What acts from `tick` on; the rig is told when the next SYNC comes, as the voltage may still change.
    pending: Option<Command>,
    /// Valves and fixture as they are obeyed.
    acting: Command,
    /// The newest voltage that came, V.
    voltage_v: f64,
    /// A voltage that comes up to here still counts for `pending`, ns.
    cut_off_ns: u64,
    /// A voltage came for the SYNC that was last, and for the one that will be next.
    heard: (bool, bool),
    counter: Option<Counter>,
    /// Counter as it came last, fresh or not.
    echo: u64,
    /// When the last fresh command came, ns; `None` before the first.
    fresh_ns: Option<u64>,
    /// The tick of the last fresh command.
    fresh_tick: u64,
    timed_out: bool,
    valves_stuck: bool,
    failed: bool,
    counted: Counted,
    news: Vec<News>,
}

impl Plant {
    /// A plant that stands at tick 0. `idle` is the rig that is there before the first preparation; nodes time out after
    /// `node_timeout_ns` (> 0) to `safe_state`.
    pub fn new(factory: PlantFactory, idle: EmulatedRig, node_timeout_ns: u64, safe_state: SafeState) -> Plant {
        let acting = idle.command();
        let mut plant = Plant {
            factory,
            rig: idle,
            prepared: None,
            node_timeout_ns,
            safe_state,
            begun: false,
            stopped: 0,
            tick: 0,
            measured: Measurement::NONE,
            pending: None,
            acting,
            voltage_v: 0.0,
            cut_off_ns: 0,
            heard: (false, false),
            counter: None,
            echo: 0,
            fresh_ns: None,
            fresh_tick: 0,
            timed_out: false,
            valves_stuck: false,
            failed: false,
            counted: Counted::default(),
            news: vec![],
        };
        plant.measure(0);
        plant
    }

    /// A SYNC that was received at `received_ns` and is looked at at `now_ns`.
    pub fn sync(&mut self, sync: &Sync, received_ns: u64, now_ns: u64) -> Answer {
        self.poll(received_ns);
        self.counted.syncs += 1;
        self.echo = sync.counter.map_or(self.echo.wrapping_add(1), |counter| counter.value);
        if sync.running {
            self.run(sync, received_ns, now_ns)
        } else {
            self.stand(sync, received_ns)
        }
        self.answer()
    }

    /// A voltage (V) that the amplifier was told at `now_ns`.
    pub fn amplifier(&mut self, voltage_v: f64, now_ns: u64) {
        self.poll(now_ns);
        let most_v = self.rig.u_max_v();
        self.voltage_v = if voltage_v.is_nan() { 0.0 } else { voltage_v.clamp(-most_v, most_v) };
        if let Some(pending) = self.pending.as_mut().filter(|_| now_ns <= self.cut_off_ns) {
            pending.voltage_v = self.voltage_v;
            self.heard.0 = true;
        } else if self.begun && self.timed_out {
            let command = Command { voltage_v: self.voltage_v, ..self.acting };
            self.tell(self.tick, command);
        } else {
            self.heard.1 = true;
        }
    }

    /// Time has passed: nodes may time out, and then the plant goes on by itself. To be called every few ms.
    pub fn poll(&mut self, now_ns: u64) {
        let Some(fresh_ns) = self.fresh_ns else { return };
        let since_ns = now_ns.saturating_sub(fresh_ns);
        if since_ns < self.node_timeout_ns {
            return;
        }
        if !self.timed_out {
            self.time_out();
        }
        let tick = self.fresh_tick + since_ns / PERIOD_NS;
        if self.begun && tick > self.tick {
            self.measure(tick);
        }
    }

    /// What the nodes say without being asked.
    pub fn answer(&self) -> Answer {
        Answer {
            measurement: self.measured,
            counter: self.echo,
            brake_is_open: self.acting.brake_open,
            bypass_is_open: self.acting.bypass_open,
            timed_out: self.timed_out,
        }
    }

    /// The pump as it runs now.
    pub fn pump(&self) -> Pump {
        self.rig.pump()
    }

    /// Tick of the present run.
    pub fn tick(&self) -> u64 {
        self.tick
    }

    /// The valves stay where they are, whatever comes; or obey again.
    pub fn stick_valves(&mut self, stuck: bool) {
        self.valves_stuck = stuck;
    }

    /// What was counted.
    pub fn counted(&self) -> Counted {
        self.counted
    }

    /// What happened since the last call.
    pub fn news(&mut self) -> std::vec::Drain<'_, News> {
        self.news.drain(..)
    }

    /// A SYNC while no run goes on.
    fn stand(&mut self, sync: &Sync, received_ns: u64) {
        self.stopped = self.stopped.saturating_add(1);
        let wish = Preparation { start: Command { voltage_v: 0.0, ..sync.preparation.start }, ..sync.preparation };
        let anew = match self.prepared {
            None => true,
            Some(prepared) if self.begun => wish.run != prepared.run || self.stopped >= STOPPED_SYNCS,
            Some(prepared) => wish != prepared,
        };
        if anew {
            self.prepare(wish);
        }
        if self.begun {
            // A single frame of a run that goes on: nothing was heard.
            self.counted.repeated += 1;
            return;
        }
        if self.is_fresh(sync) {
            self.acting = self.obeyed(wish.start);
            self.refreshed(sync, received_ns);
        }
    }

    /// Makes the rig for a run. Where there can be none, the one before stays.
    fn prepare(&mut self, wish: Preparation) {
        self.prepared = Some(wish);
        match (self.factory)(&wish) {
            Ok(rig) => {
                self.rig = rig;
                self.news.push(News::Prepared(wish));
            }
            Err(error) => {
                self.counted.refused += 1;
                self.news.push(News::Refused(error.to_string()));
                return;
            }
        }
        self.counted.preparations += 1;
        self.failed = false;
        self.begun = false;
        self.pending = None;
        self.heard = (false, false);
        self.counter = None;
        self.measure(0);
    }

    /// A SYNC of a run.
    fn run(&mut self, sync: &Sync, received_ns: u64, now_ns: u64) {
        self.stopped = 0;
        let target = if !self.begun {
            self.begun = true;
            match sync.counter {
                // Its first frames may have been lost. A counter in its upper half is not that of a run's beginning.
                Some(Counter { value, modulus }) if self.prepared.is_some() && value < modulus / 2 => Some(value),
                _ => Some(0),
            }
        } else if self.timed_out {
            self.is_fresh(sync).then(|| {
                let ahead = match (sync.counter, self.counter) {
                    (Some(now), Some(before)) => now.since(before).unwrap_or(0),
                    _ => 0,
                };
                let passed = self.tick - self.fresh_tick.min(self.tick);
                // A counter that ran far ahead of the time that passed is another run's.
                let ahead = if ahead <= 2 * passed { ahead } else { passed };
                self.tick.max(self.fresh_tick + ahead)
            })
        } else {
            let since_ns = received_ns.saturating_sub(self.fresh_ns.unwrap_or(received_ns));
            let passed = ((since_ns + PERIOD_NS / 2) / PERIOD_NS).max(1);
            // The frame before may have come late, as far as nodes are patient.
            let most = 2 * passed + self.node_timeout_ns.min(MOST_LATE_NS) / PERIOD_NS;
            match (sync.counter, self.counter) {
                // As after a time-out: one that ran far ahead of the time that passed began anew.
                (Some(now), Some(before)) => {
                    now.since(before).map(|ahead| self.tick + if ahead <= most { ahead } else { passed })
                }
                _ => Some(self.tick + passed),
            }
        };
        let Some(target) = target else {
            self.counted.repeated += 1;
            return;
        };
        self.counted.passed_over += (target - self.tick).saturating_sub(1);
        if let Some(command) = self.pending.take() {
            self.counted.late += u64::from(!self.heard.0);
            self.tell(self.tick, command);
        }
        if target > self.tick {
            self.measure(target);
        }
        self.heard = (self.heard.1, false);
        self.acting = self.obeyed(sync.preparation.start);
        self.pending = Some(Command { voltage_v: self.voltage_v, ..self.acting });
        self.cut_off_ns = now_ns + CUT_OFF_NS;
        self.refreshed(sync, received_ns);
    }

    /// Whether this frame is a sign of life.
    fn is_fresh(&self, sync: &Sync) -> bool {
        match (sync.counter, self.counter) {
            // After a time-out the counter may have begun anew; only one that stands still says nothing.
            (Some(now), Some(before)) if self.timed_out => now != before,
            (Some(now), Some(before)) => now.since(before).is_some(),
            _ => true,
        }
    }

    fn refreshed(&mut self, sync: &Sync, received_ns: u64) {
        self.counter = sync.counter;
        self.fresh_ns = Some(received_ns);
        self.fresh_tick = self.tick;
        if std::mem::take(&mut self.timed_out) {
            self.news.push(News::Recovered(self.tick));
        }
    }

    /// A command as the valves obey it.
    fn obeyed(&self, command: Command) -> Command {
        let Command { brake_open, bypass_open, .. } = if self.valves_stuck { self.acting } else { command };
        Command { brake_open, bypass_open, ..command }
    }

    /// The nodes go to the safe state by themselves, so long after the last fresh command as is set.
    fn time_out(&mut self) {
        self.timed_out = true;
        self.counted.timeouts += 1;
        let at = if self.begun { self.fresh_tick + self.node_timeout_ns / PERIOD_NS } else { self.tick };
        self.news.push(News::TimedOut(at));
        if let Some(command) = self.pending.take() {
            self.tell(self.tick, command);
        }
        self.acting = self.obeyed(self.safe_state.command(self.acting.fixture, self.acting.segment));
        if self.begun {
            self.tell(at, Command { voltage_v: self.voltage_v, ..self.acting });
            self.measure(at);
        }
    }

    /// Tells the rig a command from this tick on. Where no rig could be told, the fixture stays as it is, or comes to rest.
    fn tell(&mut self, tick: u64, command: Command) {
        let before = self.rig.command().fixture;
        let others = [before, before.at_rest()].map(|fixture| Command { fixture, ..command });
        let now = Tick::at(tick);
        let Err(error) = self.rig.write(now, &command) else { return };
        self.counted.refused += 1;
        self.news.push(News::Refused(error.to_string()));
        let _ = others.iter().any(|other| self.rig.write(now, other).is_ok());
    }

    /// Moves on to this tick, and measures there.
    fn measure(&mut self, tick: u64) {
        self.tick = tick;
        self.measured = match self.rig.read(Tick::at(tick)) {
            Ok(measured) => measured,
            Err(error) => {
                if !std::mem::replace(&mut self.failed, true) {
                    self.news.push(News::Failed(error.to_string()));
                }
                Measurement { faulty: Input::ALL.iter().map(|input| input.bit()).sum(), ..Measurement::NONE }
            }
        };
    }
}
