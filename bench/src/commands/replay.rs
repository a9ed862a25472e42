//! `bench replay RECORDING`

use crate::failure::{Failure, Kind};
use crate::progress::Progress;
use crate::setup::Setup;
use profiles::Script;
use recordings::{CampaignError, Item, McapReader};
use rt_core::replay::{Replay, Verdict};
use rt_core::{LoopError, PERIOD_NS, Run, Sample, Stages, Supervisor};
use std::cell::RefCell;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Feed a recording's inputs through supervisor, profile and controller again and compare the outputs bit for bit
///
/// Exit code 3 and the first tick and field where they differ.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recordings, .mcap
    #[arg(required = true)]
    recordings: Vec<PathBuf>,
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    let mut differing = Vec::new();
    for path in &args.recordings {
        let begin = Instant::now();
        let Verdict { agreed, difference } = replay(path)?;
        let name = path.display();
        match difference {
            None => {
                let took_s = begin.elapsed().as_secs_f64();
                let recorded_s = (agreed * PERIOD_NS) as f64 * 1e-9;
                let speed = recorded_s / took_s;
                progress.result(&format!("{name}: {agreed} ticks agree bit for bit ({speed:.0} times real time)"));
            }
            Some(difference) => {
                progress.result(&format!("{name}: {agreed} ticks agree, then {difference}"));
                differing.push(name.to_string());
            }
        }
    }
    if differing.is_empty() {
        return Ok(());
    }
    Err(Failure::new(
        Kind::Acceptance,
        format!(
            "the replay differs from the recording: {}; this program decides otherwise than the one that `bench info` names as its maker, from the tick and field above on",
            differing.join(", ")
        ),
    ))
}

/// Replays one recording.
///
/// # Errors
/// A recording that is damaged, has losses, or does not hold its setup (2).
pub fn replay(path: &Path) -> Result<Verdict, Failure> {
    let file = path.display().to_string();
    let input = |e: &CampaignError| Failure::of(Kind::Input, e);
    let mut reader = McapReader::open(path).map_err(|e| input(&e))?;
    let recorded = reader.run().clone();
    let setup = Setup::of_recorded(&recorded, &file)?;
    let script = Script::parse(&recorded.profile, &file).map_err(|e| Failure::of(Kind::Input, &e))?;
    let context = profiles::Context { u_max_v: setup.u_max_v, seed: setup.seed, hands: setup.hands };
    let mut playback = script.compile(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
    let mut controller = setup.knowledge.controller(script.plane)?;
    let mut supervisor = Supervisor::new(setup.limits).map_err(|e| Failure::of(Kind::Input, &e))?;

    let broken = RefCell::new(None);
    let (mut flight, _log) = rt_core::flight::recorder();
    let (outcome, verdict) = {
        let mut samples = std::iter::from_fn(|| next_sample(&mut reader, &broken)).peekable();
        let number = samples.peek().map_or(0, |sample| sample.run);
        let replay = Replay::new(samples);
        let stages = Stages {
            clock: &mut replay.clock(),
            device: &mut replay.device(),
            operator: &mut replay.operator(),
            supervisor: &mut supervisor,
            reference: &mut playback,
            controller: &mut *controller,
            publish: &mut replay.comparison(),
            flight: &mut flight,
        };
        let outcome = rt_core::run(stages, Run { number, overrun: script.overrun });
        (outcome, replay.verdict())
    };
    if let Some(error) = broken.into_inner() {
        return Err(input(&error));
    }
    // A device that failed in the recorded run fails again; anything else the comparison has seen.
    if let Err(error @ LoopError::StillTripped { .. }) = outcome {
        return Err(Failure::of(Kind::Internal, &error));
    }
    if let Some(certificate) = reader.certificate().filter(|certificate| !certificate.is_lossless()) {
        let message = format!("{file}: expected a recording without losses, got {certificate}; it can't be replayed");
        return Err(Failure::new(Kind::Input, message));
    }
    Ok(verdict)
}

fn next_sample(reader: &mut McapReader, broken: &RefCell<Option<CampaignError>>) -> Option<Sample> {
    loop {
        match reader.next()? {
            Ok(Item::Sample(sample)) => return Some(sample),
            Ok(Item::Event(_) | Item::Amplifier(_)) => {}
            Err(error) => {
                *broken.borrow_mut() = Some(error);
                return None;
            }
        }
    }
}
