//! `bench stop [--emergency] [--instance NAME]`

use crate::failure::{Failure, Kind};
use crate::operator::PREPARATION;
use crate::progress::Progress;
use rt_core::{Delivery, RunCommand, Sample, SampleSubscriber, send_command};
use std::time::{Duration, Instant};

/// The loop hears a command within a tick; this long its answer may take.
const PATIENCE: Duration = Duration::from_secs(3);

/// Stop a run of another process: orderly, or as an emergency
///
/// Both drive the rig to its safe state in the next tick. An emergency stop trips the supervisor, which latches.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Emergency stop: trips
    #[arg(long)]
    emergency: bool,
    /// Instance that runs
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let link = |e| Failure::of(Kind::Device, &e);
    let (command, heard): (_, fn(&Sample) -> bool) =
        if args.emergency { (RunCommand::EmergencyStop, Sample::tripped) } else { (RunCommand::Stop, Sample::last) };
    // Before the command: its effect shows in the samples.
    let mut subscriber = SampleSubscriber::open(&args.instance, Delivery::BestEffort).map_err(link)?;
    let answer = send_command(&args.instance, command, PATIENCE).map_err(link)?;
    if let Err(refusal) = answer.taken {
        return Err(Failure::new(Kind::Device, format!("not taken: {refusal}")));
    }
    if answer.open.is_some_and(|open| open.request == PREPARATION) {
        progress.result("stopped before the run: the rig was still being prepared");
        return Ok(());
    }
    let begin = Instant::now();
    let mut samples = Vec::new();
    while begin.elapsed() < PATIENCE {
        samples.clear();
        subscriber.receive(Duration::from_millis(100), &mut samples).map_err(link)?;
        if let Some(sample) = samples.iter().find(|sample| heard(sample)) {
            let what = if sample.tripped() { "tripped" } else { "stopped" };
            progress.result(&format!("{what} at tick {}: {} V, safe state", sample.tick, sample.voltage_v));
            return Ok(());
        }
    }
    let message = format!(
        "instance {:?} took the command, but no sample within {} s shows it: no run goes on, or its publication \
         stalls. Look at the run's own terminal; where the rig may still move, use its emergency stop",
        args.instance,
        PATIENCE.as_secs()
    );
    Err(Failure::new(Kind::Device, message))
}
