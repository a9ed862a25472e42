//! Samples for the eye: each bucket of 10 ticks keeps the lowest, the highest and the last value of each channel, so that no spike
//! is lost; what is missing shows.

use rt_core::{Sample, TargetKind};

/// Ticks of a bucket.
pub const TICKS: u64 = 10;

/// A channel as clients are told of it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Channel {
    /// With the unit in it.
    pub name: &'static str,
    /// For people.
    pub label: &'static str,
    /// Empty where it has none.
    pub unit: &'static str,
    /// Channels of a group belong into one plot.
    pub group: &'static str,
}

const fn channel(name: &'static str, label: &'static str, unit: &'static str, group: &'static str) -> Channel {
    Channel { name, label, unit, group }
}

/// Channels of a bucket.
pub const COUNT: usize = 15;

/// In the order of a bucket.
pub const CHANNELS: [Channel; COUNT] = [
    channel("voltage_v", "voltage", "V", "voltage"),
    channel("angle_deg", "angle", "deg", "angle"),
    channel("pressure1_bar", "pressure 1", "bar", "pressure"),
    channel("pressure2_bar", "pressure 2", "bar", "pressure"),
    channel("torque_nm", "torque", "Nm", "torque"),
    channel("volume_ml", "volume", "ml", "volume"),
    channel("brake_open", "brake open", "", "valves"),
    channel("bypass_open", "bypass open", "", "valves"),
    channel("lateness_us", "wake-up late by", "us", "timing"),
    channel("reference_voltage_v", "voltage, wanted", "V", "voltage"),
    channel("reference_angle_deg", "angle, wanted", "deg", "angle"),
    channel("reference_pressure1_bar", "pressure 1, wanted", "bar", "pressure"),
    channel("reference_pressure2_bar", "pressure 2, wanted", "bar", "pressure"),
    channel("reference_pressure_difference_bar", "pressure 1 - 2, wanted", "bar", "pressure"),
    channel("reference_flow_ml_s", "flow, wanted", "ml/s", "flow"),
];

/// In the order of [`CHANNELS`].
fn values(sample: &Sample) -> [f32; COUNT] {
    let asked = TargetKind::of_code(sample.target_of);
    let wanted = |kind: TargetKind| if asked == Some(kind) { sample.target as f32 } else { f32::NAN };
    [
        sample.voltage_v as f32,
        sample.angle_deg as f32,
        sample.pressure1_bar as f32,
        sample.pressure2_bar as f32,
        sample.torque_nm as f32,
        sample.volume_ml as f32,
        f32::from(u8::from(sample.brake_open())),
        f32::from(u8::from(sample.bypass_open())),
        sample.lateness_ns as f32 * 1e-3,
        wanted(TargetKind::Voltage),
        wanted(TargetKind::Angle),
        wanted(TargetKind::Pressure1),
        wanted(TargetKind::Pressure2),
        wanted(TargetKind::PressureDifference),
        wanted(TargetKind::Flow),
    ]
}

/// What a channel did within a bucket; NaN: nothing was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// Lowest value.
    pub min: f32,
    /// Highest value.
    pub max: f32,
    /// Last value; NaN too where samples of the bucket are missing.
    pub last: f32,
}

impl Span {
    const NOTHING: Span = Span { min: f32::NAN, max: f32::NAN, last: f32::NAN };

    fn take(&mut self, value: f32) {
        // `min` and `max` pass over a NaN.
        *self = Span { min: self.min.min(value), max: self.max.max(value), last: value };
    }
}

/// Ten ticks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bucket {
    /// When its first tick was due, s of the run.
    pub begin_s: f64,
    /// In the order of [`CHANNELS`].
    pub spans: [Span; COUNT],
}

impl Bucket {
    fn empty(index: u64) -> Bucket {
        Bucket { begin_s: rt_core::Tick::at(index * TICKS).seconds(), spans: [Span::NOTHING; COUNT] }
    }
}

#[derive(Clone, Copy, Debug)]
struct Open {
    index: u64,
    bucket: Bucket,
    last_tick: u64,
    /// Samples of it are missing.
    holed: bool,
}

impl Open {
    fn closed(mut self) -> Bucket {
        if self.holed {
            self.bucket.spans.iter_mut().for_each(|span| span.last = f32::NAN);
        }
        self.bucket
    }
}

/// Makes buckets of the samples of one run.
#[derive(Clone, Debug, Default)]
pub struct Decimator {
    open: Option<Open>,
    /// Number that the next sample must have; `None`: whatever comes first is the first.
    expected: Option<u64>,
    missed: u64,
}

impl Decimator {
    /// Of a run that is followed from its first sample on.
    pub fn from_start() -> Self {
        Decimator { expected: Some(0), ..Decimator::default() }
    }

    /// Samples that did not come.
    pub fn missed(&self) -> u64 {
        self.missed
    }

    /// Takes the next sample; `out` gets what is complete.
    pub fn push(&mut self, sample: &Sample, out: &mut impl FnMut(Bucket)) {
        let sequence = sample.sequence();
        let gap = self.expected.map_or(0, |expected| sequence.saturating_sub(expected));
        self.expected = Some(sequence + 1);
        self.missed += gap;
        let index = sample.tick / TICKS;
        let mut open = match self.open.take() {
            Some(open) if open.index == index => Open { holed: open.holed || gap > 0, ..open },
            before => {
                if let Some(mut before) = before {
                    before.holed |= gap > 0 && before.last_tick % TICKS != TICKS - 1;
                    out(before.closed());
                    if gap > 0 && index > before.index + 1 {
                        out(Bucket::empty(before.index + 1));
                    }
                }
                let holed = gap > 0 && !sample.tick.is_multiple_of(TICKS);
                Open { index, bucket: Bucket::empty(index), last_tick: sample.tick, holed }
            }
        };
        open.last_tick = sample.tick;
        open.bucket.spans.iter_mut().zip(values(sample)).for_each(|(span, value)| span.take(value));
        self.open = Some(open);
        if sample.last() {
            self.close(out);
        }
    }

    /// The run is over, or nobody knows how it goes on: what is there is all.
    pub fn close(&mut self, out: &mut impl FnMut(Bucket)) {
        if let Some(open) = self.open.take() {
            out(open.closed());
        }
    }
}

/// Buckets as bytes for clients, kind 1 of the live messages.
pub fn encode<'a>(run: u32, buckets: impl ExactSizeIterator<Item = &'a Bucket> + Clone) -> Vec<u8> {
    let count = buckets.len();
    let mut bytes = Vec::with_capacity(16 + count * (8 + COUNT * 12));
    for word in [1, run, count as u32, COUNT as u32] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    buckets.clone().for_each(|bucket| bytes.extend_from_slice(&bucket.begin_s.to_le_bytes()));
    for channel in 0..COUNT {
        let of: [fn(&Span) -> f32; 3] = [|span| span.min, |span| span.max, |span| span.last];
        for part in of {
            buckets.clone().for_each(|bucket| bytes.extend_from_slice(&part(&bucket.spans[channel]).to_le_bytes()));
        }
    }
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::flags;

    fn sample(tick: u64, voltage_v: f64) -> Sample {
        Sample { tick, scheduled_ns: tick * rt_core::PERIOD_NS, voltage_v, ..Sample::BLANK }
    }

    fn buckets(mut decimator: Decimator, samples: &[Sample]) -> (Vec<Bucket>, u64) {
        let mut out = Vec::new();
        samples.iter().for_each(|sample| decimator.push(sample, &mut |bucket| out.push(bucket)));
        decimator.close(&mut |bucket| out.push(bucket));
        (out, decimator.missed())
    }

    #[test]
    fn a_spike_of_one_tick_is_kept_and_what_was_not_measured_stays_nan() {
        let samples: Vec<Sample> =
            (0..30).map(|tick| sample(tick, if tick == 13 { -7.0 } else { tick as f64 })).collect();
        let (out, missed) = buckets(Decimator::from_start(), &samples);
        assert_eq!((out.len(), missed), (3, 0));
        assert_eq!(out[1].begin_s, 0.01);
        assert_eq!(out[1].spans[0], Span { min: -7.0, max: 19.0, last: 19.0 });
        assert!(out[1].spans[1].max.is_nan() && out[1].spans[1].last.is_nan(), "the angle was not measured");
    }

    #[test]
    fn a_missed_sample_shows_in_its_bucket_and_missed_buckets_as_one_of_nan_and_a_jump() {
        let kept = |tick: &u64| !matches!(tick, 5 | 20..=54 | 70..=79);
        let samples: Vec<Sample> = (0..100).filter(kept).map(|tick| sample(tick, 1.0)).collect();
        let (out, missed) = buckets(Decimator::from_start(), &samples);
        assert_eq!(missed, 46);
        let begins: Vec<u64> = out.iter().map(|bucket| (bucket.begin_s * 1e3).round() as u64).collect();
        assert_eq!(begins, [0, 10, 20, 50, 60, 70, 80, 90]);
        let last: Vec<bool> = out.iter().map(|bucket| bucket.spans[0].last.is_nan()).collect();
        assert_eq!(last, [true, false, true, true, false, true, false, false]);
        assert!(out[2].spans[0].max.is_nan() && out[5].spans[0].max.is_nan(), "nothing came");
        assert_eq!((out[0].spans[0].max, out[3].spans[0].max), (1.0, 1.0), "what came is shown");
    }

    #[test]
    fn ticks_that_the_loop_passed_over_are_not_missing() {
        let samples = [sample(0, 1.0), Sample { skipped: 43, ..sample(44, 1.0) }];
        let (out, missed) = buckets(Decimator::from_start(), &samples);
        assert_eq!((out.len(), missed), (2, 0));
        assert!(out.iter().all(|bucket| bucket.spans[0].last == 1.0));
    }

    #[test]
    fn who_joins_late_misses_nothing_but_who_should_have_seen_the_start_does() {
        let late = [sample(995, 1.0), Sample { flags: flags::LAST, ..sample(996, 1.0) }];
        assert_eq!(buckets(Decimator::default(), &late).1, 0);
        assert_eq!(buckets(Decimator::from_start(), &late).1, 995);
    }

    #[test]
    fn a_reference_is_a_channel_of_its_kind_and_of_no_other() {
        for (kind, ..) in TargetKind::LIST {
            let asks = Sample { target: 3.5, target_of: kind.code(), ..sample(0, 1.0) };
            let (out, _) = buckets(Decimator::from_start(), &[asks]);
            let references =
                CHANNELS.iter().zip(out[0].spans).filter(|(channel, _)| channel.name.starts_with("reference_"));
            let with: Vec<_> = references.filter(|(_, span)| span.last == 3.5).map(|(channel, _)| *channel).collect();
            assert_eq!(with.len(), 1, "{kind:?}");
            assert_eq!(with[0].unit, kind.unit());
        }
        let (out, _) = buckets(Decimator::from_start(), &[sample(0, 1.0)]);
        assert!(out[0].spans[9..].iter().all(|span| span.max.is_nan()), "nothing is asked for");
    }

    #[test]
    fn the_bytes_are_those_of_the_document() {
        let (out, _) = buckets(Decimator::from_start(), &(0..20).map(|tick| sample(tick, 2.5)).collect::<Vec<_>>());
        let bytes = encode(7, out.iter());
        assert_eq!(bytes.len(), 16 + 2 * (8 + COUNT * 12));
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"));
        assert_eq!([word(0), word(4), word(8), word(12)], [1, 7, 2, COUNT as u32]);
        assert_eq!(f64::from_le_bytes(bytes[24..32].try_into().expect("8 bytes")), 0.01);
        // After the times: voltage lowest, highest, last of both buckets.
        let float = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().expect("4 bytes"));
        assert_eq!([float(32), float(36), float(40), float(52)], [2.5; 4]);
        assert!(float(56).is_nan(), "then the angle, which was not measured");
    }
}
