//! The rows of a block at which a simulation stops, and their mean, with which a target is compared.
//!
//! While nothing that drives the oil has changed for some time, what the sensors show bends so little within a block that its mean follows from the first row,
//! the middle one and the last: by the parabola through them. Nearly all of a torque map is of that kind, and nearly all of a run at constant flow; a third of
//! their rows are enough, and a lever that slides on takes long steps between them. Of a clamped lever the middle is enough later on. Where the
//! pressures are inputs that were smoothed, rows a tenth of a second apart tell all that is known of them.

use crate::prepare::{Stand, Stretch};

/// A row, and its weight in the mean of its block.
pub(super) struct Stop {
    pub row: usize,
    pub weight: f64,
    /// The last of its block.
    pub last: bool,
}

/// Time after a change of an input from which on the oil of a clamped lever only relaxes, s: a pump, a valve or a line has followed long before.
const SETTLED_S: f64 = 1.0;
/// The same for a free lever, whose pressures swing at some 10 Hz and die out within a few tenths of a second. A lever that breaks away or comes to a stop later,
/// from 5 degrees a second, bends the mean of that one block by 0.002 degrees: by its change of velocity times a twenty-fourth of the block at most.
const SETTLED_FREE_S: f64 = 0.5;

/// Time after which the oil of a clamped lever bends the mean of a block by less than 1e-4 bar, s: a bar that is still to come with 0.5 s leaves 4e-5.
const STILL_S: f64 = 2.0;
/// Distance of the rows of a drained chamber, s: half of what its pressures are smoothed over.
const SPACING_S: f64 = 0.1;

/// The stops of a stretch, in order: all rows, but for those of a block between its first, middle and last where it is settled, and all but its middle where
/// it is still. A guide draws at every row. `slow`: pressure sensors may be, and what they saw of a pressure that is an input goes with the row before.
pub(super) fn stops(stretch: &Stretch, slow: bool) -> Vec<Stop> {
    let (settled_s, still_s) = match stretch.stand {
        Stand::Led => (SETTLED_S, STILL_S),
        Stand::Free => (SETTLED_FREE_S, f64::INFINITY),
        Stand::Drained if !slow => return spaced(stretch),
        _ => (f64::INFINITY, f64::INFINITY),
    };
    if settled_s.is_infinite() || stretch.guide.is_some() {
        let last = |row: usize| stretch.blocks.binary_search(&(row + 1)).is_ok();
        return (0..stretch.rows()).map(|row| Stop { row, weight: 1.0, last: last(row) }).collect();
    }
    let mut out = Vec::new();
    let mut changed = 0;
    for block in stretch.blocks.windows(2) {
        let (first, last) = (block[0], block[1] - 1);
        let ever = (first.max(1)..=last).rfind(|&i| !goes_on(stretch, i));
        changed = ever.unwrap_or(changed);
        let middle = first + (last + 1 - first) / 2;
        let since_s = stretch.time_s[first] - stretch.time_s[changed];
        let shorter = since_s > settled_s && last - first > 3 && is_complete(stretch, first, last);
        if shorter && since_s > still_s {
            // of an even number of rows two are in the middle
            let before = middle + middle - first - last;
            let begin = middle - before.min(1);
            out.extend((begin..=middle).map(|row| Stop { row, weight: 1.0, last: row == middle }));
        } else if shorter {
            let rows = [first, middle, last];
            let stop = |(row, weight)| Stop { row, weight, last: row == last };
            out.extend(rows.into_iter().zip(weights(&stretch.time_s, rows)).map(stop));
        } else {
            out.extend((first..=last).map(|row| Stop { row, weight: 1.0, last: row == last }));
        }
    }
    out
}

/// Rows [`SPACING_S`] apart, and those that a block begins or ends with, that a target's derivatives are taken at, that something changes at, or that begin or
/// end what was measured. A row between two of them counts as what the straight line between those says.
fn spaced(s: &Stretch) -> Vec<Stop> {
    let alike = |i: usize, j: usize| s.measured.iter().all(|m| m.is_empty() || m[i].is_finite() == m[j].is_finite());
    let mut middles: Vec<usize> = s.targets.iter().map(|t| t.middle).collect();
    middles.sort_unstable();
    let mut out: Vec<Stop> = Vec::new();
    for block in s.blocks.windows(2) {
        let (first, last) = (block[0], block[1] - 1);
        let begun = out.len();
        for i in first..=last {
            let due = |stop: &Stop| s.time_s[i + 1] - s.time_s[stop.row] > SPACING_S + 1e-6;
            let is_stop = i == first
                || i == last
                || out[begun..].last().is_none_or(due)
                || middles.binary_search(&i).is_ok()
                || !alike(i, i - 1)
                || !alike(i, i + 1)
                || s.voltage_v[i] != s.voltage_v[i - 1]
                || s.brake_open[i] != s.brake_open[i - 1]
                || s.bypass_open[i] != s.bypass_open[i - 1];
            if is_stop {
                out.push(Stop { row: i, weight: 1.0, last: i == last });
            }
        }
        for n in begun + 1..out.len() {
            let (a, b) = (out[n - 1].row, out[n].row);
            let far = |i: usize| (s.time_s[i] - s.time_s[a]) / (s.time_s[b] - s.time_s[a]);
            let of_later: f64 = (a + 1..b).map(far).sum();
            out[n].weight += of_later;
            out[n - 1].weight += (b - a - 1) as f64 - of_later;
        }
    }
    out
}

/// The inputs at a row are those of the row before.
fn goes_on(s: &Stretch, i: usize) -> bool {
    s.voltage_v[i] == s.voltage_v[i - 1]
        && s.brake_open[i] == s.brake_open[i - 1]
        && s.bypass_open[i] == s.bypass_open[i - 1]
        && s.angle_rad.get(i) == s.angle_rad.get(i - 1)
}

/// Every channel that is compared was measured at each of these rows.
fn is_complete(s: &Stretch, first: usize, last: usize) -> bool {
    s.measured.iter().filter(|m| !m.is_empty()).all(|m| m[first..=last].iter().all(|v| v.is_finite()))
}

/// What the values at these three rows weigh in the mean over all rows from the first to the last, by the parabola through them.
fn weights(time_s: &[f64], rows: [usize; 3]) -> [f64; 3] {
    let at = rows.map(|row| time_s[row]);
    let all = &time_s[rows[0]..=rows[2]];
    [0, 1, 2].map(|j| {
        let (one, other) = (at[(j + 1) % 3], at[(j + 2) % 3]);
        let sum: f64 = all.iter().map(|t| (t - one) * (t - other) / ((at[j] - one) * (at[j] - other))).sum();
        sum / all.len() as f64
    })
}

/// Running means over the blocks, of the rows where the channel was measured.
pub(super) struct Means {
    sum: [f64; 5],
    weight: [f64; 5],
}

impl Means {
    pub(super) fn new() -> Self {
        Means { sum: [0.0; 5], weight: [0.0; 5] }
    }

    /// Adds a row; at a block's end its means go to `out`, in the order of the stretch's targets.
    pub(super) fn add(&mut self, s: &Stretch, &Stop { row: i, weight, last }: &Stop, y: &[f64; 5], out: &mut Vec<f64>) {
        for (c, value) in y.iter().enumerate() {
            if !s.measured[c].is_empty() && s.measured[c][i].is_finite() {
                self.sum[c] += weight * value;
                self.weight[c] += weight;
            }
        }
        if last {
            for c in 0..5 {
                if self.weight[c] > 0.0 {
                    out.push(self.sum[c] / self.weight[c]);
                }
            }
            *self = Means::new();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::guide::Guide;
    use crate::noise::mean;
    use crate::prepare::stretches;
    use recordings::{Plane, Protocol, Recording};

    /// A lever that is clamped for 8 s; the voltage changes after 4 s, and one reading of the torque, after 7 s, is missing.
    fn clamped() -> Stretch {
        let rows = 800;
        let row = |i: usize| i as f64 * 0.01;
        let mut r = Recording {
            time_s: (0..rows).map(row).collect(),
            voltage_v: (0..rows).map(|i| if i < 400 { 1.5 } else { -1.5 }).collect(),
            angle_deg: vec![10.0; rows],
            pressure1_bar: (0..rows).map(|i| 2.5 + 0.1 * row(i)).collect(),
            pressure2_bar: (0..rows).map(|i| 2.5 - 0.1 * row(i)).collect(),
            torque_nm: (0..rows).map(row).collect(),
            volume_ml: vec![f64::NAN; rows],
            brake_open: vec![true; rows],
            bypass_open: vec![false; rows],
            segment: vec![0; rows],
        };
        r.torque_nm[700] = f64::NAN;
        let mut cut = stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &r).expect("a stretch");
        cut.remove(0)
    }

    #[test]
    fn three_rows_of_a_block_are_enough_long_after_a_change_where_all_was_measured() {
        let s = clamped();
        let all = stops(&s, false);
        let rows_of = |from_s: f64, to_s: f64| {
            all.iter().filter(|stop| (from_s - 1e-6..to_s - 1e-6).contains(&s.time_s[stop.row])).count()
        };
        assert_eq!((rows_of(0.0, 1.0), rows_of(4.0, 5.0)), (100, 100), "it relaxes");
        assert_eq!((rows_of(1.2, 2.0), rows_of(5.2, 6.0)), (24, 24));
        assert_eq!((rows_of(2.2, 3.0), rows_of(6.2, 6.9)), (16, 14), "it is still");
        assert_eq!(rows_of(7.0, 7.1), 10, "a mean over nine rows");
        assert!(all.windows(2).all(|w| w[0].row < w[1].row));
        for block in s.blocks.windows(2) {
            let own: Vec<&Stop> = all.iter().filter(|stop| (block[0]..block[1]).contains(&stop.row)).collect();
            assert!(own.last().is_some_and(|stop| stop.last), "a mean is done with its block's last stop");
            assert_eq!(own.iter().filter(|stop| stop.last).count(), 1);
            let middles = s.targets.iter().map(|t| t.middle).filter(|m| (block[0]..block[1]).contains(m));
            assert!(middles.into_iter().all(|m| own.iter().any(|stop| stop.row == m)), "where derivatives are taken");
        }
        let drawn = Stretch { guide: Some(Guide { lever_s: 0.03, pressure_s: 0.1 }), ..s.clone() };
        assert_eq!(stops(&drawn, false).len(), s.rows(), "a guide draws at every row");
        let free = Stretch { stand: Stand::Free, ..s.clone() };
        let early = |all: &[Stop]| all.iter().filter(|stop| (0.5..1.0).contains(&s.time_s[stop.row])).count();
        assert_eq!((early(&all), early(&stops(&free, false))), (50, 22), "a free lever settles sooner");
    }

    /// Oil that is let out of chamber 1 of a clamped lever in steps of 4 s, of which the first half second is a release.
    fn drained() -> Stretch {
        let mut r = Recording::default();
        for row in 0..2400 {
            let (step, within_s) = (row / 400, (row % 400) as f64 * 0.01);
            let (before, after) = (6.5 - step as f64, 5.5 - step as f64);
            let pressure_bar = before + (after - before) * (within_s / 0.5).min(1.0) + 0.1 * (-within_s).exp();
            let rests = within_s >= 0.5;
            r.time_s.push(row as f64 * 0.01);
            r.voltage_v.push(0.0);
            r.angle_deg.push(10.0);
            r.pressure1_bar.push(pressure_bar);
            r.pressure2_bar.push(2.0);
            r.torque_nm.push(if row == 1000 { f64::NAN } else { pressure_bar });
            r.volume_ml.push(if rests { 10.0 * step as f64 } else { f64::NAN });
            r.brake_open.push(false);
            r.bypass_open.push(false);
            r.segment.push(step as i64);
        }
        let mut cut = stretches(0, "c.csv", Protocol::ClampSteps, Plane::Horizontal, &r).expect("a stretch");
        assert_eq!(cut.len(), 1);
        cut.remove(0)
    }

    /// Means by the stops of a stretch and by all of its rows are within so much of each other, by channel (angle: none).
    fn are_alike(s: &Stretch, effect: Option<(&str, Vec<f64>)>, most: [f64; 5]) {
        let truth = model::Parameters::example();
        let base = crate::common::layout(&truth);
        let mut theta = base.vector_of(&truth);
        let layout = match &effect {
            Some((id, values)) => {
                theta.extend(values);
                base.with(model::effects::find(id).expect("an effect of the library"))
            }
            None => base,
        };
        let by_stops = crate::predict::predict(s, &layout, &theta, &[0.0; 3]).expect("in range");
        let linear = crate::predict::linearise(s, &layout, &theta, &[0.0; 3]).expect("in range");
        let rows = crate::predict::predict_rows(s, &layout, &theta, &[0.0; 3]).expect("in range");
        assert_eq!((by_stops.len(), linear.predicted.len()), (s.targets.len(), s.targets.len()));
        for ((target, by_stops), linear) in s.targets.iter().zip(by_stops).zip(linear.predicted) {
            let block = s.blocks.windows(2).find(|b| (b[0]..b[1]).contains(&target.middle)).expect("a block");
            let c = target.channel.index();
            let known = (block[0]..block[1]).filter(|&i| s.measured[c][i].is_finite());
            let of_rows = mean(known.map(|i| rows[i][c])).0;
            assert!((by_stops - of_rows).abs() < most[c], "{effect:?} {target:?}: {by_stops} and {of_rows}");
            assert!((linear - of_rows).abs() < most[c], "{effect:?} {target:?}: {linear} and {of_rows}");
        }
    }

    #[test]
    fn the_means_of_a_clamped_lever_and_of_a_drained_chamber_are_those_of_all_their_rows() {
        let effects = [
            None,
            Some(("wall_creep", vec![2.0, 1.0])),
            Some(("pressure_lag", vec![0.05, 0.02])),
            Some(("elastic_hysteresis", vec![0.5, 0.1])),
            Some(("pump_lag", vec![0.1])),
        ];
        // hundredths of a noise of 0.005 bar and of 0.05 ml, and the twentieth of 0.03 Nm: where a pressure difference changes its sign the torque has a kink
        for effect in effects {
            are_alike(&clamped(), effect.clone(), [0.0, 5e-5, 5e-5, 1.5e-3, 0.0]);
            are_alike(&drained(), effect, [0.0, 5e-5, 5e-5, 1.5e-3, 5e-4]);
        }
        let s = drained();
        assert!(stops(&s, false).len() < s.rows() / 6, "{} stops in {} rows", stops(&s, false).len(), s.rows());
        assert_eq!(stops(&s, false).iter().filter(|stop| stop.last).count(), s.blocks.len() - 1);
    }

    #[test]
    fn the_means_of_a_free_lever_are_those_of_all_its_rows_in_steps_from_row_to_row() {
        let truth = model::Parameters::example();
        let find = |id| model::effects::find(id).expect("an effect of the library");
        // where the lever breaks away or hits something within a block: 0.002 degrees
        let effects = [
            (None, 1e-4),
            (Some(("torque_cubic", vec![0.3, 0.0, 0.0])), 1e-4),
            (Some(("pump_lag", vec![0.02])), 1e-4),
            (Some(("stribeck_friction", vec![1.5, 0.1, 0.02])), 2e-3),
            (Some(("elastic_hysteresis", vec![1.0, 0.05])), 2e-3),
        ];
        for (effect, most_deg) in effects {
            let effect = effect.map(|(id, values)| (find(id), values));
            let problem = crate::common::problem(&[crate::common::dynamic(&truth, effect.clone(), 20.0, 7)]);
            let base = crate::common::layout(&truth);
            let mut theta = base.vector_of(&truth);
            let layout = match &effect {
                Some((effect, values)) => {
                    theta.extend(values);
                    base.with(*effect)
                }
                None => base,
            };
            for s in &problem.stretches {
                assert!(
                    stops(s, false).len() < 9 * s.rows() / 10,
                    "{} stops in {} rows",
                    stops(s, false).len(),
                    s.rows()
                );
                let by_stops = crate::predict::predict(s, &layout, &theta, &[0.0; 3]).expect("in range");
                let rows = crate::predict::predict_rows(s, &layout, &theta, &[0.0; 3]).expect("in range");
                for (target, by_stops) in s.targets.iter().zip(by_stops) {
                    let block = s.blocks.windows(2).find(|b| (b[0]..b[1]).contains(&target.middle)).expect("a block");
                    let of_rows = mean(rows[block[0]..block[1]].iter().map(|y| y[target.channel.index()])).0;
                    // a hundredth of a noise of 0.01 degrees, and so much of the pressures' in bar
                    let most = if target.channel == crate::prepare::Channel::Angle { most_deg } else { 0.5 * most_deg };
                    assert!((by_stops - of_rows).abs() < most, "{target:?}: {by_stops} and {of_rows}");
                }
            }
        }
    }

    #[test]
    fn a_mean_follows_from_three_rows_whatever_their_distances() {
        let time_s = [0.0, 0.01, 0.02, 0.035, 0.04, 0.05, 0.061];
        let of = |t: f64| 3.0 - 2.0 * t + 40.0 * t * t;
        let rows = [0, 3, 6];
        let mean = time_s.iter().map(|t| of(*t)).sum::<f64>() / time_s.len() as f64;
        let by_three: f64 = rows.iter().zip(weights(&time_s, rows)).map(|(row, w)| w * of(time_s[*row])).sum();
        assert!((mean - by_three).abs() < 1e-12, "{mean} {by_three}");
    }
}
