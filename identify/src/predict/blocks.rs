//! The rows of a block at which a simulation stops, and their mean, with which a target is compared.
//!
//! While nothing that drives the oil has changed for some time, what the sensors show bends so little within a block that its mean follows from the first row,
//! the middle one and the last: by the parabola through them. Nearly all of a torque map is of that kind, and nearly all of a run at constant flow; a third of
//! their rows are enough, and a lever that slides on takes long steps between them.

use crate::prepare::{Stand, Stretch};

/// A row, and its weight in the mean of its block.
pub(super) struct Stop {
    pub row: usize,
    pub weight: f64,
}

/// Time after a change of an input from which on the oil of a clamped lever only relaxes, s: a pump, a valve or a line has followed long before.
const SETTLED_S: f64 = 1.0;
/// The same for a free lever, whose pressures swing at some 10 Hz and die out within a few tenths of a second. A lever that breaks away or comes to a stop later,
/// from 5 degrees a second, bends the mean of that one block by 0.002 degrees: by its change of velocity times a twenty-fourth of the block at most.
const SETTLED_FREE_S: f64 = 0.5;

/// The stops of a stretch, in order: all rows, but for those of a block between its first, middle and last where it is settled. A guide draws at every row.
pub(super) fn stops(stretch: &Stretch) -> Vec<Stop> {
    let settled_s = match stretch.stand {
        Stand::Led => SETTLED_S,
        Stand::Free => SETTLED_FREE_S,
        _ => f64::INFINITY,
    };
    if settled_s.is_infinite() || stretch.guide.is_some() {
        return (0..stretch.rows()).map(|row| Stop { row, weight: 1.0 }).collect();
    }
    let mut out = Vec::new();
    let mut changed = 0;
    for block in stretch.blocks.windows(2) {
        let (first, last) = (block[0], block[1] - 1);
        let ever = (first.max(1)..=last).rfind(|&i| !goes_on(stretch, i));
        changed = ever.unwrap_or(changed);
        let middle = first + (last + 1 - first) / 2;
        let settled = stretch.time_s[first] - stretch.time_s[changed] > settled_s;
        if settled && last - first > 3 && is_complete(stretch, first, last) {
            let rows = [first, middle, last];
            out.extend(rows.into_iter().zip(weights(&stretch.time_s, rows)).map(|(row, weight)| Stop { row, weight }));
        } else {
            out.extend((first..=last).map(|row| Stop { row, weight: 1.0 }));
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
    block: usize,
}

impl Means {
    pub(super) fn new() -> Self {
        Means { sum: [0.0; 5], weight: [0.0; 5], block: 0 }
    }

    /// Adds a row; at a block's end its means go to `out`, in the order of the stretch's targets.
    pub(super) fn add(&mut self, s: &Stretch, &Stop { row: i, weight }: &Stop, y: &[f64; 5], out: &mut Vec<f64>) {
        for (c, value) in y.iter().enumerate() {
            if !s.measured[c].is_empty() && s.measured[c][i].is_finite() {
                self.sum[c] += weight * value;
                self.weight[c] += weight;
            }
        }
        if i + 1 == s.blocks[self.block + 1] {
            for c in 0..5 {
                if self.weight[c] > 0.0 {
                    out.push(self.sum[c] / self.weight[c]);
                }
            }
            *self = Means { block: self.block + 1, ..Means::new() };
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
        let all = stops(&s);
        let rows_of = |from_s: f64, to_s: f64| {
            all.iter().filter(|stop| (from_s - 1e-6..to_s - 1e-6).contains(&s.time_s[stop.row])).count()
        };
        assert_eq!((rows_of(0.0, 1.0), rows_of(4.0, 5.0)), (100, 100), "it relaxes");
        assert_eq!((rows_of(2.0, 3.0), rows_of(6.0, 6.9)), (30, 27));
        assert_eq!(rows_of(7.0, 7.1), 10, "a mean over nine rows");
        assert!(all.windows(2).all(|w| w[0].row < w[1].row));
        for block in s.blocks.windows(2) {
            let own: Vec<&Stop> = all.iter().filter(|stop| (block[0]..block[1]).contains(&stop.row)).collect();
            assert!(
                own.last().is_some_and(|stop| stop.row + 1 == block[1]),
                "a mean is done with its block's last row"
            );
            let middles = s.targets.iter().map(|t| t.middle).filter(|m| (block[0]..block[1]).contains(m));
            assert!(middles.into_iter().all(|m| own.iter().any(|stop| stop.row == m)), "where derivatives are taken");
        }
        let drawn = Stretch { guide: Some(Guide { lever_s: 0.03, pressure_s: 0.1 }), ..s.clone() };
        assert_eq!(stops(&drawn).len(), s.rows(), "a guide draws at every row");
        let free = Stretch { stand: Stand::Free, ..s.clone() };
        let early = |all: &[Stop]| all.iter().filter(|stop| (0.5..1.0).contains(&s.time_s[stop.row])).count();
        assert_eq!((early(&all), early(&stops(&free))), (50, 22), "a free lever settles sooner");
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
                assert!(stops(s).len() < 9 * s.rows() / 10, "{} stops in {} rows", stops(s).len(), s.rows());
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
