//! Whether a run of a plan is there: closed, without loss, ended as its script wanted.

use super::plan::PlannedRun;
use crate::failure::{Failure, Kind};
use recordings::{Item, McapReader};
use rt_core::{LossCertificate, OverrunPolicy, Sample, flags};
use std::path::Path;

/// How far a run is.
#[derive(Clone, Debug, PartialEq)]
pub enum Standing {
    /// Nothing is there.
    Missing,
    /// Recorded as its script wanted.
    Complete(LossCertificate),
    /// Something is there that can't be used; why.
    Unusable(String),
}

/// The standing of a run in a campaign's folder. The whole recording is read, so that one which was damaged since is recorded
/// again. `overrun` is its script's policy.
///
/// # Errors
/// A recording under this name that was made with another profile (2): it is not this campaign's, and stays where it is.
pub fn standing(dir: &Path, run: &PlannedRun, overrun: OverrunPolicy) -> Result<Standing, Failure> {
    let path = dir.join(&run.file);
    if dir.join(format!("{}.part", run.file)).exists() {
        return Ok(Standing::Unusable("its recording was never closed".to_owned()));
    }
    if !path.exists() {
        return Ok(Standing::Missing);
    }
    let mut reader = match McapReader::open(&path) {
        Ok(reader) => reader,
        Err(error) => return Ok(Standing::Unusable(error.to_string())),
    };
    if reader.run().profile != run.profile {
        let message = format!(
            "{}: expected the recording of profile {} as the plan has it, got one of another text; move it away, or record into \
             another folder",
            path.display(),
            run.name
        );
        return Err(Failure::new(Kind::Input, message));
    }
    let mut last = None;
    for item in &mut reader {
        match item {
            Ok(Item::Sample(sample)) => last = Some(sample),
            Ok(_) => {}
            Err(error) => return Ok(Standing::Unusable(error.to_string())),
        }
    }
    Ok(match (reader.certificate(), last) {
        (Some(certificate), Some(last)) => match fault(certificate, &last, overrun) {
            None => Standing::Complete(certificate.clone()),
            Some(why) => Standing::Unusable(why),
        },
        _ => Standing::Unusable("its recording holds no sample".to_owned()),
    })
}

/// Why a run that ended with this sample is not what its script wanted.
fn fault(certificate: &LossCertificate, last: &Sample, overrun: OverrunPolicy) -> Option<String> {
    if !certificate.is_lossless() {
        return Some(certificate.to_string());
    }
    let tick = last.tick;
    let why = if last.fault() {
        "the device failed"
    } else if last.tripped() {
        "the supervisor had tripped"
    } else if last.flags & flags::STOPPED != 0 {
        "it was stopped"
    } else if last.overrun() && overrun == OverrunPolicy::Abort {
        "a missed deadline ended it"
    } else if !last.last() {
        "its last sample is missing"
    } else {
        return None;
    };
    Some(format!("{why}, its last tick is {tick}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_run_that_its_script_ended_is_complete() {
        let whole = LossCertificate { run: 0, expected: 10, received: 10, gaps: vec![], end_seen: true };
        let ended = |flags| Sample { tick: 9, flags, ..Sample::BLANK };
        let judged = |flags| fault(&whole, &ended(flags), OverrunPolicy::Skip);
        assert_eq!(judged(flags::LAST), None);
        assert_eq!(judged(flags::LAST | flags::BRAKE_OPEN | flags::SLEW_LIMITED), None);
        assert_eq!(judged(flags::LAST | flags::OVERRUN), None, "a late tick, and the script went on");
        assert!(fault(&whole, &ended(flags::LAST | flags::OVERRUN), OverrunPolicy::Abort).is_some());
        for flag in [flags::TRIPPED, flags::FAULT, flags::STOPPED] {
            assert!(judged(flags::LAST | flag).is_some_and(|why| why.ends_with("its last tick is 9")));
        }
        assert!(judged(0).is_some());
        let lossy = LossCertificate { received: 9, gaps: vec![(3, 3)], ..whole.clone() };
        assert!(fault(&lossy, &ended(flags::LAST), OverrunPolicy::Skip).is_some());
    }
}
