//! The number that the plant equations are written in: `f64` to simulate, [`Dual`] to carry derivatives along.
//!
//! Forward mode: a dual number holds a value and its partial derivatives along `N` directions. Comparisons and branches
//! look at the value alone, so a derivative is that of the branch taken.

use std::ops::{Add, AddAssign, Div, Mul, MulAssign, Neg, Sub, SubAssign};

use crate::effects::Effect;
use crate::port::Port;

/// Directions that a [`Tangent`] carries: states and parameters of one pass.
pub const LANES: usize = 32;

/// The dual number that the sensitivities use.
pub type Tangent = Dual<LANES>;

/// Arithmetic that the equations need.
pub trait Scalar:
    Copy
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
    + Neg<Output = Self>
    + Add<f64, Output = Self>
    + Sub<f64, Output = Self>
    + Mul<f64, Output = Self>
    + Div<f64, Output = Self>
    + AddAssign
    + SubAssign
    + MulAssign<f64>
    + 'static
{
    /// A constant.
    fn constant(value: f64) -> Self;
    /// The value without its derivatives.
    fn value(&self) -> f64;
    /// A smooth function of one variable, given its value and slope here.
    fn chain(self, value: f64, slope: f64) -> Self;
    /// Lets an effect act on a port: chooses the effect's entry point for this scalar.
    fn act(effect: &dyn Effect, k: &[Self], x: &[Self], dx: &mut [Self], port: &mut Port<'_, Self>);
    /// The effect's states at rest, likewise.
    fn rest(effect: &dyn Effect, k: &[Self], rest: &crate::port::Rest<Self>, x: &mut [Self]);

    /// e^x
    #[inline(always)]
    fn exp(self) -> Self {
        let e = self.value().exp();
        self.chain(e, e)
    }
    /// Natural logarithm; positive argument.
    #[inline(always)]
    fn ln(self) -> Self {
        self.chain(self.value().ln(), 1.0 / self.value())
    }
    /// Sine, radian.
    fn sin(self) -> Self {
        let (s, c) = self.value().sin_cos();
        self.chain(s, c)
    }
    /// Cosine, radian.
    fn cos(self) -> Self {
        let (s, c) = self.value().sin_cos();
        self.chain(c, -s)
    }
    /// Square root; positive argument.
    #[inline(always)]
    fn sqrt(self) -> Self {
        let r = self.value().sqrt();
        self.chain(r, 0.5 / r)
    }
    /// Hyperbolic tangent.
    fn tanh(self) -> Self {
        let t = self.value().tanh();
        self.chain(t, 1.0 - t * t)
    }
    /// |x|, slope +1 at 0.
    #[inline(always)]
    fn abs(self) -> Self {
        if self.value() < 0.0 { -self } else { self }
    }
    /// x^y for x > 0.
    #[inline(always)]
    fn powf(self, exponent: Self) -> Self {
        (self.ln() * exponent).exp()
    }
    /// max(x, floor), slope 0 at and below the floor.
    #[inline(always)]
    fn at_least(self, floor: f64) -> Self {
        if self.value() > floor { self } else { Self::constant(floor) }
    }
    /// 0.
    fn zero() -> Self {
        Self::constant(0.0)
    }
}

impl Scalar for f64 {
    #[inline(always)]
    fn constant(value: f64) -> f64 {
        value
    }
    #[inline(always)]
    fn value(&self) -> f64 {
        *self
    }
    #[inline(always)]
    fn chain(self, value: f64, _slope: f64) -> f64 {
        value
    }
    #[inline(always)]
    fn act(effect: &dyn Effect, k: &[f64], x: &[f64], dx: &mut [f64], port: &mut Port<'_, f64>) {
        effect.act_value(k, x, dx, port);
    }
    fn rest(effect: &dyn Effect, k: &[f64], rest: &crate::port::Rest<f64>, x: &mut [f64]) {
        effect.rest_value(k, rest, x);
    }
}

/// A value and its derivatives along `N` directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Dual<const N: usize> {
    /// The value.
    pub value: f64,
    /// Partial derivatives.
    pub slope: [f64; N],
}

impl<const N: usize> Dual<N> {
    /// The `lane`-th independent variable.
    pub fn variable(value: f64, lane: usize) -> Self {
        let mut slope = [0.0; N];
        slope[lane] = 1.0;
        Dual { value, slope }
    }

    #[inline(always)]
    fn combine(self, other: Self, value: f64, by_self: f64, by_other: f64) -> Self {
        let mut slope = self.slope;
        for (s, o) in slope.iter_mut().zip(&other.slope) {
            *s = *s * by_self + *o * by_other;
        }
        Dual { value, slope }
    }

    #[inline(always)]
    fn scaled(self, value: f64, by: f64) -> Self {
        let mut slope = self.slope;
        for s in &mut slope {
            *s *= by;
        }
        Dual { value, slope }
    }
}

impl Scalar for Tangent {
    #[inline(always)]
    fn constant(value: f64) -> Self {
        Dual { value, slope: [0.0; LANES] }
    }
    #[inline(always)]
    fn value(&self) -> f64 {
        self.value
    }
    #[inline(always)]
    fn chain(self, value: f64, slope: f64) -> Self {
        self.scaled(value, slope)
    }
    fn act(effect: &dyn Effect, k: &[Self], x: &[Self], dx: &mut [Self], port: &mut Port<'_, Self>) {
        effect.act_tangent(k, x, dx, port);
    }
    fn rest(effect: &dyn Effect, k: &[Self], rest: &crate::port::Rest<Self>, x: &mut [Self]) {
        effect.rest_tangent(k, rest, x);
    }
}

impl<const N: usize> Add for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: Self) -> Self {
        let mut slope = self.slope;
        for (s, b) in slope.iter_mut().zip(&o.slope) {
            *s += *b;
        }
        Dual { value: self.value + o.value, slope }
    }
}
impl<const N: usize> Sub for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: Self) -> Self {
        let mut slope = self.slope;
        for (s, b) in slope.iter_mut().zip(&o.slope) {
            *s -= *b;
        }
        Dual { value: self.value - o.value, slope }
    }
}
impl<const N: usize> Mul for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: Self) -> Self {
        self.combine(o, self.value * o.value, o.value, self.value)
    }
}
impl<const N: usize> Div for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, o: Self) -> Self {
        let quotient = self.value / o.value;
        self.combine(o, quotient, 1.0 / o.value, -quotient / o.value)
    }
}
impl<const N: usize> Neg for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.scaled(-self.value, -1.0)
    }
}
impl<const N: usize> Add<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn add(self, o: f64) -> Self {
        Dual { value: self.value + o, slope: self.slope }
    }
}
impl<const N: usize> Sub<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn sub(self, o: f64) -> Self {
        Dual { value: self.value - o, slope: self.slope }
    }
}
impl<const N: usize> Mul<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn mul(self, o: f64) -> Self {
        self.scaled(self.value * o, o)
    }
}
impl<const N: usize> Div<f64> for Dual<N> {
    type Output = Self;
    #[inline(always)]
    fn div(self, o: f64) -> Self {
        self.scaled(self.value / o, 1.0 / o)
    }
}
impl<const N: usize> AddAssign for Dual<N> {
    #[inline(always)]
    fn add_assign(&mut self, o: Self) {
        *self = *self + o;
    }
}
impl<const N: usize> SubAssign for Dual<N> {
    #[inline(always)]
    fn sub_assign(&mut self, o: Self) {
        *self = *self - o;
    }
}
impl<const N: usize> MulAssign<f64> for Dual<N> {
    #[inline(always)]
    fn mul_assign(&mut self, o: f64) {
        *self = *self * o;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn central(f: impl Fn(f64) -> f64, x: f64) -> f64 {
        (f(x + 1e-6) - f(x - 1e-6)) / 2e-6
    }

    #[test]
    fn every_function_has_the_slope_of_a_finite_difference() {
        fn all<S: Scalar>(x: S) -> Vec<S> {
            let y = x * x + 0.3;
            vec![
                x.exp(),
                y.ln(),
                x.sin(),
                x.cos(),
                y.sqrt(),
                x.tanh(),
                x.abs(),
                y.powf(x * -1.3),
                x / y,
                -x * 2.0 - y / 3.0,
                x.at_least(0.1),
            ]
        }
        for x in [-1.7, -0.2, 0.4, 2.1] {
            let dual = all(Tangent::variable(x, 3));
            for (i, d) in dual.iter().enumerate() {
                let expected = central(|x| all(x)[i], x);
                assert_eq!(d.value, all(x)[i]);
                assert!((d.slope[3] - expected).abs() < 1e-6 * (1.0 + expected.abs()), "function {i} at {x}");
                assert_eq!(d.slope[4], 0.0);
            }
        }
    }
}
