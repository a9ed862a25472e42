//! Sensitivities beside an integration.

use multiversion::multiversion;

use crate::effects::EffectSet;
use crate::integrate::{FEW_STATES, MOST_STATES};
use crate::near::Exact;
use crate::port::PortKind;
use crate::rec::{self, Input};
use crate::scalar::{Scalar, Tangent};
use crate::seeds::Seeds;
use crate::step::rests;

/// Derivatives of the states with respect to chosen parameters, carried along a simulated trajectory.
///
/// The variational equation S' = A S + B is taken at the middle of a step, with A and B from dual numbers, and advanced by
/// its exponential: second order in the step, stable where the plant is. A and B change as slowly as the state does between kinks,
/// so steps in a row on one branch under one input, of whatever lengths, share those of their middle where the equations are straight between
/// their states: the slope in the middle is then the mean of those at the ends. Kinks and steep places of an effect that pushes the lever, which no branch tells, show in that as well. Two steps
/// do so beside other effects on the plant.
pub struct Sensitivity {
    states: usize,
    columns: usize,
    /// `states` rows of `columns` each.
    s: Vec<f64>,
    next: Vec<f64>,
    shared: Option<Shared>,
    /// A and B, of what is shared,
    a: [[f64; MOST_STATES]; MOST_STATES],
    b: Vec<f64>,
    /// and what they make of steps of these lengths: the first `known` ones.
    transitions: [Transition; LENGTHS],
    known: usize,
}

/// exp(A dt) and its integral times B.
struct Transition {
    dt: f64,
    states: [[f64; MOST_STATES]; MOST_STATES],
    drive: Vec<f64>,
}

/// Steps of so many lengths take turns, as those between three rows of a block do; of more the oldest is forgotten.
const LENGTHS: usize = 3;

/// Most steps that share A and B.
const MOST_SHARED: f64 = 8.0;
/// The same where an effect pushes the lever: of two frictions that turn round side by side a fit must tell which is which.
const MOST_SHARED_PUSHED: f64 = 2.0;
/// Over those, slopes bend by at most this share of what A alone changes them by.
const BEND: f64 = 0.001;
/// Longest time that two last that are not asked whether they are straight, s,
const TWO_S: f64 = 2e-3 + 1e-9;
/// and any while the lever creeps, s: what dies out there has a time constant of 1..2 ms.
const CREEP_S: f64 = 1e-3 + 1e-9;
/// Of a slope: what summing leaves of nothing.
const ROUNDING: f64 = 1e-9;

/// Which steps share A and B.
enum Shares {
    /// At most so many, where the equations are straight.
    WhereStraight(f64),
    /// Two, straight or not.
    Two,
}

impl Shares {
    /// Effects on the oil or on what drives it have states that follow it in their own time, and a dead time has derivatives that only the mean of two steps shows.
    fn of(effects: &EffectSet<f64>) -> Self {
        if effects.leave_the_plant_alone() {
            Shares::WhereStraight(MOST_SHARED)
        } else if effects.touches(PortKind::Mechanical) {
            Shares::WhereStraight(MOST_SHARED_PUSHED)
        } else {
            Shares::Two
        }
    }
}

/// Under both inputs A and B are as good as the same.
fn alike(a: &Input, b: &Input) -> bool {
    const VOLTAGE: f64 = 0.01;
    (a.voltage_v - b.voltage_v).abs() <= VOLTAGE * a.voltage_v.abs() && *a == Input { voltage_v: a.voltage_v, ..*b }
}

/// What A and B belong to.
struct Shared {
    input: Input,
    until_s: f64,
    branches: u32,
    steps: f64,
}

impl Sensitivity {
    /// Starts at zero: `columns` columns, the first of which belong to the seeded parameters of [`Seeds`].
    pub fn new(states: usize, columns: usize) -> Self {
        let empty = vec![0.0; states * columns];
        Sensitivity {
            states,
            columns,
            s: empty.clone(),
            next: empty.clone(),
            shared: None,
            a: [[0.0; MOST_STATES]; MOST_STATES],
            b: empty.clone(),
            transitions: std::array::from_fn(|_| Transition {
                dt: 0.0,
                states: [[0.0; MOST_STATES]; MOST_STATES],
                drive: empty.clone(),
            }),
            known: 0,
        }
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
        advance_wide(self, seeds, input, t, dt, middle);
    }

    #[inline(always)]
    fn advance_in(&mut self, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
        let branches = seeds.branches(input, t, middle);
        let kept =
            self.shared.as_ref().is_some_and(|s| s.branches == branches && t < s.until_s && alike(&s.input, input));
        if !kept {
            let (steps, centre) = self.shared_from(seeds, input, t, dt, middle, branches);
            self.linearise(seeds, input, t + 0.5 * (steps - 1.0) * dt, &centre[..middle.len()]);
            self.shared = Some(Shared { input: *input, until_s: t + (steps - 0.5) * dt, branches, steps });
        }
        let of_length = |known: &Transition| (known.dt - dt).abs() < 1e-9 * dt;
        let at = self.transitions[..self.known].iter().position(of_length).unwrap_or_else(|| self.transit(dt));
        let (n, m) = (self.states, self.columns);
        let over = &self.transitions[at];
        self.next.copy_from_slice(&over.drive);
        for i in 0..n {
            let row = &mut self.next[i * m..(i + 1) * m];
            for j in 0..n {
                let f = over.states[i][j];
                if f != 0.0 {
                    for (r, s) in row.iter_mut().zip(&self.s[j * m..(j + 1) * m]) {
                        *r += f * s;
                    }
                }
            }
        }
        std::mem::swap(&mut self.s, &mut self.next);
    }

    /// How many steps from this one on share A and B, and the state in the middle of them all, by the slope in the middle of the first. At most twice as many as
    /// the last time.
    #[inline(always)]
    fn shared_from(
        &self,
        seeds: &Seeds,
        input: &Input,
        t: f64,
        dt: f64,
        middle: &[f64],
        branches: u32,
    ) -> (f64, [f64; MOST_STATES]) {
        let n = middle.len();
        let slope = seeds.slope(input, t, middle);
        let ahead = |by_s: f64| -> [f64; MOST_STATES] {
            std::array::from_fn(|i| if i < n { middle[i] + by_s * slope[i] } else { 0.0 })
        };
        let same_branch = |x: &[f64; MOST_STATES]| seeds.branches(input, t, &x[..n]) == branches;
        let creeps = rec::creeps(input, branches) && !rests(&seeds.values, &seeds.with_effects, &slope, dt);
        let within = |steps: f64| !creeps || steps * dt <= CREEP_S;
        let most = match Shares::of(&seeds.with_effects) {
            Shares::WhereStraight(most) => most,
            Shares::Two if within(2.0) && 2.0 * dt <= TWO_S => {
                let centre = Some(ahead(0.5 * dt)).filter(same_branch);
                return (2.0, centre.unwrap_or_else(|| ahead(0.0)));
            }
            Shares::Two => return (1.0, ahead(0.0)),
        };
        let mut steps = self.shared.as_ref().map_or(1.0, |s| (2.0 * s.steps).min(most));
        while steps > 1.0 {
            let half_s = 0.5 * (steps - 1.0) * dt;
            let (centre, last) = (ahead(half_s), ahead(2.0 * half_s));
            if within(steps) && same_branch(&centre) && same_branch(&last) {
                let halfway = seeds.slope(input, t + half_s, &centre[..n]);
                let end = seeds.slope(input, t + 2.0 * half_s, &last[..n]);
                let is_straight = |i: usize| {
                    let bend = (slope[i] - 2.0 * halfway[i] + end[i]).abs();
                    let change: f64 = (0..n).map(|j| (self.a[i][j] * half_s * slope[j]).abs()).sum();
                    bend <= BEND * change + ROUNDING * (1.0 + slope[i].abs())
                };
                if (0..n).all(is_straight) {
                    return (steps, centre);
                }
            }
            steps *= 0.5;
        }
        (1.0, ahead(0.0))
    }

    /// A and B at this state.
    #[inline(always)]
    fn linearise(&mut self, seeds: &Seeds, input: &Input, t: f64, middle: &[f64]) {
        // a Tangent is long: no more of them than the plants that one meets have states
        if self.states <= FEW_STATES {
            linearise_few(self, seeds, input, t, middle);
        } else {
            linearise_most(self, seeds, input, t, middle);
        }
        self.known = 0;
    }

    /// What A and B make of a step of `dt` s, and where that is.
    #[inline(always)]
    fn transit(&mut self, dt: f64) -> usize {
        if self.known == LENGTHS {
            self.transitions.rotate_left(1);
        } else {
            self.known += 1;
        }
        let at = self.known - 1;
        self.transitions[at].dt = dt;
        if self.states <= FEW_STATES {
            transit_few(self, at);
        } else {
            transit_most(self, at);
        }
        at
    }

    /// With room for `N` states.
    #[inline(always)]
    fn linearise_in<const N: usize>(&mut self, seeds: &Seeds, input: &Input, t: f64, middle: &[f64]) {
        let (n, m) = (self.states, self.columns);
        let mut x = [Tangent::constant(0.0); N];
        let mut dx = [Tangent::constant(0.0); N];
        // B; columns beyond the seeded ones (initial states) have none
        self.b.fill(0.0);
        for (pass, pack) in seeds.packs.iter().enumerate() {
            for i in 0..n {
                x[i] = Tangent::variable(middle[i], i);
            }
            rec::derivative_by::<Tangent, true>(&mut Exact, input, &pack.k, &pack.effects, t, &x[..n], &mut dx[..n]);
            for i in 0..n {
                if pass == 0 {
                    self.a[i][..n].copy_from_slice(&dx[i].slope[..n]);
                }
                let row = &mut self.b[i * m + pack.first..];
                row[..pack.count].copy_from_slice(&dx[i].slope[n..n + pack.count]);
            }
        }
    }

    /// With room for `N` states.
    #[inline(always)]
    fn transit_in<const N: usize>(&mut self, at: usize) {
        let (n, m) = (self.states, self.columns);
        let mut a = [[0.0; N]; N];
        for (row, kept) in a.iter_mut().zip(&self.a) {
            row[..n].copy_from_slice(&kept[..n]);
        }
        let Transition { dt, states, drive } = &mut self.transitions[at];
        // exp(A dt) = 1 + A phi, S(dt) = exp(A dt) S + phi B, phi = dt (1 + A dt/2 + (A dt)^2/6 + ...)
        let phi = exponential_integral(&a, n, *dt);
        drive.fill(0.0);
        for i in 0..n {
            for j in 0..n {
                states[i][j] = f64::from(u8::from(i == j)) + (0..n).map(|l| a[i][l] * phi[l][j]).sum::<f64>();
                if phi[i][j] != 0.0 {
                    let row = &mut drive[i * m..(i + 1) * m];
                    for (d, b) in row.iter_mut().zip(&self.b[j * m..(j + 1) * m]) {
                        *d += phi[i][j] * b;
                    }
                }
            }
        }
    }
}

// The work of an identification is here, on rows of numbers: as wide as the machine's vectors are. Each lane is computed as it would be alone, so the
// results are the same to the last bit.

#[multiversion(targets("x86_64+avx2"))]
fn advance_wide(s: &mut Sensitivity, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
    s.advance_in(seeds, input, t, dt, middle);
}

#[multiversion(targets("x86_64+avx2"))]
fn linearise_few(s: &mut Sensitivity, seeds: &Seeds, input: &Input, t: f64, middle: &[f64]) {
    s.linearise_in::<FEW_STATES>(seeds, input, t, middle);
}

#[multiversion(targets("x86_64+avx2"))]
fn linearise_most(s: &mut Sensitivity, seeds: &Seeds, input: &Input, t: f64, middle: &[f64]) {
    s.linearise_in::<MOST_STATES>(seeds, input, t, middle);
}

#[multiversion(targets("x86_64+avx2"))]
fn transit_few(s: &mut Sensitivity, at: usize) {
    s.transit_in::<FEW_STATES>(at);
}

#[multiversion(targets("x86_64+avx2"))]
fn transit_most(s: &mut Sensitivity, at: usize) {
    s.transit_in::<MOST_STATES>(at);
}

/// Integral of exp(A t) over 0..dt by its series; the steps are short enough (|A| dt of order 1) for eight terms. Rows are summed over all `N`
/// columns, those without a state are 0: a row of known length is a vector or two of the machine's.
#[inline(always)]
fn exponential_integral<const N: usize>(a: &[[f64; N]; N], n: usize, dt: f64) -> [[f64; N]; N] {
    let mut sum = [[0.0; N]; N];
    let mut term = [[0.0; N]; N];
    for i in 0..n {
        term[i][i] = dt;
        sum[i][i] = dt;
    }
    for order in 2..=8 {
        let mut next = [[0.0; N]; N];
        let mut largest = [0.0f64; N];
        let share = dt / f64::from(order);
        for i in 0..n {
            let mut row = [0.0; N];
            for l in 0..n {
                let f = a[i][l] * share;
                if f != 0.0 {
                    for j in 0..N {
                        row[j] += f * term[l][j];
                    }
                }
            }
            for j in 0..N {
                sum[i][j] += row[j];
                largest[j] = largest[j].max(row[j].abs());
            }
            next[i] = row;
        }
        if largest.iter().all(|v| *v < 1e-7 * dt) {
            break;
        }
        term = next;
    }
    sum
}

#[cfg(test)]
mod tests;
