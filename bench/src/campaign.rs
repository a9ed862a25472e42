//! Runs scripts on a rig and leaves a campaign folder: the loop in lockstep, its samples over shared memory, the logger's
//! recordings, `campaign.toml`.

use crate::failure::{Failure, Kind};
use crate::logger::{Logger, LoggerError};
use crate::progress::Progress;
use profiles::Script;
use recordings::{
    CAMPAIGN_FILE, Campaign, CampaignError, Event, RigFacts, RunEntry, RunMetadata, Severity, UnknownWord,
};
use rt_core::{
    Controller, Device, Ended, FlightLog, FlightRecorder, Limits, Lockstep, LoopError, LossCertificate, OverrunPolicy,
    PERIOD_NS, Pace, Publication, Run, RunReport, Stages, Supervisor, Switches,
};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::time::Duration;

/// Longest wait for the logger to appear, and for the samples of a run to reach it after its end.
const PATIENCE: Duration = Duration::from_secs(30);

/// What a session is about.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder of the campaign; is created. It must not hold a campaign yet: a measurement is never overwritten.
    pub dir: PathBuf,
    /// Free text for `campaign.toml`.
    pub name: String,
    /// What is known of the rig.
    pub rig: RigFacts,
    /// What the supervisor enforces.
    pub limits: Limits,
    /// Seed of the scripts' random steps.
    pub seed: u64,
    /// Noted in every recording.
    pub notes: BTreeMap<String, String>,
}

/// A run that was recorded without loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Recorded {
    /// Its entry in the campaign.
    pub entry: RunEntry,
    /// N of N.
    pub certificate: LossCertificate,
}

/// A campaign under way.
pub struct Session {
    campaign: Campaign,
    seed: u64,
    notes: BTreeMap<String, String>,
    supervisor: Supervisor,
    // Before the publication: a logger that leaves first is not waited for.
    logger: Logger,
    publication: Publication,
    next_run: u32,
    flight: FlightRecorder,
    _incidents: FlightLog,
}

impl Session {
    /// Makes the folder, begins to publish on an instance of this process, and starts the logger.
    pub fn create(settings: Settings) -> Result<Self, Failure> {
        let Settings { dir, name, rig, limits, seed, notes } = settings;
        make_folder(&dir)?;
        let supervisor = Supervisor::new(limits).map_err(|e| Failure::of(Kind::Input, &e))?;
        // Two campaigns on one machine must not hear each other.
        let instance = format!("campaign-{}", std::process::id());
        let link = |e| Failure::of(Kind::Device, &e);
        let publication = Publication::start(&instance, Pace::LOCKSTEP).map_err(link)?;
        let logger = Logger::start(&instance).map_err(|e| failure_of(&e))?;
        publication.wait_for_loggers(1, PATIENCE).map_err(link)?;
        let campaign = Campaign { dir, name, rig, runs: Vec::new() };
        let (flight, _incidents) = rt_core::flight::recorder();
        Ok(Session { campaign, seed, notes, supervisor, logger, publication, next_run: 0, flight, _incidents })
    }

    /// Runs one script to its end and adds its recording to the campaign. `text` is the script's own text, kept in the
    /// recording. Prints `NAME: N of N samples`.
    ///
    /// # Errors
    /// The script does not fit the rig (2), the device failed (4), the supervisor tripped (5), samples were lost or could
    /// not be written (6), a stop was asked for (130). Whatever was recorded stays in the folder.
    pub fn run(
        &mut self,
        script: &Script,
        text: &str,
        device: &mut dyn Device,
        controller: &mut dyn Controller,
        mut switches: &Switches,
        progress: &Progress,
    ) -> Result<Recorded, Failure> {
        let context = profiles::Context { u_max_v: self.campaign.rig.u_max_v, seed: self.seed };
        let mut playback = script.compile(&context).map_err(|e| Failure::of(Kind::Input, &e))?;
        let entry = entry(script).map_err(|e| Failure::of(Kind::Internal, &e))?;
        let run = self.next_run;
        self.next_run += 1;

        let step = progress.step(script.name.as_str(), playback.ticks_bound());
        let path = self.campaign.dir.join(&entry.file);
        self.logger
            .begin(run, path, metadata(script, &entry, text, &self.notes), step.counter())
            .map_err(|e| failure_of(&e))?;
        let stages = Stages {
            clock: &mut Lockstep::default(),
            device,
            operator: &mut switches,
            supervisor: &mut self.supervisor,
            reference: &mut playback,
            controller,
            publish: &mut self.publication,
            flight: &mut self.flight,
        };
        let outcome = rt_core::run(stages, Run { number: run, overrun: OverrunPolicy::Skip });
        let settled = self.publication.settle(PATIENCE);
        let (ticks, events) = aftermath(&outcome);
        let recorded = self.logger.end(run, ticks, events).map_err(|e| failure_of(&e))?;
        step.finish();
        progress.result(&format!("{}: {}", script.name, recorded.certificate));

        // First what happened to the rig, then what happened to the data.
        let report = outcome.map_err(|e| Failure::of(Kind::Device, &e))?;
        self.campaign.runs.push(entry.clone());
        self.campaign.write_toml().map_err(|e| Failure::of(Kind::Input, &e))?;
        judge(&script.name, &report)?;
        settled.map_err(|e| Failure::of(Kind::Loss, &e))?;
        certify(&script.name, &recorded.certificate)?;
        Ok(Recorded { entry, certificate: recorded.certificate })
    }

    /// The campaign as it is recorded so far; its folder can be read.
    pub fn campaign(&self) -> &Campaign {
        &self.campaign
    }

    /// Ends publication and logger.
    pub fn finish(self) -> Result<Campaign, Failure> {
        drop(self.logger);
        self.publication.stop().map_err(|e| Failure::of(Kind::Device, &e))?;
        Ok(self.campaign)
    }
}

/// Makes the folder of a new campaign.
///
/// # Errors
/// It holds a campaign already, which is never overwritten, or the system refuses (2).
pub fn make_folder(dir: &Path) -> Result<(), Failure> {
    if dir.join(CAMPAIGN_FILE).exists() {
        let message = format!(
            "{}: expected a folder without a campaign, got one with {CAMPAIGN_FILE}; a measurement is never overwritten, \
             choose another folder or remove this one",
            dir.display()
        );
        return Err(Failure::new(Kind::Input, message));
    }
    std::fs::create_dir_all(dir).map_err(|error| {
        let message = format!("{}: expected to create this folder, got \"{error}\"; choose another one", dir.display());
        Failure::new(Kind::Input, message)
    })
}

fn entry(script: &Script) -> Result<RunEntry, UnknownWord> {
    Ok(RunEntry {
        file: format!("{}.mcap", script.name),
        protocol: FromStr::from_str(script.protocol.as_str())?,
        role: FromStr::from_str(script.role.as_str())?,
        plane: FromStr::from_str(script.plane.as_str())?,
    })
}

fn metadata(script: &Script, entry: &RunEntry, text: &str, notes: &BTreeMap<String, String>) -> RunMetadata {
    RunMetadata {
        name: script.name.clone(),
        protocol: entry.protocol,
        role: entry.role,
        plane: entry.plane,
        profile: text.to_owned(),
        notes: notes.clone(),
    }
}

/// What the logger has to know of the run's end: its length, and what a reader of the recording should see.
fn aftermath(outcome: &Result<RunReport, LoopError>) -> (Option<u64>, Vec<Event>) {
    let event = |tick: u64, severity, text: String| Event {
        tick,
        scheduled_ns: tick * PERIOD_NS,
        severity,
        source: "loop".to_owned(),
        text,
    };
    match outcome {
        Ok(report) => {
            let ticks = report.statistics.ticks;
            let last = ticks.saturating_sub(1);
            let events = match report.ended {
                Ended::Completed => vec![],
                Ended::Tripped | Ended::Aborted => vec![event(last, Severity::Error, report.to_string())],
                Ended::Stopped => vec![event(last, Severity::Warning, report.to_string())],
            };
            (Some(ticks), events)
        }
        Err(LoopError::Device { source, .. }) => (None, vec![event(source.tick, Severity::Error, source.to_string())]),
        Err(error) => (Some(0), vec![event(0, Severity::Error, error.to_string())]),
    }
}

fn judge(name: &str, report: &RunReport) -> Result<(), Failure> {
    match report.ended {
        Ended::Completed => Ok(()),
        Ended::Tripped => Err(Failure::new(Kind::Safety, format!("{name}: {report}"))),
        Ended::Aborted => Err(Failure::new(Kind::Loss, format!("{name}: {report}"))),
        Ended::Stopped => Err(Failure::new(Kind::Interrupted, format!("{name}: interrupted; the outputs are zeroed"))),
    }
}

/// N of N, or no success.
fn certify(name: &str, certificate: &LossCertificate) -> Result<(), Failure> {
    if certificate.is_lossless() {
        return Ok(());
    }
    Err(Failure::new(Kind::Loss, format!("{name}: {certificate}; the recording can't be used, run the campaign again")))
}

fn failure_of(error: &LoggerError) -> Failure {
    let kind = match error {
        LoggerError::Link(_) => Kind::Device,
        LoggerError::Recording(CampaignError::Content(_)) => Kind::Input,
        LoggerError::Recording(_) => Kind::Loss,
        LoggerError::OtherRun { .. } | LoggerError::Thread(_) => Kind::Loss,
    };
    Failure::of(kind, error)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_samples_are_exit_code_6() {
        let whole = LossCertificate { run: 0, expected: 10, received: 10, gaps: vec![], end_seen: true };
        assert_eq!(certify("a", &whole), Ok(()));
        let lossy = LossCertificate { received: 9, gaps: vec![(4, 4)], ..whole.clone() };
        let failure = certify("a", &lossy).expect_err("one is missing");
        assert_eq!(failure.exit_code(), 6);
        assert!(failure.message.contains("9 of 10 samples"), "{failure}");
        assert!(certify("a", &LossCertificate { end_seen: false, ..whole }).is_err(), "an unknown length is no proof");
    }
}
