//! One run as the recorder writes it down: which samples belong to it, what is missing, how it ended.

use recordings::{CampaignError, CutShort, McapWriter, RunMetadata};
use rt_core::{LossCertificate, Sample};
use std::path::{Path, PathBuf};

/// How the recording of a run came to its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// The run's last sample arrived.
    Last,
    /// Another run began before this one's last sample arrived.
    NextRun,
    /// The service is gone.
    ServiceGone,
    /// The recorder was told to end.
    Interrupted,
}

/// A run that is no longer recorded.
#[derive(Debug)]
pub struct RecordedRun {
    /// Number of the run.
    pub run: u32,
    /// The file that holds what there is of it.
    pub file: PathBuf,
    /// How much that is.
    pub certificate: LossCertificate,
    /// How it ended.
    pub ending: Ending,
    /// What kept the recording from being whole, besides what the certificate says.
    pub trouble: Option<String>,
}

/// What one more sample meant.
#[derive(Debug, PartialEq)]
pub enum Taken {
    /// It is recorded.
    Recorded,
    /// It is recorded; samples before it, first and last, did not arrive.
    AfterGap(u64, u64),
    /// The system refused: nothing more is recorded of this run.
    Cut(CutShort),
    /// A sample that no recording can hold; why. It is missing from the file.
    Refused(String),
    /// The recording was cut short before.
    Passed,
}

/// The recording of a run under way.
pub struct RunFile {
    /// `None`: cut short.
    writer: Option<McapWriter>,
    cut: Option<CutShort>,
    path: PathBuf,
    missed_before: u64,
    newest: Sample,
    /// The number that comes next where nothing is lost.
    next: u64,
    refused: u64,
}

impl RunFile {
    /// Begins with the first sample that arrived of a run, without recording it yet.
    ///
    /// # Errors
    /// As [`McapWriter::create`].
    pub fn create(path: &Path, metadata: &RunMetadata, first: &Sample) -> Result<Self, CampaignError> {
        let writer = McapWriter::create(path, metadata)?;
        let path = path.to_owned();
        let next = first.sequence();
        Ok(RunFile { writer: Some(writer), cut: None, path, missed_before: next, newest: *first, next, refused: 0 })
    }

    /// Whether a sample belongs to the run, after the first. A service that was started again numbers its runs anew.
    pub fn continues(&self, sample: &Sample) -> bool {
        sample.run == self.newest.run
            && sample.sequence() >= self.next
            && sample.tick > self.newest.tick
            && origin_ns(sample) == origin_ns(&self.newest)
    }

    /// Records a sample that belongs to the run.
    pub fn take(&mut self, sample: &Sample) -> Taken {
        let expected = std::mem::replace(&mut self.next, sample.sequence() + 1);
        self.newest = *sample;
        let Some(writer) = &mut self.writer else { return Taken::Passed };
        match writer.write(sample) {
            Ok(()) if sample.sequence() > expected => Taken::AfterGap(expected, sample.sequence() - 1),
            Ok(()) => Taken::Recorded,
            Err(CampaignError::CutShort(cut)) => {
                self.writer = None;
                self.cut = Some(cut.clone());
                Taken::Cut(cut)
            }
            Err(error) => {
                self.refused += 1;
                Taken::Refused(error.to_string())
            }
        }
    }

    /// Samples of the run before the first one that arrived.
    pub fn missed_before(&self) -> u64 {
        self.missed_before
    }

    /// Closes the recording with what can be certified.
    pub fn close(self, ending: Ending) -> RecordedRun {
        let expected = self.next;
        let (run, end_seen) = (self.newest.run, ending == Ending::Last);
        let refused = (self.refused > 0).then(|| format!("{} samples could not be recorded", self.refused));
        let of_cut = |cut: CutShort| RecordedRun {
            run,
            certificate: LossCertificate { run, end_seen, ..cut.of_run(expected) },
            ending,
            trouble: Some(cut.to_string()),
            file: cut.file,
        };
        let writer = match (self.writer, self.cut) {
            (Some(writer), _) => writer,
            (None, Some(cut)) => return of_cut(cut),
            (None, None) => unreachable!("only what cuts a recording short takes its writer away"),
        };
        let certificate = LossCertificate { run, end_seen, ..writer.certificate(expected) };
        match writer.finish(&certificate) {
            Ok(file) => RecordedRun { run, file, certificate, ending, trouble: refused },
            Err(CampaignError::CutShort(cut)) => of_cut(cut),
            Err(error) => {
                let mut part = self.path.into_os_string();
                part.push(".part");
                let trouble = Some(format!("{error}; `bench recover` reads what is there"));
                RecordedRun { run, file: part.into(), certificate, ending, trouble }
            }
        }
    }
}

/// When the run began, `CLOCK_MONOTONIC`; the same in all samples of a run in real time. `None` in virtual time.
fn origin_ns(sample: &Sample) -> Option<u64> {
    let due_ns = sample.woken_ns.checked_sub(sample.lateness_ns).filter(|_| sample.woken_ns > 0)?;
    Some(due_ns.wrapping_sub(sample.scheduled_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::PERIOD_NS;

    fn sample(tick: u64, origin_ns: u64) -> Sample {
        let lateness_ns = 40_000 + tick;
        let scheduled_ns = tick * PERIOD_NS;
        Sample { tick, scheduled_ns, woken_ns: origin_ns + scheduled_ns + lateness_ns, lateness_ns, ..Sample::BLANK }
    }

    fn begun(dir: &Path, first: &Sample) -> RunFile {
        let metadata = RunMetadata::new(
            "run",
            recordings::Protocol::RandomSteps,
            recordings::Role::Validate,
            recordings::Plane::Horizontal,
        );
        let mut file = RunFile::create(&dir.join("a.mcap"), &metadata, first).expect("a new file");
        assert_eq!(file.take(first), Taken::Recorded);
        file
    }

    #[test]
    fn a_service_that_was_started_again_is_another_run_by_its_origin_alone() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let mut file = begun(dir.path(), &sample(0, 7_000));
        assert_eq!(file.take(&sample(1, 7_000)), Taken::Recorded);
        assert!(file.continues(&sample(2, 7_000)) && file.continues(&sample(90, 7_000)));
        assert!(
            !file.continues(&sample(2, 8_000)),
            "the same run number and a fitting tick, but it began at another time"
        );
        assert!(!file.continues(&sample(0, 7_000)) && !file.continues(&Sample { run: 1, ..sample(2, 7_000) }));
    }

    #[test]
    fn a_run_that_was_joined_late_and_lost_some_later_is_certified_so() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let mut file = begun(dir.path(), &sample(5, 1));
        assert_eq!(file.missed_before(), 5);
        assert_eq!(file.take(&sample(9, 1)), Taken::AfterGap(6, 8));
        let bad = Sample { voltage_v: f64::NAN, ..sample(10, 1) };
        assert!(matches!(file.take(&bad), Taken::Refused(why) if why.contains("voltage_v")));
        assert_eq!(file.take(&sample(11, 1)), Taken::Recorded, "what the file lacks was not lost on the way");
        let closed = file.close(Ending::Last);
        assert_eq!(closed.certificate.gaps, [(0, 4), (6, 8), (10, 10)]);
        assert_eq!((closed.certificate.received, closed.certificate.expected), (3, 12));
        assert_eq!(closed.trouble.as_deref(), Some("1 samples could not be recorded"));
        assert_eq!(closed.file, dir.path().join("a.mcap"));
    }

    #[test]
    fn a_run_without_its_last_sample_is_closed_without_end() {
        let dir = tempfile::tempdir().expect("a temporary folder");
        let file = begun(dir.path(), &sample(0, 1));
        let closed = file.close(Ending::ServiceGone);
        assert_eq!(closed.certificate.to_string(), "1 of at least 1 samples; the end of the run did not arrive");
    }
}
