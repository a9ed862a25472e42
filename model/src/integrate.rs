//! Fixed-step integration with kinks located, and the sensitivities beside it.
//!
//! The equations are piecewise smooth: losses at |w| = a, the pump's dead zone, |dp| in the torque. A Runge-Kutta step over
//! such a kink would lose its order, so a step that ends on another branch is split where the branch changes.

use crate::effects::EffectSet;
use crate::rec::{self, Derived, Input, STATES, state};
use crate::scalar::{LANES, Scalar, Tangent};

/// Most states that plant and effects may have together.
pub const MOST_STATES: usize = 16;

/// What an integration could not do.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SimulationError {
    /// A pressure fell to zero, where the model ends.
    #[error(
        "at {time_s:.3} s: pressure {chamber} fell to {pressure_bar:.3} bar absolute; the model holds for positive pressures only (fill the chambers more, or drive less)"
    )]
    Pressure {
        /// Since the run's start, s.
        time_s: f64,
        /// 1 or 2.
        chamber: u8,
        /// bar absolute
        pressure_bar: f64,
    },
    /// A state is not finite.
    #[error(
        "at {time_s:.3} s: the state is not finite any more: the parameters are outside of what the model can represent"
    )]
    NotFinite {
        /// Since the run's start, s.
        time_s: f64,
    },
}

/// Integrates the plant for values.
pub struct Integrator {
    /// Longest inner step, s.
    longest_s: f64,
}

type Buffer = [f64; MOST_STATES];

struct Plant<'a> {
    k: &'a [f64],
    effects: &'a EffectSet<f64>,
    states: usize,
}

impl Plant<'_> {
    #[inline(always)]
    fn derivative(&self, input: &Input, t: f64, x: &Buffer, dx: &mut Buffer) -> Derived<f64> {
        rec::derivative(input, self.k, self.effects, t, &x[..self.states], &mut dx[..self.states])
    }

    /// A classical Runge-Kutta step; `k1` is the derivative at its start.
    #[inline(always)]
    fn step(&self, input: &Input, t: f64, h: f64, x: &Buffer, k1: &Buffer, out: &mut Buffer) {
        let n = self.states;
        let (mut k2, mut k3, mut k4, mut y) = ([0.0; MOST_STATES], [0.0; MOST_STATES], [0.0; MOST_STATES], *x);
        for i in 0..n {
            y[i] = x[i] + 0.5 * h * k1[i];
        }
        self.derivative(input, t + 0.5 * h, &y, &mut k2);
        for i in 0..n {
            y[i] = x[i] + 0.5 * h * k2[i];
        }
        self.derivative(input, t + 0.5 * h, &y, &mut k3);
        for i in 0..n {
            y[i] = x[i] + h * k3[i];
        }
        self.derivative(input, t + h, &y, &mut k4);
        for i in 0..n {
            out[i] = x[i] + h / 6.0 * (k1[i] + 2.0 * (k2[i] + k3[i]) + k4[i]);
        }
    }
}

/// Most splits of one inner step at kinks; beyond, the step is taken as it is.
const MOST_SPLITS: usize = 6;
/// Halvings by which a kink is located within a step.
const HALVINGS: usize = 16;

impl Integrator {
    /// Inner steps of at most `longest_s` seconds.
    pub fn new(longest_s: f64) -> Self {
        Integrator { longest_s }
    }

    /// Inner steps of at most `longest_s`, fewer where the plant near `x` is stiffer than such a step can follow:
    /// near zero velocity the losses have a time constant of 1..2 ms, and effects may add to that.
    pub fn for_plant(longest_s: f64, k: &[f64], effects: &EffectSet<f64>, input: &Input, x: &[f64]) -> Self {
        let plant = Plant { k, effects, states: x.len() };
        let mut at = [0.0; MOST_STATES];
        at[..x.len()].copy_from_slice(x);
        at[state::VELOCITY] = 0.0;
        let mut base = [0.0; MOST_STATES];
        plant.derivative(input, 0.0, &at, &mut base);
        let mut rate: f64 = 0.0;
        for i in 0..x.len() {
            let mut moved = at;
            let step = 1e-5 * (1.0 + at[i].abs());
            moved[i] += step;
            let mut slope = [0.0; MOST_STATES];
            plant.derivative(input, 0.0, &moved, &mut slope);
            rate = rate.max(-(slope[i] - base[i]) / step);
        }
        // a Runge-Kutta step is stable up to 2.8 time constants and accurate to 1e-3 of a decay at 1
        let h = if rate > 0.0 { longest_s.min(1.0 / rate) } else { longest_s };
        Integrator { longest_s: h.max(longest_s / 10.0) }
    }

    /// Length of the longest inner step, s.
    pub fn longest_s(&self) -> f64 {
        self.longest_s
    }

    /// Advances `x` from `t` by `dt` (s) under a constant input.
    pub fn advance(
        &self,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
    ) -> Result<(), SimulationError> {
        self.advance_by_pieces(input, k, effects, t, dt, x, |_, _, _| ())
    }

    /// As [`Self::advance`], and says `piece(middle's time, length, state in the middle)` (s) for each smooth piece, from
    /// kink to kink: what [`Sensitivity::advance`] needs.
    #[inline(always)]
    #[allow(clippy::too_many_arguments, reason = "the arguments of advance and a visitor")]
    pub fn advance_by_pieces(
        &self,
        input: &Input,
        k: &[f64],
        effects: &EffectSet<f64>,
        t: f64,
        dt: f64,
        x: &mut [f64],
        mut piece: impl FnMut(f64, f64, &[f64]),
    ) -> Result<(), SimulationError> {
        let plant = Plant { k, effects, states: x.len() };
        let steps = (dt / self.longest_s - 1e-9).ceil().max(1.0);
        let h = dt / steps;
        let mut now = [0.0; MOST_STATES];
        now[..x.len()].copy_from_slice(x);
        let (mut next, mut k1, mut k_next) = ([0.0; MOST_STATES], [0.0; MOST_STATES], [0.0; MOST_STATES]);
        let mut branches = plant.derivative(input, t, &now, &mut k1).branches;
        let states = x.len();
        // cubic through both ends with their slopes; k_next of a piece's end may be beyond a kink by a hair
        let middle = |a: &Buffer, ka: &Buffer, b: &Buffer, kb: &Buffer, h: f64| -> Buffer {
            std::array::from_fn(|i| 0.5 * (a[i] + b[i]) + 0.125 * h * (ka[i] - kb[i]))
        };
        for i in 0..steps as usize {
            let mut at = t + i as f64 * h;
            let mut left = h;
            for split in 0.. {
                plant.step(input, at, left, &now, &k1, &mut next);
                let arrived = plant.derivative(input, at + left, &next, &mut k_next).branches;
                if arrived == branches || split == MOST_SPLITS {
                    piece(at + 0.5 * left, left, &middle(&now, &k1, &next, &k_next, left)[..states]);
                    now = next;
                    k1 = k_next;
                    branches = arrived;
                    break;
                }
                // the first part ends just beyond the kink
                let (mut before, mut beyond) = (0.0, left);
                for _ in 0..HALVINGS {
                    let halfway = 0.5 * (before + beyond);
                    plant.step(input, at, halfway, &now, &k1, &mut next);
                    if plant.derivative(input, at + halfway, &next, &mut k_next).branches == branches {
                        before = halfway;
                    } else {
                        beyond = halfway;
                    }
                }
                plant.step(input, at, beyond, &now, &k1, &mut next);
                branches = plant.derivative(input, at + beyond, &next, &mut k_next).branches;
                piece(at + 0.5 * beyond, beyond, &middle(&now, &k1, &next, &k_next, beyond)[..states]);
                now = next;
                k1 = k_next;
                at += beyond;
                left -= beyond;
                if left < 1e-9 * h {
                    break;
                }
            }
        }
        x.copy_from_slice(&now[..x.len()]);
        check(t + dt, x)
    }
}

/// The state is one that the model can stand in.
fn check(time_s: f64, x: &[f64]) -> Result<(), SimulationError> {
    if x.iter().any(|v| !v.is_finite()) {
        return Err(SimulationError::NotFinite { time_s });
    }
    for (chamber, i) in [(1, state::PRESSURE1), (2, state::PRESSURE2)] {
        if x[i] <= LEAST_PRESSURE_BAR {
            return Err(SimulationError::Pressure { time_s, chamber, pressure_bar: x[i] });
        }
    }
    Ok(())
}

/// Below this absolute pressure (bar) oil cavitates and eq. (13) means nothing.
pub const LEAST_PRESSURE_BAR: f64 = 0.02;

/// Derivatives of the states with respect to chosen parameters, carried along a simulated trajectory.
///
/// The variational equation S' = A S + B is taken once a step at its middle, with A and B from dual numbers, and advanced by
/// its exponential: second order in the step, stable where the plant is.
pub struct Sensitivity {
    states: usize,
    columns: usize,
    /// `states` rows of `columns` each.
    s: Vec<f64>,
    rate: Vec<f64>,
}

impl Sensitivity {
    /// Starts at zero: `columns` columns, the first of which belong to the seeded parameters of [`Seeds`].
    pub fn new(states: usize, columns: usize) -> Self {
        Sensitivity { states, columns, s: vec![0.0; states * columns], rate: vec![0.0; states * columns] }
    }

    /// d x_state / d column.
    pub fn get(&self, state: usize, column: usize) -> f64 {
        self.s[state * self.columns + column]
    }

    /// Sets d x_state / d column.
    pub fn set(&mut self, state: usize, column: usize, value: f64) {
        self.s[state * self.columns + column] = value;
    }

    /// One state's row.
    pub fn row(&self, state: usize) -> &[f64] {
        &self.s[state * self.columns..(state + 1) * self.columns]
    }

    /// Advances over `dt` (s), given the state in the step's middle and time `t` there.
    pub fn advance(&mut self, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
        let (n, m) = (self.states, self.columns);
        let mut a = [[0.0; MOST_STATES]; MOST_STATES];
        let mut x = [Tangent::constant(0.0); MOST_STATES];
        let mut dx = x;
        for (pass, pack) in seeds.packs.iter().enumerate() {
            for i in 0..n {
                x[i] = Tangent::variable(middle[i], i);
            }
            rec::derivative(input, &pack.k, &pack.effects, t, &x[..n], &mut dx[..n]);
            for i in 0..n {
                if pass == 0 {
                    a[i][..n].copy_from_slice(&dx[i].slope[..n]);
                }
                let row = &mut self.rate[i * m + pack.first..];
                row[..pack.count].copy_from_slice(&dx[i].slope[n..n + pack.count]);
            }
        }
        let seeded = seeds.columns();
        // rate = B + A S; columns beyond the seeded ones (initial states) have no B
        for i in 0..n {
            let row = &mut self.rate[i * m..(i + 1) * m];
            row[seeded..].fill(0.0);
            for j in 0..n {
                if a[i][j] != 0.0 {
                    for (r, s) in row.iter_mut().zip(&self.s[j * m..(j + 1) * m]) {
                        *r += a[i][j] * s;
                    }
                }
            }
        }
        // S += phi rate, phi = dt (1 + A dt/2 + (A dt)^2/6 + ...)
        let phi = exponential_integral(&a, n, dt);
        for i in 0..n {
            for j in 0..n {
                if phi[i][j] != 0.0 {
                    let row = &mut self.s[i * m..(i + 1) * m];
                    for (s, r) in row.iter_mut().zip(&self.rate[j * m..(j + 1) * m]) {
                        *s += phi[i][j] * r;
                    }
                }
            }
        }
    }
}

/// Integral of exp(A t) over 0..dt by its series; the steps are short enough (|A| dt of order 1) for eight terms.
fn exponential_integral(a: &[[f64; MOST_STATES]; MOST_STATES], n: usize, dt: f64) -> [[f64; MOST_STATES]; MOST_STATES] {
    let mut sum = [[0.0; MOST_STATES]; MOST_STATES];
    let mut term = [[0.0; MOST_STATES]; MOST_STATES];
    for i in 0..n {
        term[i][i] = dt;
        sum[i][i] = dt;
    }
    for order in 2..=8 {
        let mut next = [[0.0; MOST_STATES]; MOST_STATES];
        let mut largest: f64 = 0.0;
        for i in 0..n {
            for l in 0..n {
                let f = a[i][l] * dt / order as f64;
                if f != 0.0 {
                    for j in 0..n {
                        next[i][j] += f * term[l][j];
                    }
                }
            }
            for j in 0..n {
                sum[i][j] += next[i][j];
                largest = largest.max(next[i][j].abs());
            }
        }
        if largest < 1e-7 * dt {
            break;
        }
        term = next;
    }
    sum
}

/// Parameters as dual numbers, packed so that states and parameters of one pass fit into the lanes.
pub struct Seeds {
    packs: Vec<Pack>,
}

struct Pack {
    first: usize,
    count: usize,
    k: Vec<Tangent>,
    effects: EffectSet<Tangent>,
}

impl Seeds {
    /// `build(lanes)` gives plant parameters and effects as dual numbers, where `lanes(c)` is the lane of column `c` in this
    /// pass or `None`; `columns` columns in all. `states`: of plant and effects.
    pub fn new(
        states: usize,
        columns: usize,
        build: impl Fn(&dyn Fn(usize) -> Option<usize>) -> (Vec<Tangent>, EffectSet<Tangent>),
    ) -> Self {
        let room = LANES - states;
        let mut packs = Vec::new();
        let mut first = 0;
        loop {
            let count = room.min(columns - first);
            let (k, effects) =
                build(&|column| (first..first + count).contains(&column).then(|| states + column - first));
            packs.push(Pack { first, count, k, effects });
            first += count;
            if first >= columns {
                return Seeds { packs };
            }
        }
    }

    /// Number of seeded columns.
    pub fn columns(&self) -> usize {
        self.packs.iter().map(|p| p.count).sum()
    }

    /// Evaluates a function of the state with derivatives, pass by pass: `f(k, effects, first_column, count)`.
    pub fn each_pass(&self, mut f: impl FnMut(&[Tangent], &EffectSet<Tangent>, usize, usize)) {
        for p in &self.packs {
            f(&p.k, &p.effects, p.first, p.count);
        }
    }
}

/// Number of states of the plant with these effects.
pub fn states_with<S: Scalar>(effects: &EffectSet<S>) -> usize {
    STATES + effects.states
}
