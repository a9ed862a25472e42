//! Strokes of a run with constant flows, and in each the interval of steady velocity, found by itself (sec. 4.4, fig. 7): after a
//! transient the lever moves at a steady velocity, but only for a certain time.

use std::ops::Range;

use recordings::Recording;

use crate::noise::{mean, median, step, white_std};
use crate::prepare::segments;

/// A segment in which the lever moves is called steady where its velocity stays within this share of the typical one, or within what
/// the encoder's noise makes of it.
const TOLERANCE: f64 = 0.03;
/// Share of the velocity that the noise of one window may make up where the stroke leaves a choice.
const NOISE_SHARE: f64 = 0.01;
/// Where it makes up more than this, nothing can be said of the velocity.
const NOISE_MOST: f64 = 0.10;
/// Shortest window, s: shorter than the shortest transient.
const WINDOW_S: f64 = 0.3;
/// Windows that a stroke is divided into at least.
const WINDOWS: f64 = 5.0;
/// Slower than this is rest, rad/s.
const REST_RAD_S: f64 = 5e-3;

/// A segment in which the lever moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Stroke {
    /// Number of the segment, as recorded.
    pub segment: i64,
    /// Its rows.
    pub rows: Range<usize>,
    /// Begin and end since the run's start, s.
    pub span_s: (f64, f64),
    /// The interval of steady velocity; `None` where the stroke has none, or is too short or too noisy to show it.
    pub steady: Option<Steady>,
}

/// An interval of steady velocity.
#[derive(Clone, Debug, PartialEq)]
pub struct Steady {
    /// Its rows.
    pub rows: Range<usize>,
    /// Begin and end since the run's start, s.
    pub span_s: (f64, f64),
    /// Mean velocity, degrees a second.
    pub velocity_deg_s: f64,
    /// By how much the velocity of a part of it differs from that at most, share of it.
    pub deviation: f64,
    /// Angle at its begin and its end, degrees: means of the first and the last window.
    pub angle_deg: (f64, f64),
}

/// A part of a stroke, long enough for a velocity.
struct Window {
    rows: Range<usize>,
    velocity_rad_s: f64,
    angle_deg: f64,
}

/// The strokes of a run in the order of time: all segments in which the lever moves.
pub fn strokes(r: &Recording) -> Vec<Stroke> {
    let noise_deg = noise_deg(&r.angle_deg);
    segments(r).into_iter().filter_map(|(first, end)| stroke(r, first..end, noise_deg)).collect()
}

/// Noise of one value of the angle, degrees: its white part, at least what the encoder's steps make.
fn noise_deg(angle_deg: &[f64]) -> f64 {
    white_std(angle_deg).unwrap_or(0.0).max(step(angle_deg) / 12f64.sqrt())
}

fn stroke(r: &Recording, rows: Range<usize>, noise_deg: f64) -> Option<Stroke> {
    let span_s = (r.time_s[rows.start], r.time_s[rows.end - 1]);
    let lasts_s = span_s.1 - span_s.0;
    let rough = windows(r, &rows, WINDOW_S.min(lasts_s / WINDOWS));
    let typical = typical(&rough)?;
    // sigma sqrt(12 dt / T^3): what white noise makes of a slope over T
    let dt_s = lasts_s / (rows.len().max(2) - 1) as f64;
    let noise_of = |window_s: f64| noise_deg.to_radians() * (12.0 * dt_s / window_s.powi(3)).sqrt() / typical.abs();
    let enough_s = WINDOW_S * (noise_of(WINDOW_S) / NOISE_SHARE).powf(2.0 / 3.0);
    let window_s = enough_s.max(WINDOW_S).min(lasts_s / WINDOWS);
    let noise = noise_of(window_s);
    let found = (noise < NOISE_MOST).then(|| steady(r, windows(r, &rows, window_s), TOLERANCE.max(3.0 * noise)));
    Some(Stroke { segment: r.segment[rows.start], rows, span_s, steady: found.flatten() })
}

/// Median velocity of the windows in which the lever moves, rad/s; `None` where too few do.
fn typical(windows: &[Window]) -> Option<f64> {
    let mut moving: Vec<f64> = windows.iter().map(|w| w.velocity_rad_s).filter(|w| w.abs() > REST_RAD_S).collect();
    (moving.len() >= 3 && 2 * moving.len() >= windows.len()).then(|| median(&mut moving))
}

/// The longest interval whose windows, and the neighbours of each, lie within the tolerance of the typical velocity.
fn steady(r: &Recording, windows: Vec<Window>, tolerance: f64) -> Option<Steady> {
    let typical = typical(&windows)?;
    let near: Vec<bool> = windows.iter().map(|w| (w.velocity_rad_s / typical - 1.0).abs() < tolerance).collect();
    // The window beside a transient holds a part of it.
    let inner: Vec<bool> =
        (0..near.len()).map(|i| i > 0 && i + 1 < near.len() && near[i - 1] && near[i] && near[i + 1]).collect();
    let (mut longest, mut begin) = (0..0, 0);
    for i in 0..=inner.len() {
        if i == inner.len() || !inner[i] {
            if i - begin > longest.len() {
                longest = begin..i;
            }
            begin = i + 1;
        }
    }
    let part = &windows[longest];
    let (first, last) = (part.first()?, part.last()?);
    let rows = first.rows.start..last.rows.end;
    let (velocity, _) = mean(part.iter().map(|w| w.velocity_rad_s));
    Some(Steady {
        span_s: (r.time_s[rows.start], r.time_s[rows.end - 1]),
        rows,
        velocity_deg_s: velocity.to_degrees(),
        deviation: part.iter().map(|w| (w.velocity_rad_s / velocity - 1.0).abs()).fold(0.0, f64::max),
        angle_deg: (first.angle_deg, last.angle_deg),
    })
}

/// Windows of this length one after the other, with the slope of the angle in each; what is left at the end is none.
fn windows(r: &Recording, rows: &Range<usize>, length_s: f64) -> Vec<Window> {
    let mut out = Vec::new();
    let mut a = rows.start;
    while a < rows.end {
        let b = rows.start + r.time_s[rows.clone()].partition_point(|t| *t < r.time_s[a] + length_s);
        if b >= rows.end || b < a + 3 {
            break;
        }
        let (t, _) = mean((a..b).map(|i| r.time_s[i]));
        let (angle_deg, _) = mean(r.angle_deg[a..b].iter().copied());
        let (mut tt, mut tp) = (0.0, 0.0);
        for i in (a..b).filter(|&i| r.angle_deg[i].is_finite()) {
            tt += (r.time_s[i] - t).powi(2);
            tp += (r.time_s[i] - t) * (r.angle_deg[i] - angle_deg);
        }
        if tt > 0.0 {
            out.push(Window { rows: a..b, velocity_rad_s: (tp / tt).to_radians(), angle_deg });
        }
        a = b;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, Normal};

    /// A stroke: the velocity rises with `rise_s`, is `velocity_deg_s` until `drift_from_s` and falls off linearly from there by
    /// `fall` a second; then `rest_s` of rest.
    #[derive(Clone, Copy, Debug)]
    struct Made {
        velocity_deg_s: f64,
        rise_s: f64,
        drift_from_s: f64,
        fall: f64,
        lasts_s: f64,
        rest_s: f64,
    }

    impl Made {
        fn velocity(&self, t: f64) -> f64 {
            if t >= self.lasts_s {
                return 0.0;
            }
            let drift = 1.0 - self.fall * (t - self.drift_from_s).max(0.0);
            self.velocity_deg_s * (1.0 - (-t / self.rise_s).exp()) * drift.max(0.3)
        }
    }

    /// The strokes one after the other, each from the same angle, sampled at a rate, with noise and steps of an encoder.
    fn record(strokes: &[Made], rate_hz: f64, noise_deg: f64, step_deg: f64, seed: u64) -> Recording {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let normal = Normal::new(0.0, noise_deg).expect("a standard deviation");
        let mut r = Recording::default();
        let mut n = 0u32;
        for (segment, made) in strokes.iter().enumerate() {
            let mut angle = -26.0;
            let rows = ((made.lasts_s + made.rest_s) * rate_hz) as usize;
            for row in 0..rows {
                let t = row as f64 / rate_hz;
                r.time_s.push(f64::from(n) / rate_hz);
                n += 1;
                let seen = angle + normal.sample(&mut rng);
                r.angle_deg.push(if step_deg > 0.0 { (seen / step_deg).round() * step_deg } else { seen });
                r.voltage_v.push(if t < made.lasts_s { 6.0 } else { 0.0 });
                r.segment.push(segment as i64);
                for k in 0..10 {
                    angle += made.velocity(t + (f64::from(k) + 0.5) / 10.0 / rate_hz) / 10.0 / rate_hz;
                }
            }
        }
        let rows = r.len();
        (r.pressure1_bar, r.pressure2_bar) = (vec![3.0; rows], vec![2.9; rows]);
        (r.torque_nm, r.volume_ml) = (vec![f64::NAN; rows], vec![f64::NAN; rows]);
        (r.brake_open, r.bypass_open) = (vec![true; rows], vec![false; rows]);
        r
    }

    /// Velocities of 1 to 14 ml/s; the fast ones end at an angle, the slow ones at a time.
    fn fourteen() -> Vec<Made> {
        (1..=14)
            .map(|flow| {
                let velocity_deg_s = f64::from(flow) * 0.84;
                let lasts_s = (52.0 / velocity_deg_s).min(6.0);
                Made { velocity_deg_s, rise_s: 0.15, drift_from_s: 99.0, fall: 0.0, lasts_s, rest_s: 0.3 }
            })
            .collect()
    }

    #[test]
    fn every_stroke_is_found_at_any_rate_with_any_usual_noise() {
        for (rate_hz, noise_deg, step_deg) in [
            (1000.0, 0.0, 0.0),
            (1000.0, 0.01, 0.0),
            (1000.0, 0.05, 0.0),
            (1000.0, 0.01, 360.0 / 16384.0),
            (1000.0, 0.0, 360.0 / 16384.0),
            (250.0, 0.02, 0.0),
            (100.0, 0.01, 0.0),
            (100.0, 0.05, 0.0),
            (50.0, 0.02, 360.0 / 65536.0),
        ] {
            let r = record(&fourteen(), rate_hz, noise_deg, step_deg, 3);
            let found = strokes(&r);
            let with = format!("{rate_hz} Hz, noise {noise_deg}, step {step_deg}");
            assert_eq!(found.len(), 14, "{with}");
            for (stroke, made) in found.iter().zip(fourteen()) {
                let Some(steady) = &stroke.steady else { panic!("{with}: none in {made:?}") };
                let off = (steady.velocity_deg_s / made.velocity_deg_s - 1.0).abs();
                assert!(off < 0.03, "{with}: {steady:?} of {made:?}");
                let begin = steady.span_s.0 - stroke.span_s.0;
                assert!(begin > 2.0 * made.rise_s, "{with}: the transient is left out, {steady:?}");
                assert!(
                    steady.span_s.1 - stroke.span_s.0 <= made.lasts_s + 1e-9,
                    "{with}: rest is left out, {steady:?}"
                );
                let share = (steady.span_s.1 - steady.span_s.0) / made.lasts_s;
                assert!(share > 0.15, "{with}: only {share} of {made:?}");
            }
        }
    }

    #[test]
    fn a_velocity_that_is_steady_for_a_time_only_is_found_in_that_time() {
        let made = Made { velocity_deg_s: 6.0, rise_s: 0.2, drift_from_s: 4.0, fall: 0.25, lasts_s: 6.0, rest_s: 0.3 };
        for seed in 0..20 {
            let r = record(&[made], 1000.0, 0.02, 0.0, seed);
            let found = strokes(&r);
            let steady = found[0].steady.as_ref().expect("4 s are steady");
            assert!((steady.velocity_deg_s - 6.0).abs() < 0.06, "{steady:?}");
            assert!(steady.span_s.1 < 4.3 && steady.span_s.0 > 0.4, "{steady:?}");
            assert!(steady.span_s.1 - steady.span_s.0 > 2.0, "{steady:?}");
            assert!(steady.deviation < TOLERANCE, "{steady:?}");
        }
    }

    #[test]
    fn a_truncated_stroke_is_found_or_left_out_but_never_wrong() {
        let mut found_any = 0;
        for lasts_ms in (100..3000).step_by(100) {
            for velocity_deg_s in [0.8, 3.0, 11.0] {
                let lasts_s = f64::from(lasts_ms) * 1e-3;
                let made = Made { velocity_deg_s, rise_s: 0.1, drift_from_s: 99.0, fall: 0.0, lasts_s, rest_s: 0.0 };
                let r = record(&[made], 1000.0, 0.01, 0.0, lasts_ms as u64);
                let found: Vec<Stroke> = strokes(&r);
                if let Some(steady) = found.first().and_then(|stroke| stroke.steady.as_ref()) {
                    found_any += 1;
                    // A stroke that ends within its transient is as steady as it gets: its velocity is that of its end.
                    let reached = made.velocity(lasts_s - 1e-3);
                    let off = (steady.velocity_deg_s / reached - 1.0).abs();
                    let bound = 0.05 + 3.0 * (-lasts_s / 2.0 / 0.1f64).exp();
                    assert!(off < bound, "{off} of {made:?}: {steady:?}");
                }
            }
        }
        assert!(found_any > 50, "{found_any}");
    }

    #[test]
    fn rest_and_noise_are_no_strokes() {
        let still = Made { velocity_deg_s: 0.0, rise_s: 0.1, drift_from_s: 99.0, fall: 0.0, lasts_s: 5.0, rest_s: 0.0 };
        assert_eq!(strokes(&record(&[still], 1000.0, 0.02, 0.0, 1)), []);
        assert_eq!(strokes(&Recording::default()), []);
        // So noisy that a velocity can't be told.
        let slow = Made { velocity_deg_s: 0.5, rise_s: 0.1, drift_from_s: 99.0, fall: 0.0, lasts_s: 1.0, rest_s: 0.0 };
        let found = strokes(&record(&[slow], 50.0, 0.2, 0.0, 1));
        assert!(found.iter().all(|stroke| stroke.steady.is_none()), "{found:?}");
    }

    #[test]
    fn a_velocity_that_never_is_steady_has_no_interval() {
        let falling =
            Made { velocity_deg_s: 12.0, rise_s: 0.05, drift_from_s: 0.0, fall: 0.16, lasts_s: 4.0, rest_s: 0.0 };
        let found = strokes(&record(&[falling], 1000.0, 0.01, 0.0, 1));
        assert_eq!(found.len(), 1);
        assert_eq!(found[0].steady, None);
    }
}
