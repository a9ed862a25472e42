//! A plant that is written as equations alone: derivative and outputs, generic over the number. Simulation (Runge-Kutta of fourth
//! order, fixed step) and derivatives (the same with dual numbers) come from here, so that a plant is one file.

use std::cell::RefCell;

use model::effects::EffectSet;
use model::integrate::{MOST_STATES, SimulationError, have_room};
use model::port::{Arrival, HydraulicPort, MechanicalPort, Port, PortKind, Rest};
use model::scalar::{LANES, Scalar, Tangent};

use crate::layout::Layout;
use crate::plant::{Number, Plant, PlantHeader};
use crate::predict::Linear;
use crate::prepare::Stretch;

/// What an input does between two rows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Between {
    /// It keeps the earlier row's value: a command that a converter holds.
    Held,
    /// Straight line.
    Straight,
    /// Band-limited: what was sampled had nothing beyond two thirds of half the sampling rate. Rows are equally spaced.
    Smooth,
}

/// A plant's equations.
pub trait Equations: Sync + 'static {
    /// What is known of the plant.
    fn header(&self) -> &'static PlantHeader;

    /// See [`Plant::cluster_s`], s: several times what the residual remembers.
    fn cluster_s(&self) -> f64;

    /// Longest inner step, s: a tenth of the fastest time constant, or of a radian of the fastest oscillation, is accurate to
    /// some 1e-6.
    fn step_s(&self) -> f64;

    /// What the inputs do between rows.
    fn between(&self) -> Between;

    /// Derivatives of the plant's states into `dx` (zero on entry; the effects' own states, behind, are set by the ports).
    fn derivative<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S]);

    /// Outputs into `y`, in the order of the header's channels. `dx` is scratch, for ports.
    fn outputs<S: Scalar>(&self, at: &Instant<S>, dx: &mut [S], y: &mut [S]);

    /// The plant in its initial state, from which effects set their own states. By default a body at rest at position 0, free of
    /// force and pressure.
    fn rest<S: Scalar>(&self, _at: &Instant<S>) -> Rest<'static, S> {
        Rest {
            arrival: Arrival::Free,
            ran: &[],
            angle_rad: S::zero(),
            pressure_bar: [S::constant(model::port::AMBIENT_BAR); 2],
            actuator_torque_nm: S::zero(),
            torque_nm: S::zero(),
            voltage_v: 0.0,
            brake_open: true,
            bypass_open: false,
        }
    }
}

/// What a plant's equations are evaluated at.
pub struct Instant<'a, S> {
    /// Since the run's start, s.
    pub time_s: f64,
    /// Inputs, in the order of the header.
    pub u: &'a [f64],
    /// Base parameters, in the order of the header.
    pub k: &'a [S],
    /// The plant's states, then those of the effects.
    pub x: &'a [S],
    /// What the plant carries.
    pub effects: &'a EffectSet<S>,
}

impl<S: Scalar> Instant<'_, S> {
    /// Force (or torque) that the effects at the mechanical port add in the direction of motion.
    pub fn mechanical(&self, dx: &mut [S], position: S, velocity: S) -> S {
        let mut port = MechanicalPort::at(self.time_s, position, velocity);
        if self.effects.touches(PortKind::Mechanical) {
            self.effects.act(self.x, dx, Port::Mechanical(&mut port));
        }
        port.torque_nm
    }

    /// Lets the effects at the hydraulic port act on two vessels.
    pub fn hydraulic(&self, dx: &mut [S], port: &mut HydraulicPort<S>) {
        if self.effects.touches(PortKind::Hydraulic) {
            self.effects.act(self.x, dx, Port::Hydraulic(port));
        }
    }
}

/// Samples to both sides that a band-limited value takes part of.
const SINC_HALF: usize = 8;
/// Shape of the Kaiser window: 80 dB between two thirds of half the sampling rate and its image.
const KAISER: f64 = 8.0;

/// Weights of the band-limited interpolation, by share of the way between two rows, as far as they were asked for.
#[derive(Default)]
struct Kernels {
    known: RefCell<Vec<(f64, [f64; 2 * SINC_HALF])>>,
}

impl Kernels {
    /// Value of a column at row `i` plus a share of the way to the next. Beyond its ends a column goes on mirrored through them.
    fn between(&self, column: &[f64], i: usize, share: f64) -> f64 {
        if share == 0.0 {
            return column[i];
        }
        let last = column.len() - 1;
        let mut known = self.known.borrow_mut();
        let position = known.iter().position(|(of, _)| (of - share).abs() < 1e-9).unwrap_or_else(|| {
            known.push((share, sinc_weights(share)));
            known.len() - 1
        });
        let weights = &known[position].1;
        if i + 1 >= SINC_HALF && i + SINC_HALF <= last {
            return weights.iter().zip(&column[i + 1 - SINC_HALF..]).map(|(w, v)| w * v).sum();
        }
        let at = |n: isize| -> f64 {
            let beyond = n - last as isize;
            if n < 0 {
                2.0 * column[0] - column[n.unsigned_abs().min(last)]
            } else if beyond > 0 {
                2.0 * column[last] - column[last.saturating_sub(beyond.unsigned_abs())]
            } else {
                column[n.unsigned_abs()]
            }
        };
        let first = i as isize + 1 - SINC_HALF as isize;
        weights.iter().enumerate().map(|(j, w)| w * at(first + j as isize)).sum()
    }
}

/// Weights of the rows around, from `SINC_HALF - 1` before to `SINC_HALF` behind: sinc under a Kaiser window, their sum 1.
fn sinc_weights(share: f64) -> [f64; 2 * SINC_HALF] {
    // modified Bessel function of the first kind, order 0, by its series
    let bessel = |x: f64| {
        let (mut sum, mut term) = (1.0, 1.0);
        for n in 1..40 {
            term *= (x / (2.0 * f64::from(n))).powi(2);
            sum += term;
        }
        sum
    };
    let mut out = [0.0; 2 * SINC_HALF];
    for (j, w) in out.iter_mut().enumerate() {
        let distance = j as f64 - (SINC_HALF - 1) as f64 - share;
        let inside = 1.0 - (distance / SINC_HALF as f64).powi(2);
        let x = std::f64::consts::PI * distance;
        let sinc = if x.abs() < 1e-9 { 1.0 } else { x.sin() / x };
        *w = sinc * bessel(KAISER * inside.max(0.0).sqrt()) / bessel(KAISER);
    }
    let sum: f64 = out.iter().sum();
    out.map(|w| w / sum)
}

/// A stretch with a model.
struct Run<'a, S, E> {
    plant: &'a E,
    stretch: &'a Stretch,
    k: Vec<S>,
    effects: EffectSet<S>,
    /// Number of states of plant and effects.
    states: usize,
    kernels: Kernels,
}

impl<'a, S: Number, E: Equations> Run<'a, S, E> {
    fn new(plant: &'a E, stretch: &'a Stretch, layout: &Layout, theta: &[S]) -> Result<Self, SimulationError> {
        let (k, effects) = layout.expand(theta);
        let states = plant.header().states.len() + effects.states;
        have_room(states)?;
        Ok(Run { plant, stretch, k, effects, states, kernels: Kernels::default() })
    }

    /// Inputs at row `i` plus a share of the way to the next.
    fn inputs(&self, i: usize, share: f64, out: &mut Vec<f64>) {
        out.clear();
        let last = self.stretch.rows() - 1;
        out.extend(self.stretch.inputs.iter().map(|c| {
            let of = |n: usize| c[n.min(last)];
            match self.plant.between() {
                Between::Held => of(i),
                Between::Straight => of(i) + share * (of(i + 1) - of(i)),
                Between::Smooth => self.kernels.between(c, i, share),
            }
        }));
    }

    fn derivative(&self, time_s: f64, u: &[f64], x: &[S]) -> [S; MOST_STATES] {
        let mut dx = [S::zero(); MOST_STATES];
        let at = Instant { time_s, u, k: &self.k, x, effects: &self.effects };
        self.plant.derivative(&at, &mut dx[..self.states]);
        dx
    }

    /// The initial state.
    fn start(&self, initial: &[S], u: &mut Vec<f64>) -> [S; MOST_STATES] {
        let own = self.plant.header().states.len();
        let mut x = [S::zero(); MOST_STATES];
        for (j, (x, v)) in x[..own].iter_mut().zip(&self.stretch.initial).enumerate() {
            *x = initial[j] + *v;
        }
        if self.effects.states > 0 {
            self.inputs(0, 0.0, u);
            let at = Instant { time_s: self.stretch.time_s[0], u, k: &self.k, x: &x, effects: &self.effects };
            let rest = self.plant.rest(&at);
            self.effects.rest(&rest, &mut x[own..self.states]);
        }
        x
    }

    /// Advances from row `i` to the next.
    fn advance(&self, i: usize, x: &mut [S; MOST_STATES], u: &mut Vec<f64>) {
        let n = self.states;
        if n == 0 {
            return;
        }
        let (t, dt) = (self.stretch.time_s[i], self.stretch.time_s[i + 1] - self.stretch.time_s[i]);
        let steps = (dt / self.plant.step_s() - 1e-9).ceil().max(1.0) as usize;
        let h = dt / steps as f64;
        let moved = |x: &[S; MOST_STATES], d: &[S; MOST_STATES], by: f64| {
            let mut out = *x;
            for (o, d) in out[..n].iter_mut().zip(d) {
                *o += *d * by;
            }
            out
        };
        for step in 0..steps {
            let share = |of_step: f64| (step as f64 + of_step) / steps as f64;
            let time = |of_step: f64| t + (step as f64 + of_step) * h;
            self.inputs(i, share(0.0), u);
            let d1 = self.derivative(time(0.0), u, &x[..n]);
            self.inputs(i, share(0.5), u);
            let d2 = self.derivative(time(0.5), u, &moved(x, &d1, 0.5 * h)[..n]);
            let d3 = self.derivative(time(0.5), u, &moved(x, &d2, 0.5 * h)[..n]);
            self.inputs(i, share(1.0), u);
            let d4 = self.derivative(time(1.0), u, &moved(x, &d3, h)[..n]);
            for j in 0..n {
                x[j] += (d1[j] + d2[j] * 2.0 + d3[j] * 2.0 + d4[j]) * (h / 6.0);
            }
        }
    }

    /// Outputs row by row, in order.
    fn each_row(&self, initial: &[S], mut row: impl FnMut(usize, &[S])) -> Result<(), SimulationError> {
        let mut u = Vec::new();
        let mut x = self.start(initial, &mut u);
        let mut y = vec![S::zero(); self.plant.header().channels.len()];
        for i in 0..self.stretch.rows() {
            let time_s = self.stretch.time_s[i];
            self.inputs(i, 0.0, &mut u);
            let mut scratch = [S::zero(); MOST_STATES];
            let at = Instant { time_s, u: &u, k: &self.k, x: &x[..self.states], effects: &self.effects };
            self.plant.outputs(&at, &mut scratch[..self.states], &mut y);
            if !y.iter().chain(&x[..self.states]).all(|v| v.value().is_finite()) {
                return Err(SimulationError::NotFinite { time_s });
            }
            row(i, &y);
            if i + 1 < self.stretch.rows() {
                self.advance(i, &mut x, &mut u);
            }
        }
        Ok(())
    }

    /// Means over the blocks of the stretch, of the rows where a channel was measured: one a target.
    fn targets(&self, initial: &[S]) -> Result<Vec<S>, SimulationError> {
        let s = self.stretch;
        let mut out = Vec::with_capacity(s.targets.len());
        let mut sums = vec![(S::zero(), 0usize); self.plant.header().channels.len()];
        let mut block = 0;
        self.each_row(initial, |i, y| {
            for ((sum, y), measured) in sums.iter_mut().zip(y).zip(&s.measured) {
                if measured.get(i).is_some_and(|m| m.is_finite()) {
                    sum.0 += *y;
                    sum.1 += 1;
                }
            }
            if i + 1 == s.blocks[block + 1] {
                block += 1;
                for sum in &mut sums {
                    if sum.1 > 0 {
                        out.push(sum.0 / sum.1 as f64);
                    }
                    *sum = (S::zero(), 0);
                }
            }
        })?;
        Ok(out)
    }
}

impl<E: Equations> Plant for E {
    fn header(&self) -> &'static PlantHeader {
        Equations::header(self)
    }

    fn cluster_s(&self, _stretch: &Stretch) -> Option<f64> {
        Some(Equations::cluster_s(self))
    }

    fn predict(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<f64>, SimulationError> {
        Run::new(self, stretch, layout, theta)?.targets(initial)
    }

    fn linearise(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Linear, SimulationError> {
        let columns = theta.len() + initial.len();
        let mut predicted = vec![0.0; stretch.targets.len()];
        let mut slope = vec![0.0; stretch.targets.len() * columns];
        for first in (0..columns.max(1)).step_by(LANES) {
            let count = LANES.min(columns - first);
            let seeded = |(column, value): (usize, &f64)| {
                if (first..first + count).contains(&column) {
                    Tangent::variable(*value, column - first)
                } else {
                    Tangent::constant(*value)
                }
            };
            let all: Vec<Tangent> = theta.iter().chain(initial).enumerate().map(seeded).collect();
            let (theta, initial) = all.split_at(theta.len());
            let targets = Run::new(self, stretch, layout, theta)?.targets(initial)?;
            for (n, y) in targets.iter().enumerate() {
                predicted[n] = y.value;
                slope[n * columns + first..n * columns + first + count].copy_from_slice(&y.slope[..count]);
            }
        }
        Ok(Linear { predicted, slope })
    }

    fn rows(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<Vec<f64>>, SimulationError> {
        let mut out = Vec::with_capacity(stretch.rows());
        Run::new(self, stretch, layout, theta)?.each_row(initial, |_, y| out.push(y.to_vec()))?;
        Ok(out)
    }
}
