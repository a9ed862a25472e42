//! The tick as a table of contents, and the run around it.
//!
//! Sample k holds the measurement at tick k and the command that was written at tick k and acts from k to k+1.

use std::sync::atomic::{AtomicBool, Ordering};

use crate::clock::{Clock, Wake};
use crate::publish::Publish;
use crate::statistics::{Ended, RunReport, Statistics};
use crate::supervisor::{Supervisor, Trip};
use crate::traits::{Controller, Device, DeviceError, Reference, Step, Target};
use crate::types::{Command, Measurement, SAMPLE_VERSION, Sample, Tick, flags};

/// The stages that a tick goes through, and its clock.
pub struct Stages<'a> {
    /// Where ticks come from.
    pub clock: &'a mut dyn Clock,
    /// The rig.
    pub device: &'a mut dyn Device,
    /// Judges what was read and what is to be written.
    pub supervisor: &'a mut Supervisor,
    /// What is wanted.
    pub reference: &'a mut dyn Reference,
    /// How it is reached.
    pub controller: &'a mut dyn Controller,
    /// Who hears of it.
    pub publish: &'a mut dyn Publish,
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
/// `run` numbers the samples; it must differ from run to run within the life of the publication. `stop` may be set
/// from any thread; the next tick writes the safe state and is the last.
pub fn run(stages: Stages<'_>, run: u32, stop: &AtomicBool) -> Result<RunReport, LoopError> {
    if let Some(trip) = stages.supervisor.trip() {
        return Err(LoopError::StillTripped { run, trip: *trip });
    }
    let mut cycle = Cycle { stages, run, statistics: Statistics::default(), segment: 0 };
    cycle.stages.supervisor.begin_run();
    cycle.stages.clock.start();
    loop {
        let wake = cycle.stages.clock.next();
        let stopping = stop.load(Ordering::Relaxed);
        match cycle.tick(&wake, stopping) {
            Ok(true) => return cycle.finish(stopping),
            Ok(false) => {}
            Err(source) => return Err(cycle.fail(&wake, source)),
        }
    }
}

struct Cycle<'a> {
    stages: Stages<'a>,
    run: u32,
    statistics: Statistics,
    segment: u32,
}

impl Cycle<'_> {
    /// One tick. Returns whether it was the run's last.
    fn tick(&mut self, wake: &Wake, stopping: bool) -> Result<bool, DeviceError> {
        let now = wake.tick;
        let Stages { device, supervisor, reference, controller, publish, .. } = &mut self.stages;

        let measured = device.read(now)?;
        supervisor.check(now, &measured);
        let step = reference.step(now, &measured);
        let wanted = wanted(now, &measured, &step, *controller, supervisor.trip().is_some() || stopping);
        let command = supervisor.release(now, wanted);
        device.write(now, &command)?;
        let last = step.last || stopping || supervisor.aftermath_over(now);
        let sample = sample(self.run, wake, &measured, &command, state(supervisor.trip().is_some(), last));
        let handover = publish.publish(&sample);
        self.statistics.account(wake, handover);
        self.segment = command.segment;
        Ok(last)
    }

    /// The last tick's command acts until the next tick would begin; outputs are not left at it.
    fn finish(self, stopping: bool) -> Result<RunReport, LoopError> {
        let Stages { clock, device, supervisor, .. } = self.stages;
        let safe = Command { segment: self.segment, ..Command::SAFE };
        device.write(clock.next().tick, &safe).map_err(|source| LoopError::Device {
            run: self.run,
            safe_state: Err(source.clone()),
            source,
        })?;
        let trip = supervisor.trip().copied();
        let ended = match trip {
            Some(_) => Ended::Tripped,
            None if stopping => Ended::Stopped,
            None => Ended::Completed,
        };
        Ok(RunReport { run: self.run, ended, trip, statistics: self.statistics })
    }

    /// The device failed within this tick: safe state at once, and a last sample, so that loggers can close the run.
    fn fail(self, wake: &Wake, source: DeviceError) -> LoopError {
        let safe = Command { segment: self.segment, ..Command::SAFE };
        let safe_state = self.stages.device.write(wake.tick, &safe);
        let state = state(self.stages.supervisor.trip().is_some(), true) | flags::FAULT;
        let sample = sample(self.run, wake, &Measurement::NONE, &safe, state);
        self.stages.publish.publish(&sample);
        LoopError::Device { run: self.run, source, safe_state }
    }
}

/// The command that reference and controller ask for. A controller is not asked where its answer can't be used: it
/// must not integrate against a rig that does not follow it.
fn wanted(now: Tick, measured: &Measurement, step: &Step, controller: &mut dyn Controller, safe: bool) -> Command {
    if safe {
        return Command { segment: step.segment, ..Command::SAFE };
    }
    Command {
        voltage_v: controller.control(now, measured, step),
        brake_open: step.brake_open,
        bypass_open: step.bypass_open,
        fixture: step.fixture,
        segment: step.segment,
    }
}

fn state(tripped: bool, last: bool) -> u32 {
    (if tripped { flags::TRIPPED } else { 0 }) | (if last { flags::LAST } else { 0 })
}

fn sample(run: u32, wake: &Wake, measured: &Measurement, command: &Command, state: u32) -> Sample {
    let brake = if command.brake_open { flags::BRAKE_OPEN } else { 0 };
    let bypass = if command.bypass_open { flags::BYPASS_OPEN } else { 0 };
    Sample {
        version: SAMPLE_VERSION,
        run,
        tick: wake.tick.index,
        scheduled_ns: wake.tick.scheduled_ns,
        lateness_ns: wake.lateness_ns,
        input_age_ns: 0,
        voltage_v: command.voltage_v,
        angle_deg: measured.angle_deg,
        pressure1_bar: measured.pressure1_bar,
        pressure2_bar: measured.pressure2_bar,
        torque_nm: measured.torque_nm,
        volume_ml: measured.volume_ml,
        segment: command.segment,
        flags: brake | bypass | state,
    }
}

/// Open loop: the target's voltage is the answer. A flow target is refused with NaN, which trips the supervisor.
#[derive(Clone, Copy, Debug, Default)]
pub struct OpenLoop;

impl Controller for OpenLoop {
    fn control(&mut self, _now: Tick, _measured: &Measurement, step: &Step) -> f64 {
        match step.target {
            Target::VoltageV(voltage_v) => voltage_v,
            Target::FlowMlS(_) => f64::NAN,
        }
    }
}
