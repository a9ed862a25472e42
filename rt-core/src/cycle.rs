//! The tick as a table of contents, and the run around it.
//!
//! Sample k holds the measurement at tick k and the command that was written at tick k and acts from k on.

use crate::clock::{Clock, Wake};
use crate::confirmation::Waiting;
use crate::flight::{FlightRecorder, FlightTick};
use crate::overrun::OverrunPolicy;
use crate::publish::{Handover, Publish};
use crate::statistics::{Ended, RunReport, Statistics};
use crate::supervisor::{Supervisor, Trip};
use crate::traits::{Controller, Demand, Device, DeviceError, Operator, Reference, Step, Target};
use crate::types::{Command, Fixture, Measurement, SAMPLE_VERSION, Sample, Tick, flags};

/// The stages that a tick goes through, and its clock.
pub struct Stages<'a> {
    /// Where ticks come from.
    pub clock: &'a mut dyn Clock,
    /// The rig.
    pub device: &'a mut dyn Device,
    /// What people ask for.
    pub operator: &'a mut dyn Operator,
    /// Judges what was read and what is to be written.
    pub supervisor: &'a mut Supervisor,
    /// What is wanted.
    pub reference: &'a mut dyn Reference,
    /// How it is reached.
    pub controller: &'a mut dyn Controller,
    /// Who hears of it.
    pub publish: &'a mut dyn Publish,
    /// What remembers the last ticks.
    pub flight: &'a mut FlightRecorder,
}

/// Which run, and what a missed deadline means in it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Numbers the samples; must differ from run to run within the life of the publication.
    pub number: u32,
    /// The profile's policy.
    pub overrun: OverrunPolicy,
}

/// Why a run could not be driven to its end. A trip is no error: it is in the report.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LoopError {
    /// The device failed; the safe state was ordered at once, and the last sample carries [`flags::FAULT`].
    #[error("run {run}: {source}; safe state: {}", match safe_state { Ok(()) => "written".to_owned(), Err(e) => format!("NOT written, {e}") })]
    Device {
        /// Number of the run.
        run: u32,
        /// What failed.
        #[source]
        source: DeviceError,
        /// Whether the safe state could be written.
        safe_state: Result<(), DeviceError>,
        /// The counts, the failed tick among them.
        statistics: Box<Statistics>,
    },
    /// The run was refused, because a trip is still latched.
    #[error("run {run} refused: the supervisor is still tripped ({trip}); remove the cause, then reset the supervisor")]
    StillTripped {
        /// Number of the run.
        run: u32,
        /// The latched trip.
        trip: Trip,
    },
}

/// Drives one run: until the reference's last tick, a trip and its aftermath, or a stop. Afterwards the safe state is
/// written once more, whatever happened.
///
/// Allocates nothing and makes no system call of its own between the first tick and the last, but the clock's wait.
pub fn run(stages: Stages<'_>, run: Run) -> Result<RunReport, LoopError> {
    if let Some(trip) = stages.supervisor.trip() {
        return Err(LoopError::StillTripped { run: run.number, trip: *trip });
    }
    let fixture = stages.reference.fixture_at_start();
    let mut cycle = Cycle {
        stages,
        run,
        statistics: Statistics::default(),
        acting: (fixture, 0),
        waiting: None,
        done_ns: 0,
        skipped: 0,
        overrun: false,
        publish_ns: 0,
        untaken: None,
    };
    cycle.begin();
    let mut index = 0;
    loop {
        let wake = cycle.stages.clock.wait(index);
        match cycle.tick(&wake) {
            Ok(None) => index = cycle.next(&wake),
            Ok(Some(ended)) => return cycle.finish(index, ended),
            Err(source) => return Err(cycle.fail(&wake, source)),
        }
    }
}

struct Cycle<'a> {
    stages: Stages<'a>,
    run: Run,
    statistics: Statistics,
    /// Fixture and segment of the last command.
    acting: (Fixture, u32),
    /// What the last step waited for.
    waiting: Option<Waiting>,
    /// When the last tick's work was done, ns since the run's start. One reading decides whether it was late: for the policy, the
    /// statistics and the flight recorder alike.
    done_ns: u64,
    skipped: u64,
    /// The tick before this one ended too late.
    overrun: bool,
    /// Duration of the last hand-over.
    publish_ns: u32,
    /// The last sample, where the publication's queue had no room for it.
    untaken: Option<Sample>,
}

impl Cycle<'_> {
    fn begin(&mut self) {
        let Stages { clock, device, supervisor, controller, flight, .. } = &mut self.stages;
        supervisor.begin_run();
        supervisor.held_at_start(self.acting.0);
        controller.begin_run();
        flight.begin_run();
        clock.start();
        device.begin_run(clock.origin_ns());
    }

    /// One tick. Returns how the run ended, if this was its last.
    fn tick(&mut self, wake: &Wake) -> Result<Option<Ended>, DeviceError> {
        let now = wake.tick;
        let Stages { clock, device, operator, supervisor, reference, controller, publish, flight } = &mut self.stages;
        let mut lap = Lap::begin(*clock);

        let demand = operator.demand(now);
        let stopping = demand == Demand::Stop || (self.overrun && self.run.overrun == OverrunPolicy::Abort);
        let mut measured = device.read(now)?.without_infinities();
        let read_ns = lap.split(*clock);
        supervisor.check(now, demand, &measured);
        let check_ns = lap.split(*clock);
        // A rig that goes safe waits for nobody: who confirms now is told so.
        let waiting = self.waiting.filter(|_| !stopping && supervisor.trip().is_none());
        let confirmation = operator.confirmation(now, waiting, &measured).filter(|_| waiting.is_some());
        if let Some(confirmation) = confirmation {
            confirmation.enter(&mut measured);
            reference.confirmed(now);
        }
        let step = reference.step(now, &measured);
        let reference_ns = lap.split(*clock);
        // A controller is not asked where its answer can't be used: it must not integrate against a rig that does not follow.
        let command = if stopping || supervisor.trip().is_some() {
            supervisor.rest(now, step.fixture, step.segment)
        } else {
            supervisor.release(now, wanted(now, &measured, &step, *controller))
        };
        // Where the slew limit holds the pump back from 0 V, the rig does not rest yet.
        supervisor.hands_on(step.hands_on && command.voltage_v == 0.0);
        self.waiting = step.waiting;
        let control_ns = lap.split(*clock);
        device.write(now, &command)?;
        let write_ns = lap.split(*clock);

        let ended = ended(now, &step, supervisor, demand, stopping);
        let state = self.run.state(supervisor, demand, self.overrun) | if ended.is_some() { flags::LAST } else { 0 };
        let waits = step.waiting.is_some() && !stopping && supervisor.trip().is_none();
        let state =
            state | if waits { flags::WAITING } else { 0 } | if confirmation.is_some() { flags::CONFIRMED } else { 0 };
        let timed = Timed { read_ns, check_ns, reference_ns, control_ns, write_ns, publish_ns: self.publish_ns };
        let mut sample = self.run.sample(wake, self.skipped, &timed, &measured, &command, state);
        sample.step = step.index;
        let (target_of, target) = step.target.told();
        (sample.target_of, sample.target) = (target_of.code(), target);
        sample.trip = supervisor.trip().map_or(0, Trip::code);
        let handover = publish.publish(&sample);
        self.publish_ns = lap.split(*clock);

        self.done_ns = lap.last_ns;
        let ended_ns = self.done_ns.saturating_sub(now.scheduled_ns);
        let flown = FlightTick { sample, publish_ns: self.publish_ns, ended_ns };
        self.statistics.account(&flown, handover);
        flight.record(flown);
        self.acting = (command.fixture, command.segment);
        self.untaken = (handover == Handover::Lost && ended.is_some()).then_some(sample);
        Ok(ended)
    }

    /// The tick that follows, by the overrun policy.
    fn next(&mut self, wake: &Wake) -> u64 {
        let index = wake.tick.index;
        let now_ns = self.done_ns;
        self.overrun = now_ns >= Tick::at(index + 1).scheduled_ns;
        if !self.overrun {
            return index + 1;
        }
        let next = self.run.overrun.next(index, now_ns);
        self.skipped += next - (index + 1);
        match self.run.overrun {
            OverrunPolicy::Skip | OverrunPolicy::CatchUp => {}
            OverrunPolicy::SafeState => {
                let late_ns = now_ns - wake.tick.scheduled_ns;
                self.stages.supervisor.deadline_missed(Tick::at(next), late_ns);
            }
            OverrunPolicy::Abort => {
                // At once; the tick that closes the run writes it again and says so if that fails.
                let safe = self.safe_command();
                let _ = self.stages.device.write(Tick::at(index), &safe);
            }
        }
        next
    }

    fn safe_command(&self) -> Command {
        let (fixture, segment) = self.acting;
        self.stages.supervisor.limits().safe_state.command(fixture, segment)
    }

    /// The last tick's command acts until the next tick would begin; outputs are not left at it.
    fn finish(mut self, index: u64, ended: Ended) -> Result<RunReport, LoopError> {
        let safe = self.safe_command();
        let Stages { clock, device, supervisor, publish, flight, .. } = self.stages;
        // After a tick that took too long this returns at once.
        let written = device.write(clock.wait(index + 1).tick, &safe).and_then(|()| device.end_run());
        // The rig is safe: whoever follows the samples is told of the end, now that waiting for room does no harm.
        if let Some(sample) = self.untaken.take()
            && publish.publish_patiently(&sample) == Handover::Taken
        {
            self.statistics.not_taken -= 1;
        }
        self.statistics.incidents_dropped = flight.end_run();
        let run = self.run.number;
        let statistics = self.statistics;
        let failed = |source: DeviceError| LoopError::Device {
            run,
            safe_state: Err(source.clone()),
            source,
            statistics: Box::new(statistics),
        };
        written.map_err(failed)?;
        Ok(RunReport { run, ended, trip: supervisor.trip().copied(), statistics: self.statistics })
    }

    /// The device failed within this tick: safe state at once, and a last sample, so that loggers can close the run.
    fn fail(mut self, wake: &Wake, source: DeviceError) -> LoopError {
        let safe = self.safe_command();
        let Stages { clock, device, supervisor, publish, flight, .. } = self.stages;
        let safe_state = device.write(wake.tick, &safe).and_then(|()| device.end_run());
        let ended_ns = clock.now_ns().saturating_sub(wake.tick.scheduled_ns);
        // The safe state was not held back by the slew limit, whatever command it replaces.
        let state = self.run.state(supervisor, Demand::None, self.overrun) & !flags::SLEW_LIMITED;
        let state = state | flags::LAST | flags::FAULT;
        let timed = Timed { publish_ns: self.publish_ns, ..Timed::default() };
        let mut sample = self.run.sample(wake, self.skipped, &timed, &Measurement::NONE, &safe, state);
        sample.trip = supervisor.trip().map_or(0, Trip::code);
        let handover = publish.publish_patiently(&sample);
        let flown = FlightTick { sample, publish_ns: 0, ended_ns };
        self.statistics.account(&flown, handover);
        flight.record(flown);
        self.statistics.incidents_dropped = flight.end_run();
        LoopError::Device { run: self.run.number, source, safe_state, statistics: Box::new(self.statistics) }
    }
}

/// The command that reference and controller ask for.
fn wanted(now: Tick, measured: &Measurement, step: &Step, controller: &mut dyn Controller) -> Command {
    Command {
        voltage_v: controller.control(now, measured, step),
        brake_open: step.brake_open,
        bypass_open: step.bypass_open,
        fixture: step.fixture,
        segment: step.segment,
    }
}

fn ended(now: Tick, step: &Step, supervisor: &Supervisor, demand: Demand, stopping: bool) -> Option<Ended> {
    if !(step.last || stopping || supervisor.aftermath_over(now)) {
        return None;
    }
    Some(match supervisor.trip() {
        Some(_) => Ended::Tripped,
        None if demand == Demand::Stop => Ended::Stopped,
        None if stopping => Ended::Aborted,
        None => Ended::Completed,
    })
}

/// Times the stages of a tick.
struct Lap {
    last_ns: u64,
}

impl Lap {
    fn begin(clock: &mut dyn Clock) -> Self {
        Lap { last_ns: clock.now_ns() }
    }

    /// Time since the last split, ns.
    fn split(&mut self, clock: &mut dyn Clock) -> u32 {
        let now_ns = clock.now_ns();
        let since_ns = now_ns.saturating_sub(self.last_ns);
        self.last_ns = now_ns;
        saturated(since_ns)
    }
}

/// Durations of a tick's stages, ns.
#[derive(Default)]
struct Timed {
    read_ns: u32,
    check_ns: u32,
    reference_ns: u32,
    control_ns: u32,
    write_ns: u32,
    /// Of the tick before.
    publish_ns: u32,
}

fn saturated(ns: u64) -> u32 {
    u32::try_from(ns).unwrap_or(u32::MAX)
}

impl Run {
    /// The flags but those of the command and the run's end.
    fn state(&self, supervisor: &Supervisor, demand: Demand, overrun: bool) -> u32 {
        [
            (supervisor.trip().is_some(), flags::TRIPPED),
            (demand == Demand::Stop, flags::STOPPED),
            (overrun, flags::OVERRUN),
            (supervisor.slew_limited(), flags::SLEW_LIMITED),
        ]
        .into_iter()
        .fold(0, |bits, (set, bit)| if set { bits | bit } else { bits })
    }

    fn sample(
        &self,
        wake: &Wake,
        skipped: u64,
        timed: &Timed,
        measured: &Measurement,
        command: &Command,
        state: u32,
    ) -> Sample {
        let brake = if command.brake_open { flags::BRAKE_OPEN } else { 0 };
        let bypass = if command.bypass_open { flags::BYPASS_OPEN } else { 0 };
        Sample {
            version: SAMPLE_VERSION,
            run: self.number,
            tick: wake.tick.index,
            scheduled_ns: wake.tick.scheduled_ns,
            woken_ns: wake.woken_ns,
            lateness_ns: wake.lateness_ns,
            skipped,
            voltage_v: command.voltage_v,
            angle_deg: measured.angle_deg,
            pressure1_bar: measured.pressure1_bar,
            pressure2_bar: measured.pressure2_bar,
            torque_nm: measured.torque_nm,
            volume_ml: measured.volume_ml,
            age_ns: measured.age_ns,
            heartbeat_age_ns: measured.heartbeat_age_ns,
            behind_ns: saturated(wake.behind_ns),
            read_ns: timed.read_ns,
            check_ns: timed.check_ns,
            reference_ns: timed.reference_ns,
            control_ns: timed.control_ns,
            write_ns: timed.write_ns,
            publish_ns: timed.publish_ns,
            segment: command.segment,
            step: 0,
            flags: brake | bypass | state,
            quality: measured.valid() | (measured.faulty & FAULTY_BITS) << 8,
            trip: 0,
            target: f64::NAN,
            target_of: 0,
            reserved: 0,
        }
    }
}

/// The bits of the inputs that there are.
const FAULTY_BITS: u32 = 0x1f;

/// Open loop: the target's voltage is the answer. Any other target is refused with NaN, which trips the supervisor.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenLoop;

impl Controller for OpenLoop {
    fn control(&mut self, _now: Tick, _measured: &Measurement, step: &Step) -> f64 {
        match step.target {
            Target::VoltageV(voltage_v) => voltage_v,
            _ => f64::NAN,
        }
    }
}
