//! The transcendental functions of the plant, exactly or from a nearby point.
//!
//! Capacity and weight cost most of a derivative. The states of one integration step lie close together, so there both follow
//! from their value at one of them by a few terms of their series, to the last digits.

use crate::parameters::index::{A1, A2, H1, H2, H3};
use crate::rec::{self, DEGREES};
use crate::scalar::Scalar;

/// The functions of the state that are not rational.
pub(crate) trait Curves<S> {
    /// Capacities of both chambers, [`rec::capacity`].
    fn capacity(&mut self, k: &[S], angle_rad: S, pressure_bar: [S; 2]) -> [S; 2];
    /// Sine of the angle.
    fn sine(&mut self, angle_rad: S) -> S;
}

/// As the equations say, each time.
pub(crate) struct Exact;

impl<S: Scalar> Curves<S> for Exact {
    #[inline(always)]
    fn capacity(&mut self, k: &[S], angle_rad: S, pressure_bar: [S; 2]) -> [S; 2] {
        rec::capacity(k, angle_rad, pressure_bar)
    }
    #[inline(always)]
    fn sine(&mut self, angle_rad: S) -> S {
        angle_rad.sin()
    }
}

/// Largest relative change of a pressure that the series may bridge.
const PRESSURE_CHANGE: f64 = 1.0 / 128.0;
/// Largest change of an exponent or angle that the series may bridge.
const ANGLE_CHANGE: f64 = 1.0 / 512.0;
/// Terms of the binomial series behind 1: the next is below (1/128)^7 = 2e-15 of the power, times a factor of order 1.
const TERMS: usize = 6;

/// From the value at a base point, which moves along when a state is too far from it. For one set of parameters.
pub(crate) struct Near {
    walls: Option<Walls>,
    weight: Option<Weight>,
    /// Binomial coefficients of the exponent h2, from the first on.
    binomial: [f64; TERMS],
    per_rad: f64,
}

/// The capacity's factors at its base.
struct Walls {
    angle_rad: f64,
    pressure_bar: [f64; 2],
    /// 1/pressure
    per_bar: [f64; 2],
    /// h1 p^h2
    power: [f64; 2],
    /// exp(-a2 -+ a1 phi)
    bend: [f64; 2],
}

/// Sine and cosine at their base.
struct Weight {
    angle_rad: f64,
    sin: f64,
    cos: f64,
}

impl Near {
    /// For the plant's parameters `k`; the first state that is asked for becomes the base.
    #[inline(always)]
    pub fn new(k: &[f64]) -> Self {
        let h = k[H2];
        let mut binomial = [h; TERMS];
        for i in 1..TERMS {
            binomial[i] = binomial[i - 1] * (h - i as f64) * RECIPROCAL[i];
        }
        Near { walls: None, weight: None, binomial, per_rad: k[A1] * DEGREES }
    }
}

/// 1/(i + 1)
const RECIPROCAL: [f64; TERMS] = [1.0, 1.0 / 2.0, 1.0 / 3.0, 1.0 / 4.0, 1.0 / 5.0, 1.0 / 6.0];

impl Walls {
    #[inline(never)]
    fn at(k: &[f64], angle_rad: f64, pressure_bar: [f64; 2]) -> Self {
        let bend = (k[A1] * (angle_rad * DEGREES)).exp();
        let scale = if k[A2] == 0.0 { 1.0 } else { (-k[A2]).exp() };
        Walls {
            angle_rad,
            pressure_bar,
            per_bar: pressure_bar.map(|p| 1.0 / p),
            power: pressure_bar.map(|p| k[H1] * p.powf(k[H2])),
            bend: [scale / bend, scale * bend],
        }
    }
}

impl Curves<f64> for Near {
    #[inline(always)]
    fn capacity(&mut self, k: &[f64], angle_rad: f64, pressure_bar: [f64; 2]) -> [f64; 2] {
        if let Some(w) = &self.walls {
            let change = |i: usize| (pressure_bar[i] - w.pressure_bar[i]) * w.per_bar[i];
            let d = [change(0), change(1)];
            let y = self.per_rad * (angle_rad - w.angle_rad);
            // false for NaN too, which the exact functions hand on
            if d[0].abs() <= PRESSURE_CHANGE && d[1].abs() <= PRESSURE_CHANGE && y.abs() <= ANGLE_CHANGE {
                let b = &self.binomial;
                let y2 = y * y;
                let (odd, even) = (y + y * y2 * (1.0 / 6.0), 1.0 + y2 * (0.5 + y2 * (1.0 / 24.0)));
                let bend = [w.bend[0] * (even - odd), w.bend[1] * (even + odd)];
                let mut series = [b[TERMS - 1]; 2];
                for term in b[..TERMS - 1].iter().rev() {
                    series = [term + d[0] * series[0], term + d[1] * series[1]];
                }
                let power = |i: usize| w.power[i] + w.power[i] * (d[i] * series[i]);
                return [bend[0] * (power(0) + k[H3]), bend[1] * (power(1) + k[H3])];
            }
        }
        let w = self.walls.insert(Walls::at(k, angle_rad, pressure_bar));
        [w.bend[0] * (w.power[0] + k[H3]), w.bend[1] * (w.power[1] + k[H3])]
    }

    #[inline(always)]
    fn sine(&mut self, angle_rad: f64) -> f64 {
        if let Some(Weight { angle_rad: base, sin, cos }) = self.weight {
            let y = angle_rad - base;
            if y.abs() <= ANGLE_CHANGE {
                let y2 = y * y;
                return sin * (1.0 - y2 * (0.5 - y2 * (1.0 / 24.0))) + cos * (y - y * y2 * (1.0 / 6.0));
            }
        }
        let (sin, cos) = angle_rad.sin_cos();
        self.weight = Some(Weight { angle_rad, sin, cos });
        sin
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameters::Parameters;
    use rand::{Rng, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    #[test]
    fn what_follows_from_a_nearby_point_is_the_function_to_the_last_digits() {
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut bridged = 0;
        for _ in 0..2000 {
            let mut k = Parameters::example().to_vector();
            k[H2] = rng.random_range(-3.0..1.0);
            k[A1] = rng.random_range(-0.02..0.02);
            k[A2] = rng.random_range(-0.1..0.1);
            let mut near = Near::new(&k);
            let (mut angle, mut pressure) = (rng.random_range(-0.7..0.7), [3.0, rng.random_range(0.2..6.0)]);
            for _ in 0..20 {
                let (exact, got) = (rec::capacity(&k, angle, pressure), near.capacity(&k, angle, pressure));
                for i in 0..2 {
                    assert!((got[i] / exact[i] - 1.0).abs() < 1e-13, "{} for {}", got[i], exact[i]);
                }
                assert!((near.sine(angle) - angle.sin()).abs() < 1e-15);
                let before = near.walls.as_ref().map(|w| w.angle_rad);
                angle += rng.random_range(-0.5..0.5) * ANGLE_CHANGE;
                pressure = pressure.map(|p| p * (1.0 + rng.random_range(-0.5..0.5) * PRESSURE_CHANGE));
                near.capacity(&k, angle, pressure);
                bridged += u32::from(near.walls.as_ref().map(|w| w.angle_rad) == before);
            }
        }
        assert!((20_000..40_000).contains(&bridged), "the base moves along at times, not always: {bridged}");
    }

    #[test]
    fn a_pressure_that_is_none_gives_no_capacity() {
        let k = Parameters::example().to_vector();
        for pressure in [f64::NAN, -1.0] {
            let mut near = Near::new(&k);
            near.capacity(&k, 0.1, [2.0, 2.0]);
            let got = near.capacity(&k, 0.1, [pressure, 2.0]);
            assert!(got[0].is_nan() && rec::capacity(&k, 0.1, [pressure, 2.0])[0].is_nan());
            assert!(got[1].is_finite());
            assert!(near.capacity(&k, 0.1, [2.0, 2.0])[0].is_finite(), "one bad state spoils the next");
        }
    }
}
