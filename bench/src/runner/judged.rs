//! How a run ended, as an exit code and a word of what to do: what the system refused, how the loop ended, what the recording lacks.

use crate::failure::{Failure, Kind};
use crate::logger::LoggerError;
use crate::progress::Progress;
use recordings::CampaignError;
use rt_core::system::Report;
use rt_core::{Ended, LoopError, LossCertificate, RunReport};

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

/// N of N, or no success (6).
pub fn certify(name: &str, certificate: &LossCertificate) -> Result<(), Failure> {
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
