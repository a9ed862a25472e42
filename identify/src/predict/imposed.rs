//! Inputs that stand in the state: the angle of a led lever, and pressures where they are measured. What is known of them is what their sensors show.

use model::integrate::{Seeds, Sensitivity};
use model::port::PortKind;
use model::rec::{self, state};
use model::scalar::{Scalar, Tangent};

use super::{DEGREES, Run};
use crate::prepare::Stretch;

/// Steps in which a true angle, or a pressure at rest, is looked for. The error of the first one is the slope of the sensor's error (a hundredth, say) times what it began
/// with, and of each further one about the product of the two before.
pub(super) const STEPS: usize = 8;
/// Error of it that does not matter, rad (and bar of the pressures).
pub(super) const CLOSE: f64 = 1e-9;
/// A sensor that shows less than this of a change is taken for one that shows this share,
const LEAST_SHOWN: f64 = 0.25;
/// and one that shows more than this for one that does;
const MOST_SHOWN: f64 = 4.0;
/// and a step goes no further (rad, bar): terms of the fifth order, say, bend far beyond what they were fitted to, and a fit must not be led out of all bounds
/// by that.
const FARTHEST: f64 = 1.0;

/// The way from what a sensor shows to what it sees, by secants.
#[derive(Clone, Copy, Default)]
pub(super) struct Secant {
    /// What it would have seen, and by how much too much it showed then.
    last: Option<(f64, f64)>,
}

impl Secant {
    /// What it may see instead of `at`, where it would show `off` too much.
    pub(super) fn next(&mut self, at: f64, off: f64) -> f64 {
        let shown = match self.last {
            Some((before, more)) if before != at => ((off - more) / (at - before)).clamp(LEAST_SHOWN, MOST_SHOWN),
            _ => 1.0,
        };
        self.last = Some((at, off));
        at - (off / shown).clamp(-FARTHEST, FARTHEST)
    }
}

impl Run<'_> {
    /// Puts the inputs of row `i` that stand in the state into it; `next`: the row to which the simulation goes on from there.
    pub(super) fn impose(&mut self, i: usize, next: Option<usize>) {
        if self.carried {
            // The oil feels every part of the way, so the angle is led from stop to stop and never put elsewhere: a sensor's memory of the next row is not known yet.
            let angle = if i == 0 { self.true_angle(0, 0) } else { self.x[state::ANGLE] };
            let velocity = next.map_or(0.0, |next| (self.true_angle(i, next) - angle) / self.length(i, next));
            (self.x[state::ANGLE], self.x[state::VELOCITY]) = (angle, velocity);
        } else if !self.stretch.angle_rad.is_empty() {
            self.x[state::ANGLE] = self.stretch.angle_rad[i];
        }
        if !self.stretch.pressure_bar[0].is_empty() {
            self.x[state::PRESSURE1] = self.stretch.pressure_bar[0][i];
            self.x[state::PRESSURE2] = self.stretch.pressure_bar[1][i];
            if self.effects.touches(PortKind::Sensor) {
                // one step alone: what a sensor shows that is slow goes with its past, whatever the pressure is now
                let seen = rec::shown(self.effects, self.stretch.time_s[i], &self.x, &mut self.scratch);
                for j in 0..2 {
                    let p = self.stretch.pressure_bar[j][i];
                    self.x[state::PRESSURE1 + j] = p - (seen[j + 1] - p);
                }
            }
        }
    }

    /// Angle at which the sensor, as it is at row `now`, shows what is known of row `i`, rad. Leaves the state's angle elsewhere.
    fn true_angle(&mut self, now: usize, i: usize) -> f64 {
        let shown_rad = self.stretch.angle_rad[i];
        for _ in 0..STEPS {
            self.x[state::ANGLE] = shown_rad - self.shift_rad;
            let seen = rec::shown(self.effects, self.stretch.time_s[now], &self.x, &mut self.scratch)[0] / DEGREES;
            self.shift_rad += seen - shown_rad;
            if (seen - shown_rad).abs() < CLOSE {
                break;
            }
        }
        shown_rad - self.shift_rad
    }

    /// Derivatives of the true angle where the sensor, as it is at row `now`, shows what it shows at `angle_rad`: nothing that is known moves.
    fn true_angle_slope(&self, seeds: &Seeds, s: &Sensitivity, now: usize, angle_rad: f64) -> Vec<f64> {
        let states = self.x.len();
        let mut out = vec![0.0; s.row(0).len()];
        let mut through = vec![0.0; states];
        seeds.each_pass(|_, effects, first, count| {
            let mut x: Vec<Tangent> = self.x.iter().enumerate().map(|(j, v)| Tangent::variable(*v, j)).collect();
            x[state::ANGLE] = Tangent::variable(angle_rad, state::ANGLE);
            let mut scratch = vec![Tangent::zero(); states];
            let seen = rec::shown(effects, self.stretch.time_s[now], &x, &mut scratch)[0];
            through.copy_from_slice(&seen.slope[..states]);
            out[first..first + count].copy_from_slice(&seen.slope[states..states + count]);
        });
        let by_angle = through[state::ANGLE];
        for (j, f) in through.iter().enumerate().filter(|(j, f)| *j != state::ANGLE && **f != 0.0) {
            out.iter_mut().zip(s.row(j)).for_each(|(o, v)| *o += f * v);
        }
        out.iter_mut().for_each(|o| *o /= -by_angle);
        out
    }
}

/// Derivatives of what [`Run::impose`] put into the state.
pub(super) fn impose_sensitivity(
    stretch: &Stretch,
    run: &Run,
    seeds: &Seeds,
    s: &mut Sensitivity,
    i: usize,
    next: Option<usize>,
) {
    if run.carried {
        let (angle, velocity) = (run.x[state::ANGLE], run.x[state::VELOCITY]);
        if i == 0 {
            let first = run.true_angle_slope(seeds, s, 0, angle);
            first.iter().enumerate().for_each(|(column, v)| s.set(state::ANGLE, column, *v));
        }
        if let Some(next) = next {
            let dt = run.length(i, next);
            let next = run.true_angle_slope(seeds, s, i, angle + velocity * dt);
            for (column, there) in next.iter().enumerate() {
                s.set(state::VELOCITY, column, (there - s.get(state::ANGLE, column)) / dt);
            }
        }
    }
    if stretch.pressure_bar[0].is_empty() {
        return;
    }
    seeds.each_pass(|_, effects, first, count| {
        let x: Vec<Tangent> = run.x.iter().map(|v| Tangent::constant(*v)).collect();
        let mut scratch = vec![Tangent::zero(); x.len()];
        let seen = rec::shown(effects, stretch.time_s[i], &x, &mut scratch);
        for c in 0..count {
            let lane = x.len() + c;
            s.set(state::PRESSURE1, first + c, -seen[1].slope[lane]);
            s.set(state::PRESSURE2, first + c, -seen[2].slope[lane]);
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_sensor_sees_follows_from_what_it_shows_also_where_it_is_bent() {
        let bent = |p: f64| p + 0.12 * (2.0 * p).sin() + 0.03 * (p - 2.5).powi(3);
        for truth in [0.8, 2.0, 3.3, 5.6] {
            let (mut at, mut way) = (bent(truth), Secant::default());
            for _ in 0..STEPS {
                at = way.next(at, bent(at) - bent(truth));
            }
            assert!((at - truth).abs() < CLOSE, "{at} for {truth}");
        }
    }

    #[test]
    fn a_sensor_that_shows_nothing_or_the_contrary_leads_out_of_no_bounds() {
        for shown in [|p: f64| p - 0.3 * p.powi(3), |_| 2.0] {
            let (mut at, mut way) = (4.0, Secant::default());
            for _ in 0..STEPS {
                at = way.next(at, shown(at) - 4.0);
            }
            assert!((at - 4.0).abs() <= STEPS as f64, "{at}");
        }
    }
}
