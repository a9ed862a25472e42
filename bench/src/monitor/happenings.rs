//! What happened, read off the samples' flags: begin and end of a run, trips, stops, missed deadlines, waits for people, sensors that
//! come and go.

use recordings::Severity;
use rt_core::{Channel, Input, Sample, flags};
use std::collections::VecDeque;

/// Happenings that are kept.
const KEPT: usize = 200;
/// Missed deadlines that follow each other within this time are one happening, ns.
const TOGETHER_NS: u64 = 1_000_000_000;
/// Sensors whose coming and going is told. Torque and volume are measured only now and then, by their nature.
const WATCHED: [Input; 3] = [Input::Angle, Input::Pressure1, Input::Pressure2];

/// Something that happened.
#[derive(Clone, Debug, PartialEq)]
pub struct Happening {
    /// Number of the run; `None`: it belongs to none.
    pub run: Option<u32>,
    /// Since the run's start, s.
    pub time_s: f64,
    /// How bad it is.
    pub severity: Severity,
    /// What.
    pub text: String,
}

/// The newest happenings, the oldest first.
#[derive(Clone, Debug, Default)]
pub struct Happenings {
    kept: VecDeque<Happening>,
    /// A row of missed deadlines: begin and newest, ns, how many, and the ticks that were skipped before it.
    late: Option<Late>,
}

#[derive(Clone, Copy, Debug)]
struct Late {
    newest_ns: u64,
    count: u64,
    skipped_before: u64,
}

impl Happenings {
    /// All of them, the oldest first.
    pub fn iter(&self) -> impl DoubleEndedIterator<Item = &Happening> + ExactSizeIterator {
        self.kept.iter()
    }

    /// Something that no sample tells.
    pub fn say(&mut self, severity: Severity, text: impl Into<String>) {
        self.push(Happening { run: None, time_s: 0.0, severity, text: text.into() });
    }

    /// A run begins, or the monitor joins it.
    pub fn begin(&mut self, first: &Sample) {
        self.late = None;
        let text = match first.sequence() {
            0 => format!("run {} begins", first.run),
            n => format!("run {} is under way: followed from sample {n}", first.run),
        };
        self.tell(first, Severity::Info, text);
        self.observe(&Sample { quality: first.quality, ..Sample::BLANK }, first);
    }

    /// Samples that the monitor did not get.
    pub fn missed(&mut self, next: &Sample, samples: u64) {
        self.tell(next, Severity::Warning, format!("{samples} samples were not received here"));
    }

    /// A sample, and the one before it of the same run.
    pub fn observe(&mut self, before: &Sample, sample: &Sample) {
        let rises = |bit: u32| sample.flags & bit != 0 && before.flags & bit == 0;
        let falls = |bit: u32| sample.flags & bit == 0 && before.flags & bit != 0;
        if rises(flags::FAULT) {
            self.tell(sample, Severity::Error, "the device failed; safe state".to_owned());
        }
        if rises(flags::TRIPPED) {
            self.tell(sample, Severity::Error, format!("tripped: {}", trip(sample)));
        }
        if rises(flags::STOPPED) {
            self.tell(sample, Severity::Warning, "a stop was asked for".to_owned());
        }
        if sample.overrun() {
            self.late(before, sample);
        }
        if rises(flags::WAITING) {
            self.tell(sample, Severity::Warning, "waits for people".to_owned());
        }
        if sample.confirmed() {
            let amount =
                if sample.volume_ml.is_finite() { format!(": {} ml", sample.volume_ml) } else { String::new() };
            self.tell(sample, Severity::Info, format!("confirmed{amount}"));
        } else if falls(flags::WAITING) && !sample.last() {
            self.tell(sample, Severity::Info, "waits no longer".to_owned());
        }
        if !sample.fault() {
            for input in WATCHED {
                let was = before.quality & input.bit() != 0;
                match (was, sample.quality & input.bit() != 0) {
                    (true, false) => {
                        self.tell(sample, Severity::Warning, format!("{}: no sound value", input.column()));
                    }
                    (false, true) => self.tell(sample, Severity::Info, format!("{}: there again", input.column())),
                    _ => {}
                }
            }
        }
        if sample.last() {
            let (severity, how) = ending(sample);
            self.tell(sample, severity, format!("run {} ended: {how}", sample.run));
        }
    }

    /// One line for a row of missed deadlines, which grows with it: a flood of them must not push everything else away.
    fn late(&mut self, before: &Sample, sample: &Sample) {
        let Late { count, skipped_before, .. } = self
            .late
            .filter(|late| sample.scheduled_ns.saturating_sub(late.newest_ns) <= TOGETHER_NS)
            .unwrap_or(Late { newest_ns: 0, count: 0, skipped_before: before.skipped.min(sample.skipped) });
        let late = Late { newest_ns: sample.scheduled_ns, count: count + 1, skipped_before };
        let skipped = sample.skipped - skipped_before;
        let text = match late.count {
            1 => format!("deadline missed, {skipped} ticks skipped"),
            n => format!(
                "{n} deadlines missed within {} s of each other, {skipped} ticks skipped",
                TOGETHER_NS / 1_000_000_000
            ),
        };
        if late.count > 1
            && let Some(at) = self.kept.iter().rposition(|h| h.run == Some(sample.run) && is_late(&h.text))
        {
            self.kept[at].text = text;
        } else {
            self.tell(sample, Severity::Warning, text);
        }
        self.late = Some(late);
    }

    fn tell(&mut self, at: &Sample, severity: Severity, text: String) {
        self.push(Happening { run: Some(at.run), time_s: at.time_s(), severity, text });
    }

    fn push(&mut self, happening: Happening) {
        if self.kept.len() == KEPT {
            self.kept.pop_front();
        }
        self.kept.push_back(happening);
    }
}

/// Whether it is the line of a row of missed deadlines.
fn is_late(text: &str) -> bool {
    text.starts_with("deadline missed,") || text.contains(" deadlines missed within ")
}

/// How a run ended, by its last sample.
pub fn ending(last: &Sample) -> (Severity, String) {
    if last.fault() {
        (Severity::Error, "the device failed".to_owned())
    } else if last.tripped() {
        (Severity::Error, format!("tripped, {}", trip(last)))
    } else if last.flags & flags::STOPPED != 0 {
        (Severity::Warning, "stopped on request".to_owned())
    } else if last.overrun() {
        (Severity::Warning, "just after a missed deadline".to_owned())
    } else {
        (Severity::Info, "completed".to_owned())
    }
}

/// Why the supervisor tripped, in words, by the code that the sample carries.
pub fn trip(sample: &Sample) -> String {
    let Some(channel) = Channel::of_code(sample.trip) else { return "its reason is not told".to_owned() };
    let how = match sample.trip >> 8 {
        1 => "below its limit",
        2 if channel == Channel::Deadline => "missed",
        2 => "above its limit",
        3 => "not a finite number",
        4 => "missing, or called wrong by its device",
        5 => "too old",
        6 => "demanded",
        _ => "for a reason that this program does not know",
    };
    format!("{} {how}", channel.name())
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::PERIOD_NS;

    const SOUND: u32 = 0b111;

    fn sample(tick: u64, flags: u32) -> Sample {
        Sample { run: 4, tick, scheduled_ns: tick * PERIOD_NS, quality: SOUND, flags, ..Sample::BLANK }
    }

    fn told(samples: &[Sample]) -> Vec<(String, Severity)> {
        let mut happenings = Happenings::default();
        happenings.begin(&samples[0]);
        for pair in samples.windows(2) {
            happenings.observe(&pair[0], &pair[1]);
        }
        happenings.iter().map(|h| (h.text.clone(), h.severity)).collect()
    }

    #[test]
    fn a_run_s_life_is_told_once_each() {
        let overrun = Sample { skipped: 3, ..sample(5, flags::OVERRUN) };
        let trip = |tick, flags| Sample { trip: 1 | 2 << 8, skipped: 3, ..sample(tick, flags::TRIPPED | flags) };
        let confirmed = Sample { volume_ml: 1.25, ..sample(4, flags::CONFIRMED) };
        let run = [
            sample(0, 0),
            sample(1, 0),
            sample(2, flags::WAITING),
            sample(3, flags::WAITING),
            confirmed,
            overrun,
            trip(6, 0),
            trip(7, 0),
            trip(8, flags::LAST),
        ];
        let expected = [
            ("run 4 begins", Severity::Info),
            ("waits for people", Severity::Warning),
            ("confirmed: 1.25 ml", Severity::Info),
            ("deadline missed, 3 ticks skipped", Severity::Warning),
            ("tripped: pressure 1 above its limit", Severity::Error),
            ("run 4 ended: tripped, pressure 1 above its limit", Severity::Error),
        ];
        assert_eq!(told(&run), expected.map(|(text, severity)| (text.to_owned(), severity)));
    }

    #[test]
    fn endings_and_a_sensor_that_goes_and_comes() {
        let ends = |flags: u32| told(&[sample(7, 0), sample(8, flags::LAST | flags)]).pop().expect("the end is told");
        assert_eq!(ends(0), ("run 4 ended: completed".to_owned(), Severity::Info));
        assert_eq!(ends(flags::STOPPED), ("run 4 ended: stopped on request".to_owned(), Severity::Warning));
        assert_eq!(ends(flags::FAULT), ("run 4 ended: the device failed".to_owned(), Severity::Error));
        let without = |tick| Sample { quality: SOUND & !Input::Pressure1.bit(), ..sample(tick, 0) };
        let texts: Vec<String> =
            told(&[sample(7, 0), without(8), without(9), sample(10, 0)]).into_iter().map(|(text, _)| text).collect();
        assert_eq!(
            texts,
            [
                "run 4 is under way: followed from sample 7",
                "pressure1_bar: no sound value",
                "pressure1_bar: there again"
            ]
        );
    }

    #[test]
    fn a_flood_of_missed_deadlines_is_one_line() {
        let mut run = vec![sample(0, 0)];
        run.extend((1..5_000).map(|n| Sample { skipped: n, ..sample(2 * n, flags::OVERRUN) }));
        let told = told(&run);
        assert_eq!(told.len(), 2, "{told:?}");
        assert!(
            told[1].0.starts_with("4999 deadlines missed") && told[1].0.ends_with("4999 ticks skipped"),
            "{told:?}"
        );
        // Far apart they are several.
        let far: Vec<Sample> = (0..4).map(|n| sample(n * 2_000, flags::OVERRUN)).collect();
        assert_eq!(super::tests::told(&far).len(), 1 + 4);
    }
}
