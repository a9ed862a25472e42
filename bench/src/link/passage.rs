//! What has crossed of each run: samples in order, each once, and the gaps between them.

use rt_core::{LossCertificate, LossTracker, Sample};

/// What a sample that has crossed is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Crossed {
    /// The first one of a run.
    Begins,
    /// The next one, or one after a gap of so many samples.
    Follows(u64),
    /// One that was there already, or that newer ones overtook; or the last one of a run of which nothing else crossed: it is told again and again,
    /// and is nothing that anybody could watch.
    Late,
}

/// See the module.
#[derive(Debug, Default)]
pub struct Passage {
    open: Option<Run>,
    tracker: LossTracker,
    /// Counts the runs: a rig that was started again numbers its runs anew.
    origin: u128,
}

#[derive(Clone, Copy, Debug)]
struct Run {
    run: u32,
    began_ns: Option<u64>,
    next_sequence: u64,
}

impl Passage {
    /// Takes a sample.
    pub fn take(&mut self, sample: &Sample) -> Crossed {
        let sequence = sample.sequence();
        let began_ns = began_ns(sample);
        let crossed = match &mut self.open {
            Some(open) if open.run == sample.run && open.began_ns == began_ns => {
                if sequence < open.next_sequence {
                    return Crossed::Late;
                }
                let gap = sequence - open.next_sequence;
                open.next_sequence = sequence + 1;
                Crossed::Follows(gap)
            }
            _ if sample.last() && sequence > 0 => return Crossed::Late,
            _ => {
                self.open = Some(Run { run: sample.run, began_ns, next_sequence: sequence + 1 });
                self.origin += 1;
                Crossed::Begins
            }
        };
        // Within an origin the order is the one that was seen to above.
        if let Err(error) = self.tracker.received(self.origin, sample) {
            tracing::error!(%error, "samples out of order");
        }
        crossed
    }

    /// The certificate of the oldest run that has ended and was not asked for yet.
    pub fn certificate(&mut self) -> Option<LossCertificate> {
        self.tracker.take()
    }

    /// The link is gone: what it carried ends here.
    pub fn cut(&mut self) {
        self.tracker.abandon();
        self.open = None;
    }
}

/// When the run began, on the rig's clock; the same in all its samples in real time.
fn began_ns(sample: &Sample) -> Option<u64> {
    let due_ns = sample.woken_ns.checked_sub(sample.lateness_ns).filter(|_| sample.woken_ns > 0)?;
    Some(due_ns.wrapping_sub(sample.scheduled_ns))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::{PERIOD_NS, flags};

    fn sample(run: u32, tick: u64, began_ns: u64) -> Sample {
        let scheduled_ns = tick * PERIOD_NS;
        Sample { run, tick, scheduled_ns, woken_ns: began_ns + scheduled_ns + 9, lateness_ns: 9, ..Sample::BLANK }
    }

    #[test]
    fn gaps_are_counted_and_doubles_are_left_out() {
        let mut passage = Passage::default();
        assert_eq!(passage.take(&sample(0, 4, 1)), Crossed::Begins);
        assert_eq!(passage.take(&sample(0, 5, 1)), Crossed::Follows(0));
        assert_eq!(passage.take(&sample(0, 9, 1)), Crossed::Follows(3));
        assert_eq!(passage.take(&sample(0, 8, 1)), Crossed::Late);
        assert_eq!(passage.take(&sample(0, 9, 1)), Crossed::Late);
        let last = Sample { flags: flags::LAST, ..sample(0, 10, 1) };
        assert_eq!(passage.take(&last), Crossed::Follows(0));
        let certificate = passage.certificate().expect("the run has ended");
        assert_eq!(certificate.gaps, [(0, 3), (6, 8)]);
        assert_eq!((certificate.received, certificate.expected), (4, 11));
    }

    #[test]
    fn an_end_that_is_told_again_ends_what_is_open_and_nothing_else() {
        let mut passage = Passage::default();
        let last = Sample { flags: flags::LAST, ..sample(0, 10, 1) };
        assert_eq!(passage.take(&last), Crossed::Late, "who comes after the run sees none");
        passage.take(&sample(0, 4, 1));
        assert_eq!(passage.take(&last), Crossed::Follows(5));
        assert_eq!(passage.take(&last), Crossed::Late);
        assert!(passage.certificate().expect("it has ended").end_seen);
        passage.cut();
        assert_eq!(passage.take(&last), Crossed::Late);
        assert!(passage.certificate().is_none());
        let whole = Sample { flags: flags::LAST, ..sample(1, 0, 1) };
        assert_eq!(passage.take(&whole), Crossed::Begins, "a run of one sample");
    }

    #[test]
    fn a_service_that_was_started_again_begins_another_run_of_the_same_number() {
        let mut passage = Passage::default();
        passage.take(&sample(0, 7, 1));
        assert_eq!(passage.take(&sample(0, 0, 2)), Crossed::Begins);
        assert_eq!(passage.take(&sample(1, 0, 2)), Crossed::Begins);
        passage.cut();
        assert_eq!(passage.take(&sample(1, 5, 2)), Crossed::Begins, "after a cut its subscribers are told anew");
        let certificates: Vec<_> = std::iter::from_fn(|| passage.certificate()).collect();
        assert_eq!(certificates.len(), 3);
        assert!(certificates.iter().all(|c| !c.end_seen));
    }
}
