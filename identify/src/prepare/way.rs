//! The way on which a led lever came to where it is clamped: walls with a hysteresis remember it.

use model::port::Held;
use recordings::Recording;

use super::Stretch;
use crate::noise::mean;

/// A reversal of less is none, degrees: far below the way on which any hysteresis forgets.
const LEAST_DEG: f64 = 0.1;
/// A lever led faster than this from a row to the next was not led but set: the recording has a gap there. Degrees, and degrees a second.
const GAP_DEG: f64 = 1.0;
const GAP_DEG_S: f64 = 60.0;

/// Turning points of the lever from the run's start (or from the last gap) to row `end`, and `clamped_rad`, where it then stands; rad.
/// `noise_deg`: of one sample.
pub(super) fn way_rad(r: &Recording, end: usize, noise_deg: f64, clamped_rad: f64) -> Vec<f64> {
    let least = LEAST_DEG.max(4.0 * noise_deg);
    let mut way = Way::default();
    let mut last: Option<(f64, f64)> = None;
    let before = r.time_s[..end].iter().copied().zip(r.angle_deg[..end].iter().copied());
    let clamped = r.time_s.get(end).map(|t| (*t, clamped_rad.to_degrees()));
    for (t, angle) in before.chain(clamped).filter(|(_, angle)| angle.is_finite()) {
        let gap = last.is_some_and(|(t0, a0)| (angle - a0).abs() > GAP_DEG.max(GAP_DEG_S * (t - t0)));
        if gap {
            way = Way::default();
        }
        way.go(angle, least);
        last = Some((t, angle));
    }
    let mut points = way.turns;
    points.push(clamped_rad.to_degrees());
    points.into_iter().map(f64::to_radians).collect()
}

/// A way of less says nothing of what was before it, degrees: a lever that stands where its recording begins, or goes on after a gap.
const TOLD_DEG: f64 = 1.0;
/// The clamp's torque is read over so much of a dwell, s, if no other segment begins meanwhile.
const HELD_S: f64 = 2.0;

/// What holds the lever of a stretch from row `first` to `end` at first, if the way to there is not known and that was measured.
pub(super) fn held(stretch: &Stretch, r: &Recording, first: usize, end: usize) -> Option<Held> {
    let way_rad: f64 = stretch.way_rad.windows(2).map(|leg| (leg[1] - leg[0]).abs()).sum();
    if way_rad.to_degrees() >= TOLD_DEG {
        return None;
    }
    let same = |i: &usize| r.time_s[*i] - r.time_s[first] <= HELD_S && r.segment[*i] == r.segment[first];
    let read = |i: &usize| [&r.torque_nm, &r.pressure1_bar, &r.pressure2_bar].iter().all(|c| c[*i].is_finite());
    let rows: Vec<usize> = (first..end).take_while(same).filter(read).collect();
    let of = |values: &[f64]| mean(rows.iter().map(|i| values[*i])).0;
    let pressure_bar = [of(&r.pressure1_bar), of(&r.pressure2_bar)];
    (!rows.is_empty()).then(|| Held { torque_nm: of(&r.torque_nm), pressure_bar })
}

#[derive(Default)]
struct Way {
    /// Where it began, and where it turned.
    turns: Vec<f64>,
    /// Furthest since the last turn, and to which side.
    furthest: f64,
    side: f64,
}

impl Way {
    fn go(&mut self, angle: f64, least: f64) {
        let Some(&first) = self.turns.first() else {
            self.turns.push(angle);
            self.furthest = angle;
            return;
        };
        let beyond = (angle - self.furthest) * self.side;
        if self.side == 0.0 {
            if (angle - first).abs() >= least {
                self.side = (angle - first).signum();
                self.furthest = angle;
            }
        } else if beyond > 0.0 {
            self.furthest = angle;
        } else if -beyond >= least {
            self.turns.push(self.furthest);
            self.side = -self.side;
            self.furthest = angle;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn led(angles: &[f64]) -> Recording {
        let n = angles.len();
        Recording {
            time_s: (0..n).map(|i| i as f64 * 0.01).collect(),
            voltage_v: vec![0.0; n],
            angle_deg: angles.to_vec(),
            pressure1_bar: vec![2.0; n],
            pressure2_bar: vec![2.0; n],
            torque_nm: vec![f64::NAN; n],
            volume_ml: vec![f64::NAN; n],
            brake_open: vec![true; n],
            bypass_open: vec![true; n],
            segment: vec![0; n],
        }
    }

    fn degrees(way: Vec<f64>) -> Vec<f64> {
        way.into_iter().map(|a| (a.to_degrees() * 100.0).round() / 100.0).collect()
    }

    #[test]
    fn turns_are_kept_and_noise_is_not_one() {
        let noisy = |i: usize| if i.is_multiple_of(2) { 0.02 } else { -0.02 };
        let up = (0..300).map(|i| -40.0 + 0.05 * i as f64 + noisy(i));
        let down = (0..100).map(|i| -25.0 - 0.05 * i as f64 + noisy(i));
        let stand = (0..100).map(|i| -30.0 + noisy(i));
        let angles: Vec<f64> = up.chain(down).chain(stand).collect();
        let found = degrees(way_rad(&led(&angles), 450, 0.01, (-30f64).to_radians()));
        assert_eq!(found.len(), 3, "{found:?}");
        assert!((found[0] + 39.98).abs() < 0.03 && (found[1] + 25.0).abs() < 0.1 && found[2] == -30.0, "{found:?}");
    }

    #[test]
    fn a_lever_that_was_set_somewhere_else_has_no_way_to_there() {
        let mut angles = vec![-40.0; 50];
        angles.extend(vec![-30.0; 50]);
        assert_eq!(
            degrees(way_rad(&led(&angles), 50, 0.01, (-30f64).to_radians())),
            [-30.0, -30.0],
            "set at the clamped row"
        );
        assert_eq!(degrees(way_rad(&led(&angles), 70, 0.01, (-30f64).to_radians())), [-30.0, -30.0], "set before");
        let mut gappy = angles.clone();
        gappy[45..55].fill(f64::NAN);
        let found = degrees(way_rad(&led(&gappy), 70, 0.01, (-30f64).to_radians()));
        assert_eq!(found, [-30.0, -30.0], "ten degrees within a gap of a tenth of a second");
        assert_eq!(
            degrees(way_rad(&led(&angles), 0, 0.01, (-40f64).to_radians())),
            [-40.0, -40.0],
            "the run begins there"
        );
    }

    #[test]
    fn the_clamp_s_torque_is_asked_for_where_no_way_to_there_is_known() {
        use recordings::{Plane, Protocol};
        // 4 s at -40 degrees, led to -25 within 3 s, 4 s there, set to -10, 4 s there
        let led_up = (0..300).map(|i| -40.0 + 0.05 * f64::from(i));
        let angles: Vec<f64> = std::iter::repeat_n(-40.0, 400)
            .chain(led_up)
            .chain(std::iter::repeat_n(-25.0, 400))
            .chain(std::iter::repeat_n(-10.0, 400))
            .collect();
        let mut r = led(&angles);
        // nobody reads it while the lever moves
        let torque_nm = |(i, angle): (usize, &f64)| if (400..700).contains(&i) { f64::NAN } else { 0.1 * angle };
        r.torque_nm = angles.iter().enumerate().map(torque_nm).collect();
        r.segment =
            (0..angles.len()).map(|i| i64::from(i >= 400) + i64::from(i >= 700) + i64::from(i >= 1100)).collect();
        let cut = super::super::stretches(0, "t.csv", Protocol::TorqueMap, Plane::Horizontal, &r).unwrap();
        let held: Vec<Option<f64>> = cut.iter().map(|s| s.held.map(|held| held.torque_nm)).collect();
        assert_eq!(held.len(), 3, "{held:?}");
        let near = |held: Option<f64>, expected: f64| held.is_some_and(|nm| (nm - expected).abs() < 1e-6);
        assert!(near(held[0], -4.0) && held[1].is_none() && near(held[2], -1.0), "{held:?}");
    }
}
