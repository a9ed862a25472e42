//! Which parameters of the plant and of its effects are free, and where they stand in the vector that is fitted.

use model::Parameters;
use model::effects::{Effect, EffectSet};
use model::parameters::{COUNT, NAMES, index};
use model::rec::STATES;
use model::scalar::Scalar;

/// Base parameters that an identification may free. `l4` follows from the continuity of eq. (16), `a2` can't be told from
/// the scale of h1 and h3, and J, G are known of the rig.
pub const FREE: [usize; 18] = {
    use index::*;
    [M1, M2, M3, H1, H2, H3, A1, V1, V2, F1, F2, F3, F4, L1, L2, L3, A, K_B]
};

/// The parameter vector of a fit: free base parameters, then those of the effects in order.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Positions in the plant's parameter vector.
    pub base: Vec<usize>,
    /// Effects that the model carries.
    pub effects: Vec<&'static dyn Effect>,
    /// Values of what is not free.
    pub fixed: [f64; COUNT],
    /// V
    pub u_max: f64,
    /// Entries that keep their value: sizes of an effect that the data do not ask for.
    pub held: std::collections::BTreeSet<usize>,
}

impl Layout {
    /// Everything of [`FREE`] free, no effect.
    pub fn base(start: &Parameters) -> Self {
        Layout {
            base: FREE.to_vec(),
            effects: Vec::new(),
            fixed: start.to_vector(),
            u_max: start.pump.u_max,
            held: Default::default(),
        }
    }

    /// Length of the vector.
    pub fn len(&self) -> usize {
        self.base.len() + self.effects.iter().map(|e| e.header().parameters.len()).sum::<usize>()
    }

    /// True where nothing is free.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Names, `m1` or `pump_lag.tau`.
    pub fn names(&self) -> Vec<String> {
        let base = self.base.iter().map(|&i| NAMES[i].to_string());
        let effects = self.effects.iter().flat_map(|e| {
            let header = e.header();
            header.parameters.iter().map(move |p| format!("{}.{}", header.id, p.name))
        });
        base.chain(effects).collect()
    }

    /// Bounds of each entry.
    pub fn bounds(&self) -> Vec<(f64, f64)> {
        use index::*;
        let base = self.base.iter().map(|&i| match i {
            H1 | V2 | F1 | K_B | M3 => (1e-9, f64::INFINITY),
            // the capacity falls with pressure and stays positive
            H2 => (-6.0, -0.05),
            H3 => (0.0, f64::INFINITY),
            A => (3e-3, 0.2),
            // losses take energy; their growth may weaken with speed, but not by much
            L1 => (-10.0, f64::INFINITY),
            L2 | L3 => (0.0, f64::INFINITY),
            // the pump slips backwards
            F3 => (f64::NEG_INFINITY, 0.0),
            _ => (f64::NEG_INFINITY, f64::INFINITY),
        });
        base.chain(self.effects.iter().flat_map(|e| e.header().parameters.iter().map(|p| (p.lower, p.upper)))).collect()
    }

    /// First entry of the `n`-th effect.
    pub fn first_of(&self, n: usize) -> usize {
        self.base.len() + self.effects[..n].iter().map(|e| e.header().parameters.len()).sum::<usize>()
    }

    /// The free entries of a full parameter set, without effects.
    pub fn vector_of(&self, p: &Parameters) -> Vec<f64> {
        let full = p.to_vector();
        self.base.iter().map(|&i| full[i]).collect()
    }

    /// Plant parameters and effects for these values.
    pub fn expand<S: Scalar>(&self, theta: &[S]) -> (Vec<S>, EffectSet<S>) {
        use index::*;
        let mut k: Vec<S> = self.fixed.iter().map(|v| S::constant(*v)).collect();
        for (i, value) in self.base.iter().zip(theta) {
            k[*i] = *value;
        }
        // eq. (16) is continuous at |w| = a
        k[L4] = ((k[L1] * k[A] + k[L2]) * k[A] + k[L3]) / k[A];
        let mut rest = &theta[self.base.len()..];
        let effects = self.effects.iter().map(|e| {
            let (own, after) = rest.split_at(e.header().parameters.len());
            rest = after;
            (*e, own.to_vec())
        });
        let set = EffectSet::new(STATES, effects.collect::<Vec<_>>());
        (k, set)
    }

    /// The reference model's part of these values.
    pub fn parameters(&self, theta: &[f64]) -> Parameters {
        let (k, _) = self.expand(theta);
        Parameters::from_vector(k[..].try_into().expect("expand gives a whole parameter vector"), self.u_max)
    }

    /// The same with one more effect.
    pub fn with(&self, effect: &'static dyn Effect) -> Self {
        let mut more = self.clone();
        more.effects.push(effect);
        more
    }
}
