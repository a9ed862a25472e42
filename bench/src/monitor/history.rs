//! The last minute of every quantity in buckets that keep the lowest and the highest value: a peak of one tick stays visible however
//! coarse the picture is.

use rt_core::{Sample, TargetKind};
use std::collections::VecDeque;

/// Length of a bucket, ns.
const BUCKET_NS: u64 = 20_000_000;
/// Longest time that is kept, s.
pub const KEPT_S: f64 = 60.0;
/// Buckets of that time.
const KEPT: usize = 3_000;

/// A quantity that is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Trace {
    /// The command, V.
    Voltage,
    /// The lever, degrees.
    Angle,
    /// Chamber 1, bar.
    Pressure1,
    /// Chamber 2, bar.
    Pressure2,
    /// Chamber 1 above chamber 2, bar.
    Difference,
    /// The clamp, Nm.
    Torque,
    /// The measuring cylinder, ml.
    Volume,
    /// What the profile asks for, in the unit of its kind.
    Target,
    /// Lateness of the wake-up, ms.
    Lateness,
}

impl Trace {
    /// All of them.
    pub const ALL: [Trace; 9] = [
        Trace::Voltage,
        Trace::Angle,
        Trace::Pressure1,
        Trace::Pressure2,
        Trace::Difference,
        Trace::Torque,
        Trace::Volume,
        Trace::Target,
        Trace::Lateness,
    ];

    /// Its value in this sample; NaN where there is none.
    pub fn of(self, sample: &Sample) -> f64 {
        match self {
            Trace::Voltage => sample.voltage_v,
            Trace::Angle => sample.angle_deg,
            Trace::Pressure1 => sample.pressure1_bar,
            Trace::Pressure2 => sample.pressure2_bar,
            Trace::Difference => sample.pressure1_bar - sample.pressure2_bar,
            Trace::Torque => sample.torque_nm,
            Trace::Volume => sample.volume_ml,
            Trace::Target => sample.target,
            Trace::Lateness => sample.lateness_ns as f64 * 1e-6,
        }
    }

    /// What a target of this kind is to be held against; a flow is not measured.
    pub fn actual(kind: TargetKind) -> Option<Trace> {
        match kind {
            TargetKind::Voltage => Some(Trace::Voltage),
            TargetKind::Flow => None,
            TargetKind::Pressure1 => Some(Trace::Pressure1),
            TargetKind::Pressure2 => Some(Trace::Pressure2),
            TargetKind::PressureDifference => Some(Trace::Difference),
            TargetKind::Angle => Some(Trace::Angle),
        }
    }
}

/// Lowest and highest value of a while; NaN where there was none.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Span {
    /// The lowest.
    pub low: f64,
    /// The highest.
    pub high: f64,
}

impl Span {
    const NONE: Span = Span { low: f64::NAN, high: f64::NAN };

    /// With another value; one that is no finite number changes nothing.
    fn with(self, value: f64) -> Span {
        // `min` and `max` take the number where the other is NaN.
        if value.is_finite() { Span { low: self.low.min(value), high: self.high.max(value) } } else { self }
    }

    fn joined(self, other: Span) -> Span {
        Span { low: self.low.min(other.low), high: self.high.max(other.high) }
    }
}

#[derive(Clone, Copy, Debug)]
struct Bucket {
    /// Its number since the run's start.
    number: u64,
    /// What the target was of when it began.
    target_of: u32,
    spans: [Span; Trace::ALL.len()],
}

/// See the module. Of one run: times are those since its start.
#[derive(Clone, Debug, Default)]
pub struct History {
    buckets: VecDeque<Bucket>,
}

/// Points of a curve without a gap: seconds before the newest bucket's end (negative), and a value.
pub type Stroke = Vec<(f64, f64)>;

impl History {
    /// Forgets everything: another run begins.
    pub fn clear(&mut self) {
        self.buckets.clear();
    }

    /// Takes a sample that is not older than those before it.
    pub fn push(&mut self, sample: &Sample) {
        let number = sample.scheduled_ns / BUCKET_NS;
        // Of another kind of target another bucket: a picture of one kind shows no value of another.
        let fits = |last: &Bucket| last.number == number && last.target_of == sample.target_of;
        if !self.buckets.back().is_some_and(fits) {
            if self.buckets.len() == KEPT {
                self.buckets.pop_front();
            }
            let spans = [Span::NONE; Trace::ALL.len()];
            self.buckets.push_back(Bucket { number, target_of: sample.target_of, spans });
        }
        if let Some(bucket) = self.buckets.back_mut() {
            for trace in Trace::ALL {
                let span = &mut bucket.spans[trace as usize];
                *span = span.with(trace.of(sample));
            }
        }
    }

    /// The curve of the last `window_s` seconds in at most `columns` columns, each drawn from its lowest to its highest value. It is
    /// broken where there was nothing. A target is drawn only where it was of the kind `of`.
    pub fn strokes(&self, trace: Trace, of: u32, window_s: f64, columns: usize) -> Vec<Stroke> {
        let Some(newest) = self.buckets.back().map(|bucket| bucket.number) else { return Vec::new() };
        let window = (window_s * 1e9 / BUCKET_NS as f64).ceil() as u64;
        // Columns are counted from the run's start, so that a value does not wander from one to the next as time goes on.
        let wide = window.div_ceil(columns.max(1) as u64).max(1);
        let mut strokes: Vec<Stroke> = Vec::new();
        let mut last: Option<(u64, Span)> = None;
        let place = |column: u64| {
            let middle = (column * wide) as f64 + wide as f64 / 2.0;
            (middle - newest as f64 - 1.0) * BUCKET_NS as f64 * 1e-9
        };
        let mut draw = |(column, span): (u64, Span), goes_on: bool| {
            if !goes_on || strokes.is_empty() {
                strokes.push(Stroke::new());
            }
            if let Some(stroke) = strokes.last_mut() {
                let x = place(column);
                stroke.push((x, span.low));
                if span.high > span.low {
                    stroke.push((x, span.high));
                }
            }
        };
        let mut before: Option<u64> = None;
        for bucket in self.buckets.iter().filter(|bucket| bucket.number + window > newest) {
            let span = bucket.spans[trace as usize];
            if span.low.is_nan() || (trace == Trace::Target && bucket.target_of != of) {
                continue;
            }
            let column = bucket.number / wide;
            last = match last {
                Some((at, so_far)) if at == column => Some((at, so_far.joined(span))),
                Some(done) => {
                    draw(done, before.is_some_and(|before| before + 1 >= done.0));
                    before = Some(done.0);
                    Some((column, span))
                }
                None => Some((column, span)),
            };
        }
        if let Some(done) = last {
            draw(done, before.is_some_and(|before| before + 1 >= done.0));
        }
        strokes
    }

    /// Lowest and highest value of the last `window_s` seconds; `None`: there was none.
    pub fn span(&self, trace: Trace, of: u32, window_s: f64) -> Option<Span> {
        let strokes = self.strokes(trace, of, window_s, usize::MAX);
        let values = strokes.iter().flatten().map(|(_, value)| *value);
        let span = values.fold(Span::NONE, Span::with);
        (!span.low.is_nan()).then_some(span)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rt_core::PERIOD_NS;

    fn filled(ticks: std::ops::Range<u64>, change: impl Fn(u64, &mut Sample)) -> History {
        let mut history = History::default();
        for tick in ticks {
            let mut sample = Sample { tick, scheduled_ns: tick * PERIOD_NS, ..Sample::BLANK };
            change(tick, &mut sample);
            history.push(&sample);
        }
        history
    }

    #[test]
    fn a_peak_of_one_tick_stays_in_the_coarsest_picture() {
        let history = filled(0..60_000, |tick, s| s.pressure1_bar = if tick == 12_345 { 9.5 } else { 2.0 });
        for columns in [1, 7, 80, 3_000] {
            let strokes = history.strokes(Trace::Pressure1, 0, KEPT_S, columns);
            assert_eq!(strokes.len(), 1, "nothing is missing");
            assert!(strokes[0].len() <= 2 * (columns + 1));
            let highest = strokes[0].iter().map(|(_, value)| *value).fold(f64::NAN, f64::max);
            assert_eq!(highest, 9.5, "{columns} columns");
        }
        let peak = history.strokes(Trace::Pressure1, 0, KEPT_S, 3_000)[0].iter().find(|(_, v)| *v == 9.5).copied();
        let (at_s, _) = peak.expect("it is there");
        assert!((at_s - (12.345 - 60.0)).abs() < 0.02, "{at_s}");
    }

    #[test]
    fn the_oldest_goes_and_what_was_not_measured_is_a_gap() {
        let history = filled(0..100_000, |tick, s| {
            s.angle_deg = if (99_000..99_200).contains(&tick) { f64::NAN } else { tick as f64 };
        });
        let strokes = history.strokes(Trace::Angle, 0, 2.0, 1_000);
        assert_eq!(strokes.len(), 2, "before the gap and behind it");
        assert!(strokes.iter().flatten().all(|(x, _)| (-2.05..=0.0).contains(x)));
        assert_eq!(history.span(Trace::Angle, 0, 1_000.0).map(|span| span.low), Some(40_000.0), "a minute is kept");
        assert_eq!(history.span(Trace::Torque, 0, 10.0), None);
    }

    #[test]
    fn a_target_is_shown_only_where_it_is_of_the_kind_that_is_drawn() {
        let history =
            filled(0..2_000, |tick, s| (s.target_of, s.target) = if tick < 1_010 { (1, 6.0) } else { (6, -30.0) });
        assert_eq!(history.span(Trace::Target, 1, 10.0), Some(Span { low: 6.0, high: 6.0 }));
        assert_eq!(history.span(Trace::Target, 6, 10.0), Some(Span { low: -30.0, high: -30.0 }));
        assert_eq!(history.strokes(Trace::Target, 6, 0.5, 100).len(), 1);
    }
}
