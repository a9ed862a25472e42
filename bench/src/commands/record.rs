//! `bench record --out FILE.mcap --instance NAME`

use crate::failure::{Failure, Kind};
use crate::interrupt;
use crate::progress::Progress;
use crate::recorder::{Ending, Listener, OnFull, OnGap, Plan, RecordedRun, RecorderError, record};
use recordings::{CampaignError, Plane, Protocol, Role, RunMetadata};
use std::path::{Path, PathBuf};
use std::sync::atomic::Ordering;

/// Gaps that are listed one by one.
const GAPS_LISTED: usize = 100;

/// Record the runs of another process: a lossless logger of its own
///
/// Waits for a run of the instance, or joins the one under way, and writes one recording a run. Exit code 0 where every sample of
/// every run was recorded, 6 with the gaps where not.
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Recording of the first run, .mcap; further runs are called FILE-2.mcap and so on
    #[arg(long)]
    out: PathBuf,
    /// Instance to listen to
    #[arg(long, default_value = super::run::INSTANCE, value_parser = super::instance)]
    instance: String,
    /// End after so many runs; 0: on Ctrl-C only
    #[arg(long, default_value_t = 1)]
    runs: u32,
    /// When the disk runs full: the run goes on unrecorded, or its service is asked to stop
    #[arg(long, value_enum, default_value_t)]
    on_full: OnFull,
    /// When samples are lost: certify the gap, or ask the service to stop, too
    #[arg(long, value_enum, default_value_t)]
    on_gap: OnGap,
    #[command(flatten)]
    said: Said,
}

/// What is said of runs whose service does not tell what it runs.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Said {
    /// Protocol of the run, where its service does not tell it
    #[arg(long, default_value_t = Protocol::RandomSteps)]
    protocol: Protocol,
    /// What the run is for, where its service does not tell it
    #[arg(long, default_value_t = Role::Validate)]
    role: Role,
    /// Plane in which the lever moves, where its service does not tell it
    #[arg(long, default_value_t = Plane::Horizontal)]
    plane: Plane,
}

impl Said {
    /// As metadata of a run of this name.
    pub(super) fn metadata(self, name: &str) -> RunMetadata {
        let Said { protocol, role, plane } = self;
        RunMetadata::new(name, protocol, role, plane)
    }
}

pub(super) fn run(args: &Args, progress: &Progress) -> Result<(), Failure> {
    check_name(&args.out)?;
    let (switches, _driving) = interrupt::driving()?;
    let plan = Plan {
        instance: args.instance.clone(),
        out: args.out.clone(),
        runs: (args.runs > 0).then_some(args.runs),
        on_full: args.on_full,
        on_gap: args.on_gap,
        metadata: args.said.metadata(""),
    };
    let mut log = Log { progress, lossy: Vec::new(), closed: 0, cut_by_interrupt: false };
    let outcome = record(&plan, &switches.stop, &mut log);
    // What was lost is said after what ended the command: the runs before it may be whole.
    let interrupted = switches.stop.load(Ordering::Relaxed);
    match outcome {
        Err(error) => Err(failure_of(&error)),
        Ok(()) if log.cut_by_interrupt || (interrupted && plan.runs.is_some_and(|runs| log.closed < runs)) => {
            let message = format!(
                "interrupted after {} recorded runs; what was open is closed, and its certificate says what is missing",
                log.closed
            );
            Err(Failure::new(Kind::Interrupted, message))
        }
        Ok(()) if log.lossy.is_empty() => Ok(()),
        Ok(()) => Err(Failure::new(Kind::Loss, log.lossy.join("\n"))),
    }
}

/// Says what happens, and remembers what was lost.
struct Log<'a> {
    progress: &'a Progress,
    lossy: Vec<String>,
    closed: u32,
    cut_by_interrupt: bool,
}

impl Listener for Log<'_> {
    fn say(&mut self, text: &str) {
        self.progress.say(text);
    }

    fn closed(&mut self, run: &RecordedRun) {
        let RecordedRun { certificate, ending, trouble, .. } = run;
        let file = run.file.display();
        self.closed += 1;
        self.progress.result(&format!("run {}: {certificate}", run.run));
        self.progress.result(&format!("recording: {file}"));
        let why = match ending {
            Ending::Last => None,
            Ending::NextRun => Some("another run began before this one's last sample arrived"),
            Ending::ServiceGone => Some("the service is gone; it did not end the run"),
            Ending::Interrupted => Some("the recording was ended before the run"),
        };
        self.cut_by_interrupt |= *ending == Ending::Interrupted;
        let reasons: Vec<&str> = why.into_iter().chain(trouble.as_deref()).collect();
        if certificate.is_lossless() && reasons.is_empty() {
            return;
        }
        let mut text = format!("{file}: {certificate}");
        for reason in reasons {
            text.push_str("; ");
            text.push_str(reason);
        }
        for (first, last) in certificate.gaps.iter().take(GAPS_LISTED) {
            text.push_str(&format!("\n  missing: samples {first} to {last} ({})", last - first + 1));
        }
        if let Some(more) = certificate.gaps.len().checked_sub(GAPS_LISTED).filter(|more| *more > 0) {
            text.push_str(&format!("\n  and {more} gaps more, in the recording's certificate"));
        }
        self.lossy.push(text);
    }
}

/// What would be refused only when the run begins is refused before it does.
///
/// # Errors
/// A name that no recording can have, or one that is taken (2).
pub(super) fn check_name(out: &Path) -> Result<(), Failure> {
    let wrong = |what: &str| Err(Failure::new(Kind::Input, format!("--out {}: {what}", out.display())));
    let part = out.with_extension("mcap.part");
    let folder = out.parent().filter(|folder| !folder.as_os_str().is_empty()).unwrap_or(Path::new("."));
    if out.extension().is_none_or(|extension| extension != "mcap") {
        return wrong("expected a name that ends in .mcap; name it so");
    }
    if out.exists() {
        return wrong("a recording of this name exists, and a measurement is never overwritten; choose another name");
    }
    if part.exists() {
        return wrong(
            "an unfinished recording of this name exists (.part); `bench recover` reads it, or choose another name",
        );
    }
    if !folder.is_dir() {
        return wrong(&format!("{} is no folder; create it", folder.display()));
    }
    Ok(())
}

fn failure_of(error: &RecorderError) -> Failure {
    let kind = match error {
        RecorderError::Link(_) => Kind::Device,
        RecorderError::Recording(CampaignError::Content(_)) => Kind::Input,
        RecorderError::Recording(_) => Kind::Loss,
    };
    Failure::of(kind, error)
}
