//! The loop as `bench run --realtime` drives it: emulated rig, a profile, supervisor, flight recorder, publication. What
//! each tick took is kept in memory that exists before the slice, and looked at after it.

use crate::controller::PumpController;
use crate::failure::{Failure, Kind};
use crate::latency::statistics::Distribution;
use drivers::EmulatedRig;
use drivers::emulated::Settings as RigSettings;
use model::Parameters;
use model::effects::EffectSet;
use profiles::{Context, Plane, Playback, Script};
use rt_core::{
    Ended, FlightLog, FlightRecorder, Handover, Limits, LoopError, Measurement, OverrunPolicy, PERIOD_NS, Publication,
    Publish, RealTime, Reference, Run, RunReport, Sample, Stages, Step, Supervisor, Tick,
};

/// Stages of a tick before the hand-over, in their order.
pub const STAGES: [&str; 5] = ["read", "check", "reference", "control", "write"];

/// Everything of one slice but the publication, ready to go to the loop's thread.
pub struct RealLoop {
    rig: EmulatedRig,
    reference: Cut,
    supervisor: Supervisor,
    flight: FlightRecorder,
    _incidents: FlightLog,
    run: Run,
    kept: Vec<Kept>,
}

/// What a tick leaves for the evaluation.
#[derive(Clone, Copy)]
struct Kept {
    lateness_ns: u64,
    stages_ns: [u32; STAGES.len()],
    /// Hand-over and accounting of the tick before.
    publish_before_ns: u32,
}

/// What a slice of the real loop took.
#[derive(Clone, Debug)]
pub struct Taken {
    /// Lateness of the wake-ups.
    pub lateness: Distribution,
    /// From the first stage to the end of the last one.
    pub tick: Distribution,
    /// Each of [`STAGES`].
    pub stages: [Distribution; STAGES.len()],
    /// Hand-over to the publication, with the accounting.
    pub publish: Distribution,
    /// What the loop says.
    pub report: RunReport,
}

impl RealLoop {
    /// Prepares slice `run` of `ticks` periods.
    ///
    /// # Errors
    /// None but a defect: rig, script and limits are the program's own (1).
    pub fn new(run: u32, ticks: u64) -> Result<Self, Failure> {
        let defect = |error: &dyn std::error::Error| Failure::of(Kind::Internal, error);
        let parameters = Parameters::example();
        let seconds = (ticks * PERIOD_NS) as f64 * 1e-9;
        let script = Script::parse(&square_wave(seconds), "latency.toml").map_err(|e| defect(&e))?;
        let context = Context { u_max_v: parameters.pump.u_max, seed: 0, hands: profiles::Hands::Rig };
        let profile = script.compile(&context).map_err(|e| defect(&e))?;
        let settings = RigSettings {
            start: script.start(),
            vertical: script.plane == Plane::Vertical,
            seed: u64::from(run),
            ..RigSettings::default()
        };
        let rig = EmulatedRig::new(&parameters, EffectSet::none(), settings).map_err(|e| defect(&e))?;
        let supervisor = Supervisor::new(Limits::default()).map_err(|e| defect(&e))?;
        let (flight, _incidents) = rt_core::flight::recorder();
        // Written once, so that no page is missing when the loop comes to it.
        let unused = Kept { lateness_ns: u64::MAX, stages_ns: [u32::MAX; STAGES.len()], publish_before_ns: u32::MAX };
        let mut kept = vec![unused; usize::try_from(ticks).unwrap_or(usize::MAX)];
        kept.clear();
        let reference = Cut { profile, last: ticks - 1 };
        let run = Run { number: run, overrun: OverrunPolicy::Skip };
        Ok(RealLoop { rig, reference, supervisor, flight, _incidents, run, kept })
    }

    /// Drives the slice. To be called in a thread that was prepared for it.
    pub fn drive(&mut self, publication: &mut Publication) -> Result<RunReport, LoopError> {
        let stages = Stages {
            clock: &mut RealTime::default(),
            device: &mut self.rig,
            operator: &mut (),
            supervisor: &mut self.supervisor,
            reference: &mut self.reference,
            controller: &mut PumpController::open_loop(),
            publish: &mut Keeping { publication, kept: &mut self.kept },
            flight: &mut self.flight,
        };
        rt_core::run(stages, self.run)
    }

    /// Looks at what the slice left.
    ///
    /// # Errors
    /// The device failed (4), the supervisor tripped (5).
    pub fn taken(&self, outcome: Result<RunReport, LoopError>) -> Result<Taken, Failure> {
        let report = outcome.map_err(|e| Failure::of(Kind::Device, &e))?;
        if report.ended != Ended::Completed {
            return Err(Failure::new(Kind::Safety, report.to_string()));
        }
        let mut taken = Taken {
            lateness: Distribution::default(),
            tick: Distribution::default(),
            stages: Default::default(),
            publish: Distribution::default(),
            report,
        };
        for (index, kept) in self.kept.iter().enumerate() {
            taken.lateness.record_ns(kept.lateness_ns);
            for (stage, ns) in taken.stages.iter_mut().zip(kept.stages_ns) {
                stage.record_ns(u64::from(ns));
            }
            // A tick's hand-over is told by the tick after it; that of the last one is not told.
            if let Some(next) = self.kept.get(index + 1) {
                let publish_ns = u64::from(next.publish_before_ns);
                taken.publish.record_ns(publish_ns);
                taken.tick.record_ns(kept.stages_ns.iter().map(|ns| u64::from(*ns)).sum::<u64>() + publish_ns);
            }
        }
        Ok(taken)
    }
}

/// A square wave between two angles that lasts for at least `seconds`: a pass takes 0.2 s or more.
fn square_wave(seconds: f64) -> String {
    let passes = (seconds / 0.2).ceil().max(1.0);
    format!(
        r#"
name = "latency"
protocol = "square-wave"
role = "validate"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[[step]]
repeat = {passes}
  [[step.step]]
  voltage_u_max = 0.9
  until = [{{ channel = "angle_deg", above = 30.0 }}]
  timeout_s = 11.0
  [[step.step]]
  voltage_u_max = -0.9
  until = [{{ channel = "angle_deg", below = -30.0 }}]
  timeout_s = 11.0
"#
    )
}

/// A profile that ends at a tick of ours.
struct Cut {
    profile: Playback,
    last: u64,
}

impl Reference for Cut {
    fn step(&mut self, now: Tick, measured: &Measurement) -> Step {
        let step = self.profile.step(now, measured);
        // Not at `last` alone: that tick may be one that is passed over.
        Step { last: step.last || now.index >= self.last, ..step }
    }
}

/// The publication; a few words of each sample are kept beside it.
struct Keeping<'a> {
    publication: &'a mut Publication,
    kept: &'a mut Vec<Kept>,
}

impl Publish for Keeping<'_> {
    fn publish(&mut self, sample: &Sample) -> Handover {
        // No more ticks than periods: the room is never exceeded, and nothing is allocated.
        if self.kept.len() < self.kept.capacity() {
            self.kept.push(Kept {
                lateness_ns: sample.lateness_ns,
                stages_ns: [sample.read_ns, sample.check_ns, sample.reference_ns, sample.control_ns, sample.write_ns],
                publish_before_ns: sample.publish_ns,
            });
        }
        self.publication.publish(sample)
    }

    fn publish_patiently(&mut self, sample: &Sample) -> Handover {
        self.publication.publish_patiently(sample)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{Lockstep, Target};

    /// In virtual time the profile outlasts the slice, and drives the lever to and fro without a trip.
    #[test]
    fn the_slice_ends_at_its_last_tick_and_moves_the_rig() {
        let ticks = 20_000;
        let mut slice = RealLoop::new(3, ticks).expect("the program's own rig");
        let mut samples: Vec<Sample> = Vec::new();
        let stages = Stages {
            clock: &mut Lockstep::default(),
            device: &mut slice.rig,
            operator: &mut (),
            supervisor: &mut slice.supervisor,
            reference: &mut slice.reference,
            controller: &mut PumpController::open_loop(),
            publish: &mut samples,
            flight: &mut slice.flight,
        };
        let report = rt_core::run(stages, slice.run).expect("the emulated rig does not fail");
        assert_eq!((report.ended, report.statistics.ticks), (Ended::Completed, ticks));
        let angles = || samples.iter().map(|s| s.angle_deg);
        assert!(angles().fold(f64::MIN, f64::max) > 30.0 && angles().fold(f64::MAX, f64::min) < -30.0);
        assert!(samples.last().is_some_and(|s| s.last()) && !samples.iter().rev().skip(1).any(|s| s.last()));
    }

    #[test]
    fn a_slice_ends_even_where_its_last_tick_is_passed_over() {
        let RealLoop { mut reference, .. } = RealLoop::new(0, 100).expect("the program's own rig");
        let mut last = |index| reference.step(Tick::at(index), &Measurement::NONE).last;
        assert!(!last(98) && last(103));
        assert!(matches!(reference.step(Tick::at(104), &Measurement::NONE).target, Target::VoltageV(_)));
    }

    #[test]
    fn a_tick_is_its_stages_and_the_hand_over_that_the_next_one_tells() {
        let mut slice = RealLoop::new(0, 100).expect("the program's own rig");
        let kept = |lateness_ns, publish_before_ns| Kept {
            lateness_ns,
            stages_ns: [1000, 20, 30, 40, 500],
            publish_before_ns,
        };
        slice.kept = vec![kept(7000, 0), kept(9000, 300), kept(8000, 400)];
        let report = RunReport { run: 0, ended: Ended::Completed, trip: None, statistics: Default::default() };
        let taken = slice.taken(Ok(report.clone())).expect("completed");
        assert_eq!((taken.lateness.count(), taken.tick.count(), taken.publish.count()), (3, 2, 2));
        assert_eq!(taken.tick.pairs_ns().iter().map(|p| p.0).collect::<Vec<_>>(), [1890, 1990]);
        assert_eq!(taken.stages[4].quantile_us(1.0), 0.5);
        let tripped = RunReport { ended: Ended::Tripped, ..report };
        assert_eq!(slice.taken(Ok(tripped)).expect_err("no measurement").exit_code(), 5);
    }
}
