//! Sensitivities beside an integration.

use crate::effects::EffectSet;
use crate::integrate::MOST_STATES;
use crate::rec::{self, Input};
use crate::scalar::{LANES, Scalar, Tangent};

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
