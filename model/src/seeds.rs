//! Parameters and effects as dual numbers: what derivatives are taken by.

use crate::effects::EffectSet;
use crate::integrate::MOST_STATES;
use crate::rec::{self, Input};
use crate::scalar::{LANES, Tangent};

/// Parameters as dual numbers, packed so that states and parameters of one pass fit into the lanes.
pub struct Seeds {
    pub(crate) packs: Vec<Pack>,
    /// The values alone, to tell branches and to look ahead.
    pub(crate) values: Vec<f64>,
    pub(crate) with_effects: EffectSet<f64>,
}

/// The parameters of one pass.
pub(crate) struct Pack {
    pub first: usize,
    pub count: usize,
    pub k: Vec<Tangent>,
    pub effects: EffectSet<Tangent>,
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
    pub(crate) fn slope(&self, input: &Input, t: f64, x: &[f64]) -> [f64; MOST_STATES] {
        let mut dx = [0.0; MOST_STATES];
        rec::derivative(input, &self.values, &self.with_effects, t, x, &mut dx[..x.len()]);
        dx
    }

    /// Which branches of the reference model's piecewise equations hold in a state; effects on the voltage are left out.
    pub(crate) fn branches(&self, input: &Input, t: f64, x: &[f64]) -> u32 {
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
