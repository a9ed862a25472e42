//! Sensitivities beside an integration.

use multiversion::multiversion;

use crate::effects::EffectSet;
use crate::integrate::{FEW_STATES, MOST_STATES};
use crate::near::Exact;
use crate::port::PortKind;
use crate::rec::{self, Input};
use crate::scalar::{LANES, Scalar, Tangent};
use crate::step::rests;

/// Derivatives of the states with respect to chosen parameters, carried along a simulated trajectory.
///
/// The variational equation S' = A S + B is taken at the middle of a step, with A and B from dual numbers, and advanced by
/// its exponential: second order in the step, stable where the plant is. A and B change as slowly as the state does between kinks,
/// so steps in a row on one branch under one input share those of their middle where the equations are straight between their states: the slope in the
/// middle is then the mean of those at the ends. Kinks and steep places of effects, which no branch tells, show in that as well.
pub struct Sensitivity {
    states: usize,
    columns: usize,
    /// `states` rows of `columns` each.
    s: Vec<f64>,
    next: Vec<f64>,
    shared: Option<Shared>,
    /// A, of what is shared.
    a: [[f64; MOST_STATES]; MOST_STATES],
    /// exp(A dt) and its integral times B, of what is shared.
    transition: [[f64; MOST_STATES]; MOST_STATES],
    drive: Vec<f64>,
}

/// Most steps that share A and B.
const MOST_SHARED: f64 = 8.0;
/// The same where an effect pushes the lever: of two frictions that turn round side by side a fit must tell which is which.
const MOST_SHARED_PUSHED: f64 = 2.0;
/// Over those, slopes bend by at most this share of what A alone changes them by.
const BEND: f64 = 0.001;
/// Longest time that they last while the lever creeps, s: what dies out there has a time constant of 1..2 ms.
const CREEP_S: f64 = 1e-3 + 1e-9;
/// Of a slope: what summing leaves of nothing.
const ROUNDING: f64 = 1e-9;

/// Under both inputs A and B are as good as the same.
fn alike(a: &Input, b: &Input) -> bool {
    const VOLTAGE: f64 = 0.01;
    (a.voltage_v - b.voltage_v).abs() <= VOLTAGE * a.voltage_v.abs() && *a == Input { voltage_v: a.voltage_v, ..*b }
}

/// What A and B belong to.
struct Shared {
    input: Input,
    dt: f64,
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
            transition: [[0.0; MOST_STATES]; MOST_STATES],
            drive: empty,
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
        let kept = self.shared.as_ref().is_some_and(|s| {
            s.branches == branches && t < s.until_s && (s.dt - dt).abs() < 1e-9 * dt && alike(&s.input, input)
        });
        if !kept {
            let (steps, centre) = match seeds.most_steps() {
                Some(most) => self.straight(seeds, input, t, dt, middle, (branches, most)),
                None => seeds.two_steps(input, t, dt, middle, branches),
            };
            self.linearise(seeds, input, t + 0.5 * (steps - 1.0) * dt, dt, &centre[..middle.len()]);
            self.shared = Some(Shared { input: *input, dt, until_s: t + (steps - 0.5) * dt, branches, steps });
        }
        let (n, m) = (self.states, self.columns);
        self.next.copy_from_slice(&self.drive);
        for i in 0..n {
            let row = &mut self.next[i * m..(i + 1) * m];
            for j in 0..n {
                let f = self.transition[i][j];
                if f != 0.0 {
                    for (r, s) in row.iter_mut().zip(&self.s[j * m..(j + 1) * m]) {
                        *r += f * s;
                    }
                }
            }
        }
        std::mem::swap(&mut self.s, &mut self.next);
    }

    /// How many steps from this one on may share A and B, and the state in the middle of them all, by the slope in the middle of the first: as many as the
    /// equations are straight over, as they stand on the way from the first one's middle to the last one's. At most twice as many as the last time.
    #[inline(always)]
    fn straight(
        &self,
        seeds: &Seeds,
        input: &Input,
        t: f64,
        dt: f64,
        middle: &[f64],
        (branches, most): (u32, f64),
    ) -> (f64, [f64; MOST_STATES]) {
        let n = middle.len();
        let slope = seeds.slope(input, t, middle);
        let ahead = |by_s: f64| -> [f64; MOST_STATES] {
            std::array::from_fn(|i| if i < n { middle[i] + by_s * slope[i] } else { 0.0 })
        };
        let creeps = rec::creeps(input, branches) && !rests(&seeds.values, &seeds.with_effects, &slope, dt);
        let mut steps = self.shared.as_ref().map_or(1.0, |s| (2.0 * s.steps).min(most));
        while creeps && steps > 1.0 && steps * dt > CREEP_S {
            steps *= 0.5;
        }
        while steps > 1.0 {
            let half_s = 0.5 * (steps - 1.0) * dt;
            let (centre, last) = (ahead(half_s), ahead(2.0 * half_s));
            let there = |x: &[f64]| seeds.branches(input, t, x) == branches;
            if there(&centre[..n]) && there(&last[..n]) {
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

    /// Transition and drive over `dt` from A and B at this state.
    #[inline(always)]
    fn linearise(&mut self, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
        // a Tangent is long: no more of them than the plants that one meets have states
        if self.states <= FEW_STATES {
            linearise_few(self, seeds, input, t, dt, middle);
        } else {
            linearise_most(self, seeds, input, t, dt, middle);
        }
    }

    /// With room for `N` states.
    #[inline(always)]
    fn linearise_in<const N: usize>(&mut self, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
        let (n, m) = (self.states, self.columns);
        let mut a = [[0.0; N]; N];
        let mut x = [Tangent::constant(0.0); N];
        let mut dx = [Tangent::constant(0.0); N];
        // B; columns beyond the seeded ones (initial states) have none
        self.next.fill(0.0);
        for (pass, pack) in seeds.packs.iter().enumerate() {
            for i in 0..n {
                x[i] = Tangent::variable(middle[i], i);
            }
            rec::derivative_by::<Tangent, true>(&mut Exact, input, &pack.k, &pack.effects, t, &x[..n], &mut dx[..n]);
            for i in 0..n {
                if pass == 0 {
                    a[i][..n].copy_from_slice(&dx[i].slope[..n]);
                }
                let row = &mut self.next[i * m + pack.first..];
                row[..pack.count].copy_from_slice(&dx[i].slope[n..n + pack.count]);
            }
        }
        for (kept, row) in self.a.iter_mut().zip(&a) {
            kept[..n].copy_from_slice(&row[..n]);
        }
        // exp(A dt) = 1 + A phi, S(dt) = exp(A dt) S + phi B, phi = dt (1 + A dt/2 + (A dt)^2/6 + ...)
        let phi = exponential_integral(&a, n, dt);
        self.drive.fill(0.0);
        for i in 0..n {
            for j in 0..n {
                self.transition[i][j] = f64::from(u8::from(i == j)) + (0..n).map(|l| a[i][l] * phi[l][j]).sum::<f64>();
                if phi[i][j] != 0.0 {
                    let row = &mut self.drive[i * m..(i + 1) * m];
                    for (d, b) in row.iter_mut().zip(&self.next[j * m..(j + 1) * m]) {
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
fn linearise_few(s: &mut Sensitivity, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
    s.linearise_in::<FEW_STATES>(seeds, input, t, dt, middle);
}

#[multiversion(targets("x86_64+avx2"))]
fn linearise_most(s: &mut Sensitivity, seeds: &Seeds, input: &Input, t: f64, dt: f64, middle: &[f64]) {
    s.linearise_in::<MOST_STATES>(seeds, input, t, dt, middle);
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

/// Parameters as dual numbers, packed so that states and parameters of one pass fit into the lanes.
pub struct Seeds {
    packs: Vec<Pack>,
    /// The values alone, to tell branches and to look ahead.
    values: Vec<f64>,
    with_effects: EffectSet<f64>,
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
                let values = packs.first().map(|p: &Pack| p.k.iter().map(|v| v.value).collect()).unwrap_or_default();
                let with_effects = packs.first().map_or_else(EffectSet::none, |p: &Pack| p.effects.values());
                return Seeds { packs, values, with_effects };
            }
        }
    }

    /// The derivative of the states.
    fn slope(&self, input: &Input, t: f64, x: &[f64]) -> [f64; MOST_STATES] {
        let mut dx = [0.0; MOST_STATES];
        rec::derivative(input, &self.values, &self.with_effects, t, x, &mut dx[..x.len()]);
        dx
    }

    /// Most steps that share A and B where the equations are straight; `None` where effects act on the oil or what drives it, whose states follow it in their own
    /// time: two then, straight or not, for a dead time has derivatives that only such a mean shows.
    fn most_steps(&self) -> Option<f64> {
        if self.with_effects.leave_the_plant_alone() {
            Some(MOST_SHARED)
        } else {
            self.with_effects.touches(PortKind::Mechanical).then_some(MOST_SHARED_PUSHED)
        }
    }

    /// Two steps from this one on and the state in the middle of them, where the lever does not creep faster than that.
    fn two_steps(&self, input: &Input, t: f64, dt: f64, middle: &[f64], branches: u32) -> (f64, [f64; MOST_STATES]) {
        let n = middle.len();
        let mut here = [0.0; MOST_STATES];
        here[..n].copy_from_slice(middle);
        if rec::creeps(input, branches) && 2.0 * dt > CREEP_S {
            return (1.0, here);
        }
        let slope = self.slope(input, t, middle);
        let ahead: [f64; MOST_STATES] = std::array::from_fn(|i| here[i] + 0.5 * dt * slope[i]);
        (2.0, if self.branches(input, t, &ahead[..n]) == branches { ahead } else { here })
    }

    /// Which branches of the reference model's piecewise equations hold in a state; effects on the voltage are left out.
    fn branches(&self, input: &Input, t: f64, x: &[f64]) -> u32 {
        rec::branches(input, &self.values, &EffectSet::none(), t, x, &mut [0.0; MOST_STATES])
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Parameters;
    use crate::parameters::COUNT;
    use crate::rec::{Circuit, Lever, STATES};

    #[test]
    fn wide_vectors_compute_each_lane_as_it_would_be_alone() {
        let known = Parameters::example().to_vector();
        let seeds = Seeds::new(STATES, COUNT, |lane| {
            let dual = |(c, v): (usize, &f64)| lane(c).map_or(Tangent::constant(*v), |l| Tangent::variable(*v, l));
            (known.iter().enumerate().map(dual).collect(), EffectSet::none())
        });
        let (mut wide, mut plain) = (Sensitivity::new(STATES, COUNT + 3), Sensitivity::new(STATES, COUNT + 3));
        for s in [&mut wide, &mut plain] {
            (0..3).for_each(|i| s.set(i, COUNT + i, 1.0));
        }
        for step in 0..200 {
            let (t, swing) = (f64::from(step) * 1e-3, (0.07 * f64::from(step)).sin());
            let input = Input {
                voltage_v: 18.0 * swing.signum(),
                brake_open: true,
                bypass_open: step > 150,
                vertical: true,
                lever: Lever::Free,
                circuit: Circuit::Pump,
            };
            let middle = [0.4 * swing, 1.5 * swing, 2.5 + 0.4 * swing, 2.6 - 0.4 * swing, 0.0];
            wide.advance(&seeds, &input, t, 1e-3, &middle[..STATES]);
            plain.advance_in(&seeds, &input, t, 1e-3, &middle[..STATES]);
            let (mut one, mut other) = (Sensitivity::new(STATES, COUNT + 3), Sensitivity::new(STATES, COUNT + 3));
            linearise_few(&mut one, &seeds, &input, t, 1e-3, &middle[..STATES]);
            other.linearise_in::<FEW_STATES>(&seeds, &input, t, 1e-3, &middle[..STATES]);
            assert!(same(&one.drive, &other.drive), "drive at step {step}");
            assert!(same(one.transition.as_flattened(), other.transition.as_flattened()), "transition at step {step}");
        }
        assert!(wide.s.iter().any(|v| *v != 0.0) && wide.s.iter().all(|v| v.is_finite()));
        assert!(same(&wide.s, &plain.s), "carried along");
    }

    fn same(a: &[f64], b: &[f64]) -> bool {
        a.len() == b.len() && a.iter().zip(b).all(|(a, b)| a.to_bits() == b.to_bits())
    }
}
