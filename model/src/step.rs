//! One inner step: classical Runge-Kutta, split where the branch of the piecewise equations changes.

use crate::effects::EffectSet;
use crate::near::Near;
use crate::parameters::index::A;
use crate::rec::{self, Input, state};

/// Halvings by which a kink is located within a step.
const HALVINGS: usize = 10;
/// A part ends this share of its step beyond the kink: the cubic is not the solution.
const BEYOND: f64 = 1.0 / 1024.0;

/// Share of the losses' threshold by which the velocity of a lever changes that rests.
const RESTS: f64 = 1e-3;

/// Share of the losses' threshold by which the velocity of a lever changes at most that slides on: what could die out within the step, and with it the step's
/// error, is a small part of that.
const GLIDES: f64 = 0.1;

/// A lever that creeps rests for `h` seconds: with this slope of the states its velocity stays as it is. It follows what drives it, and nothing dies out.
#[inline(always)]
pub(crate) fn rests(k: &[f64], effects: &EffectSet<f64>, slope: &[f64], h: f64) -> bool {
    effects.let_the_lever_rest() && slope[state::VELOCITY].abs() * h < RESTS * k[A]
}

/// States in a fixed number of lanes; those beyond the plant's states stay 0.
pub(crate) type Lanes<const N: usize> = [f64; N];

/// The plant under one input.
pub(crate) struct Plant<'a, const N: usize> {
    input: &'a Input,
    k: &'a [f64],
    effects: &'a EffectSet<f64>,
    states: usize,
    near: &'a mut Near,
}

/// A state and its derivative, on a branch of the piecewise equations.
#[derive(Clone, Copy)]
pub(crate) struct At<const N: usize> {
    pub t: f64,
    pub x: Lanes<N>,
    pub dx: Lanes<N>,
    pub branches: u32,
}

impl<'a, const N: usize> Plant<'a, N> {
    pub fn new(near: &'a mut Near, input: &'a Input, k: &'a [f64], effects: &'a EffectSet<f64>, states: usize) -> Self {
        Plant { near, input, k, effects, states }
    }

    /// These states, then zeros.
    pub fn lanes(x: &[f64]) -> Lanes<N> {
        let mut lanes = [0.0; N];
        lanes[..x.len()].copy_from_slice(x);
        lanes
    }

    /// The derivative, and the branches taken.
    #[inline(never)]
    pub fn derivative(&mut self, t: f64, x: &Lanes<N>, dx: &mut Lanes<N>) -> u32 {
        let (x, dx) = (&x[..self.states], &mut dx[..self.states]);
        let Plant { near, input, k, effects, .. } = self;
        if effects.leave_the_plant_alone() {
            rec::derivative_by::<f64, false>(*near, input, k, effects, t, x, dx).branches
        } else {
            rec::derivative_by::<f64, true>(*near, input, k, effects, t, x, dx).branches
        }
    }

    /// The lever creeps, and does not rest for the next `h` seconds.
    #[inline(always)]
    pub fn creeps(&self, now: &At<N>, h: f64) -> bool {
        rec::creeps(self.input, now.branches) && !rests(self.k, self.effects, &now.dx, h)
    }

    /// `x` at `t`, with its derivative.
    pub fn at(&mut self, t: f64, x: Lanes<N>) -> At<N> {
        let mut dx = [0.0; N];
        let branches = self.derivative(t, &x, &mut dx);
        At { t, x, dx, branches }
    }

    /// A classical Runge-Kutta step.
    #[inline(never)]
    pub fn step(&mut self, from: &At<N>, h: f64) -> At<N> {
        let At { t, x, dx: k1, .. } = from;
        let ahead = |by: f64, k: &Lanes<N>| -> Lanes<N> { std::array::from_fn(|i| x[i] + by * k[i]) };
        let [mut k2, mut k3, mut k4] = [[0.0; N]; 3];
        self.derivative(t + 0.5 * h, &ahead(0.5 * h, k1), &mut k2);
        self.derivative(t + 0.5 * h, &ahead(0.5 * h, &k2), &mut k3);
        self.derivative(t + h, &ahead(h, &k3), &mut k4);
        let mean: Lanes<N> = std::array::from_fn(|i| k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        self.at(t + h, ahead(h / 6.0, &mean))
    }

    /// The end of one step of `h` seconds, throughout which a lever faster than the losses' threshold slides on with nearly the same velocity.
    #[inline(always)]
    pub fn glide(&mut self, from: &At<N>, h: f64) -> Option<At<N>> {
        let most = GLIDES * self.k[A] / h;
        let steady = |at: &At<N>| at.dx[state::VELOCITY].abs() < most;
        if !(rec::slides(self.input, from.branches) && steady(from)) {
            return None;
        }
        let to = self.step(from, h);
        (to.branches == from.branches && steady(&to)).then_some(to)
    }

    /// A step of length `h`, or its first part where the branch changes within it: its length and its end, s.
    #[inline(always)]
    pub fn smooth_piece(&mut self, from: &At<N>, h: f64) -> (f64, At<N>) {
        let to = self.step(from, h);
        if to.branches == from.branches { (h, to) } else { self.beyond_kink(from, &to, h) }
    }

    /// The end of a part that leads to the kink on the way to `to`, which is `h` ahead, or just beyond it; and the part's length, s.
    #[inline(never)]
    fn beyond_kink(&mut self, from: &At<N>, to: &At<N>, h: f64) -> (f64, At<N>) {
        let near = (h * (self.cubic_crosses(from, to, h) + BEYOND)).min(h);
        let end = self.step(from, near);
        // a cubic from closer by does better
        if end.branches != from.branches || near > 0.125 * h {
            return (near, end);
        }
        // two kinks at once bend the solution away from any cubic
        let (mut before, mut beyond) = (near, (h, *to));
        for _ in 0..HALVINGS {
            let halfway = 0.5 * (before + beyond.0);
            let end = self.step(from, halfway);
            if end.branches == from.branches { before = halfway } else { beyond = (halfway, end) }
        }
        beyond
    }

    /// Share of the way from `from` to `to`, `h` ahead, behind which the cubic between them is on another branch.
    fn cubic_crosses(&mut self, from: &At<N>, to: &At<N>, h: f64) -> f64 {
        // what the cubic alone would cross is no kink
        let changed = from.branches ^ to.branches;
        let (mut before, mut beyond) = (0.0, 1.0);
        let mut scratch = [0.0; N];
        for _ in 0..HALVINGS {
            let halfway = 0.5 * (before + beyond);
            let x = between(from, to, h, halfway);
            let (x, dx) = (&x[..self.states], &mut scratch[..self.states]);
            let branches = rec::branches(self.input, self.k, self.effects, from.t + halfway * h, x, dx);
            if (branches ^ from.branches) & changed == 0 { before = halfway } else { beyond = halfway }
        }
        beyond
    }
}

/// The cubic through both ends with their slopes, `h` apart, at `share` of the way.
#[inline(always)]
pub(crate) fn between<const N: usize>(a: &At<N>, b: &At<N>, h: f64, share: f64) -> Lanes<N> {
    let (s, r) = (share, 1.0 - share);
    let (of_a, of_b) = (r * r * (1.0 + 2.0 * s), s * s * (1.0 + 2.0 * r));
    let (slope_a, slope_b) = (h * s * r * r, -h * s * s * r);
    std::array::from_fn(|i| of_a * a.x[i] + of_b * b.x[i] + slope_a * a.dx[i] + slope_b * b.dx[i])
}
