//! How a run ended, as an exit code and a word of what to do: what the system refused, how the loop ended, what the recording lacks.

use crate::failure::{Failure, Kind};
use crate::logger::LoggerError;
use crate::progress::Progress;
use recordings::{CampaignError, CutShort};
use rt_core::system::Report;
use rt_core::{Ended, LinkError, LoopError, LossCertificate, RunReport};
use std::io::ErrorKind;
use std::path::PathBuf;

/// What the system refuses is said once with the remedy, or ends the command.
pub(super) fn say_refusals(report: &Report, required: bool, say: bool, progress: &Progress) -> Result<(), Failure> {
    let refused = report.refused();
    if refused.is_empty() {
        return Ok(());
    }
    let lines: Vec<String> = refused.iter().map(ToString::to_string).collect();
    if required {
        return Err(Failure::new(
            Kind::Input,
            format!(
                "expected all that real time needs, as --require-rt says, and the system refuses: {}; `bench doctor` says what to change",
                lines.join("; ")
            ),
        ));
    }
    if say {
        lines.iter().for_each(|line| progress.say(&format!("real time: {line}")));
    }
    Ok(())
}

/// Whether the run was driven to the end that its script wanted.
///
/// # Errors
/// A trip (5), a missed deadline with the policy to abort (6), a stop (130).
pub fn judge(name: &str, report: &RunReport) -> Result<(), Failure> {
    match report.ended {
        Ended::Completed => Ok(()),
        Ended::Tripped => {
            let remedy = "the rig is in its safe state; remove the cause before the next run";
            Err(Failure::new(Kind::Safety, format!("{name}: {report}; {remedy}")))
        }
        Ended::Aborted => {
            let remedy = "`bench doctor` says what delays this machine, and `overrun = \"skip\"` in the profile lets a run go on";
            Err(Failure::new(Kind::Loss, format!("{name}: {report}; {remedy}")))
        }
        Ended::Stopped => Err(Failure::new(Kind::Interrupted, format!("{name}: stopped; the outputs are zeroed"))),
    }
}

/// A run that came to its end, whatever that was.
#[derive(Clone, Debug, PartialEq)]
pub struct Finished {
    /// What the loop says.
    pub report: RunReport,
    /// What the recording holds of it.
    pub certificate: LossCertificate,
    /// What the flight recorder left.
    pub incidents: Vec<PathBuf>,
    /// It was stopped because its recording could not be written on; nobody else wanted that.
    pub stopped_for: Option<CutShort>,
}

impl Finished {
    /// Whether the run was driven to the end that its script wanted, and its recording holds all of it.
    ///
    /// # Errors
    /// As [`judge`]; lost samples (6), also where the run was stopped for them: nobody wanted that.
    pub fn judge(&self, name: &str) -> Result<(), Failure> {
        match &self.stopped_for {
            Some(cut) if self.report.ended == Ended::Stopped => {
                let follows = "the run was stopped for it, and the outputs are zeroed";
                Err(Failure::new(Kind::Loss, format!("{name}: {cut}; {follows}")))
            }
            _ => judge(name, &self.report).and_then(|()| certify(name, &self.certificate)),
        }
    }
}

/// N of N, or no success (6).
fn certify(name: &str, certificate: &LossCertificate) -> Result<(), Failure> {
    if certificate.is_lossless() {
        return Ok(());
    }
    Err(Failure::new(Kind::Loss, format!("{name}: {certificate}; the recording can't be used, run it again")))
}

/// The failure of a run whose data are `lost` besides: what happened to the rig decides its kind and comes first in its words.
pub(super) fn rig_first(name: &str, outcome: &Result<RunReport, LoopError>, lost: Failure) -> Failure {
    let rig = match outcome {
        Ok(report) => judge(name, report).err(),
        Err(error) => Some(Failure::of(Kind::Device, error)),
    };
    match rig {
        Some(rig) => Failure::new(rig.kind, format!("{rig}; its recording failed, too: {lost}")),
        None => lost,
    }
}

/// What kind of failure it is that the transport can't be had: a name that is none has to be changed (2), anything else may do the next time (4).
pub(super) fn of_link(error: &LinkError) -> Failure {
    let kind = if matches!(error, LinkError::InstanceName(_)) { Kind::Input } else { Kind::Device };
    Failure::of(kind, error)
}

/// What kind of failure a logger that can't go on is.
pub(super) fn failure_of(error: &LoggerError) -> Failure {
    let kind = match error {
        LoggerError::Link(_) => Kind::Device,
        LoggerError::Recording(CampaignError::Content(_)) => Kind::Input,
        LoggerError::Recording(_) => Kind::Loss,
        LoggerError::OtherRun { .. } | LoggerError::Thread(_) => Kind::Loss,
    };
    Failure::of(kind, error)
}

/// What the system says where a file of this name can't be.
const NAMES_FAULT: [ErrorKind; 7] = [
    ErrorKind::AlreadyExists,
    ErrorKind::InvalidFilename,
    ErrorKind::IsADirectory,
    ErrorKind::NotADirectory,
    ErrorKind::NotFound,
    ErrorKind::PermissionDenied,
    ErrorKind::ReadOnlyFilesystem,
];

/// The same of a recording that could not be begun: where the name or its folder is to blame, that is what was asked for.
pub(super) fn not_begun(error: &LoggerError) -> Failure {
    match error {
        LoggerError::Recording(CampaignError::Write { source, .. }) if NAMES_FAULT.contains(&source.kind()) => {
            Failure::of(Kind::Input, error)
        }
        _ => failure_of(error),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{Breach, Channel, DeviceError, Statistics, Trip};

    #[test]
    fn a_lost_recording_hides_nothing_of_what_happened_to_the_rig() {
        let lost = || failure_of(&LoggerError::Thread("gave no answer".to_owned()));
        let report = |ended, trip| RunReport { run: 0, ended, trip, statistics: Statistics::default() };
        let completed = Ok(report(Ended::Completed, None));
        assert_eq!(rig_first("a", &completed, lost()), lost(), "nothing happened to the rig");

        let trip = Trip { tick: 7, channel: Channel::Pressure1, value: 9.0, breach: Breach::Above(6.0) };
        let tripped = rig_first("a", &Ok(report(Ended::Tripped, Some(trip))), lost());
        assert_eq!(tripped.kind, Kind::Safety);
        assert!(tripped.message.ends_with(&lost().message), "{tripped}");

        let failed = |what: &str| DeviceError { device: "bus", tick: 7, what: what.to_owned() };
        let broken = LoopError::Device {
            run: 0,
            source: failed("silent"),
            safe_state: Err(failed("gone")),
            statistics: Box::default(),
        };
        let broken = rig_first("a", &Err(broken), lost());
        assert_eq!(broken.kind, Kind::Device);
        for part in ["silent", "safe state: NOT written", &lost().message] {
            assert!(broken.message.contains(part), "{part:?} is not in: {broken}");
        }
    }

    #[test]
    fn a_recording_that_can_not_be_begun_for_its_name_is_bad_input_and_for_want_of_room_a_loss() {
        let refused = |kind: ErrorKind| {
            let error = CampaignError::Write { file: "a.mcap.part".into(), source: kind.into() };
            not_begun(&LoggerError::Recording(error)).exit_code()
        };
        assert_eq!([ErrorKind::AlreadyExists, ErrorKind::PermissionDenied, ErrorKind::NotFound].map(refused), [2; 3]);
        assert_eq!(refused(ErrorKind::StorageFull), 6);
    }

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

    #[test]
    fn a_run_that_its_full_disk_ended_is_lost_and_one_that_somebody_ended_is_interrupted() {
        let certificate = LossCertificate { run: 0, expected: 10, received: 9, gaps: vec![(9, 9)], end_seen: true };
        let cut = CutShort {
            file: "/data/a.mcap".into(),
            system: "No space left on device".to_owned(),
            certificate: certificate.clone(),
            end_s: 0.009,
            closed: true,
        };
        let judged = |ended, stopped_for| {
            let report = RunReport { run: 0, ended, trip: None, statistics: Statistics::default() };
            let finished = Finished { report, certificate: certificate.clone(), incidents: vec![], stopped_for };
            finished.judge("a").expect_err("samples are missing")
        };
        assert_eq!(judged(Ended::Stopped, None).kind, Kind::Interrupted);
        let full = judged(Ended::Stopped, Some(cut.clone()));
        assert_eq!(full.kind, Kind::Loss);
        for word in ["/data/a.mcap", "No space left", "make room on that disk", "was stopped for it"] {
            assert!(full.message.contains(word), "{word:?} is not in: {full}");
        }
        // It came to its end before it heard of the stop, or tripped meanwhile.
        assert_eq!(judged(Ended::Completed, Some(cut.clone())).kind, Kind::Loss);
        assert_eq!(judged(Ended::Tripped, Some(cut)).kind, Kind::Safety);
    }

    #[test]
    fn an_instance_s_name_that_is_none_has_to_be_changed() {
        assert_eq!(of_link(&LinkError::InstanceName("a/b".to_owned())).kind, Kind::Input);
        assert_eq!(of_link(&LinkError::Ended).kind, Kind::Device);
    }
}
