//! How the samples of one run follow each other: what may come next, what is missing, what can be certified.

use rt_core::{BeyondRange, LossCertificate, Sample};

/// A sample that can't follow those before it, or that no recording can hold.
pub(crate) struct Misfit {
    /// Field of the sample.
    pub column: &'static str,
    pub expected: String,
    pub got: String,
}

/// What of a sample those after it depend on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Last {
    pub run: u32,
    pub tick: u64,
    pub scheduled_ns: u64,
    pub skipped: u64,
    /// It is the run's last sample.
    pub ends: bool,
}

impl Last {
    fn of(sample: &Sample) -> Last {
        let Sample { run, tick, scheduled_ns, skipped, .. } = *sample;
        Last { run, tick, scheduled_ns, skipped, ends: sample.last() }
    }

    /// As [`Sample::sequence`].
    fn sequence(&self) -> u64 {
        self.tick.saturating_sub(self.skipped)
    }

    /// As [`Sample::time_s`].
    pub fn time_s(&self) -> f64 {
        Sample { scheduled_ns: self.scheduled_ns, ..Sample::BLANK }.time_s()
    }
}

/// The samples of a recording up to now.
#[derive(Clone, Debug, Default)]
pub(crate) struct Succession {
    last: Option<Last>,
    count: u64,
    gaps: Vec<(u64, u64)>,
}

/// A point that a succession can be taken back to.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mark {
    last: Option<Last>,
    count: u64,
    gaps: usize,
}

impl Succession {
    pub fn last(&self) -> Option<&Last> {
        self.last.as_ref()
    }

    /// Samples so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The number that comes next where nothing is lost; sample numbers leave out the ticks that the loop passed over.
    pub fn next_sequence(&self) -> u64 {
        self.last.map_or(0, |last| last.sequence() + 1)
    }

    /// Why `next` can't be the next sample; `None`: it can.
    #[inline]
    pub fn misfit(&self, next: &Sample) -> Option<Misfit> {
        let misfit = |column, expected: String, got: String| Some(Misfit { column, expected, got });
        if let Err(BeyondRange { field, bound, got }) = next.in_range() {
            return misfit(field, format!("a number below {bound}"), got.to_string());
        }
        // The first sample stands after a tick -1 at which nothing was skipped.
        let skipped_before = self.last.map_or(0, |last| last.skipped);
        let ticks_between = match &self.last {
            None => next.tick,
            Some(last) if next.run != last.run => {
                return misfit("run", format!("samples of run {}", last.run), next.run.to_string());
            }
            Some(last) if next.tick <= last.tick => {
                return misfit("tick", format!("a tick after {}", last.tick), next.tick.to_string());
            }
            Some(last) if next.scheduled_ns <= last.scheduled_ns => {
                let expected = format!("a time after {} ns", last.scheduled_ns);
                return misfit("scheduled_ns", expected, format!("{} ns", next.scheduled_ns));
            }
            Some(last) => next.tick - last.tick - 1,
        };
        if next.skipped < skipped_before || next.skipped - skipped_before > ticks_between {
            let most = skipped_before.saturating_add(ticks_between);
            let expected = format!("{skipped_before} to {most} ticks passed over up to here");
            return misfit("skipped", expected, next.skipped.to_string());
        }
        unfit_value(next)
    }

    /// Appends a sample that fits.
    #[inline]
    pub fn push(&mut self, sample: &Sample) {
        let expected = self.next_sequence();
        if sample.sequence() > expected {
            self.gaps.push((expected, sample.sequence() - 1));
        }
        self.last = Some(Last::of(sample));
        self.count += 1;
    }

    /// What can be certified of a run that has `expected` samples.
    pub fn certificate(&self, expected: u64) -> LossCertificate {
        let (run, seen) = (self.last.map_or(0, |last| last.run), self.next_sequence());
        let mut gaps = self.gaps.clone();
        if expected > seen {
            gaps.push((seen, expected - 1));
        }
        LossCertificate { run, expected, received: self.count, gaps, end_seen: true }
    }

    /// What can be certified where nobody told the run's length: the end was seen if the last sample is here.
    pub fn own_certificate(&self) -> LossCertificate {
        let end_seen = self.last.is_some_and(|last| last.ends);
        LossCertificate { end_seen, ..self.certificate(self.next_sequence()) }
    }

    /// Whether `certificate` says of these samples what is true of them.
    pub fn agrees_with(&self, certificate: &LossCertificate) -> bool {
        let own = self.certificate(certificate.expected);
        (self.last.is_none() || own.run == certificate.run)
            && certificate.expected >= self.next_sequence()
            && own.received == certificate.received
            && own.gaps == certificate.gaps
    }

    pub fn mark(&self) -> Mark {
        Mark { last: self.last, count: self.count, gaps: self.gaps.len() }
    }

    /// Forgets what came after `mark`.
    pub fn back_to(&mut self, mark: Mark) {
        self.last = mark.last;
        self.count = mark.count;
        self.gaps.truncate(mark.gaps);
    }
}

fn unfit_value(sample: &Sample) -> Option<Misfit> {
    let misfit =
        |column, expected: &str, got: f64| Some(Misfit { column, expected: expected.to_owned(), got: got.to_string() });
    if !sample.voltage_v.is_finite() {
        return misfit("voltage_v", "a finite number", sample.voltage_v);
    }
    let others = [
        ("angle_deg", sample.angle_deg),
        ("pressure1_bar", sample.pressure1_bar),
        ("pressure2_bar", sample.pressure2_bar),
        ("torque_nm", sample.torque_nm),
        ("volume_ml", sample.volume_ml),
        ("target", sample.target),
    ];
    let (column, value) = others.into_iter().find(|(_, value)| value.is_infinite())?;
    misfit(column, "a finite number, or NaN for a missing value", value)
}
