//! Which parameters of the plant and of its effects are free, and where they stand in the vector that is fitted.

use model::effects::{Effect, EffectSet};

use crate::plant::{Number, Plant};

pub use crate::plants::rec::FREE;

/// The parameter vector of a fit: free base parameters, then those of the effects in order.
#[derive(Clone, Debug)]
pub struct Layout {
    /// Whose parameters they are.
    pub plant: &'static dyn Plant,
    /// Positions in the plant's parameter vector.
    pub base: Vec<usize>,
    /// Effects that the model carries.
    pub effects: Vec<&'static dyn Effect>,
    /// Values of what is not free: a whole parameter vector of the plant.
    pub fixed: Vec<f64>,
    /// Largest voltage of the REC rig, V; a fact that its model file carries. 0 on another plant.
    pub u_max: f64,
    /// Entries that keep their value: sizes of an effect that the data do not ask for.
    pub held: std::collections::BTreeSet<usize>,
}

impl Layout {
    /// Every base parameter of a plant free, no effect.
    pub fn of_plant(plant: &'static dyn Plant) -> Self {
        let fixed: Vec<f64> = plant.header().parameters.iter().map(|p| p.start).collect();
        Layout {
            plant,
            base: (0..fixed.len()).collect(),
            effects: Vec::new(),
            fixed,
            u_max: 0.0,
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
        let base = self.base.iter().map(|&i| self.plant.header().parameters[i].name.to_string());
        let effects = self.effects.iter().flat_map(|e| {
            let header = e.header();
            header.parameters.iter().map(move |p| format!("{}.{}", header.id, p.name))
        });
        base.chain(effects).collect()
    }

    /// Bounds of each entry.
    pub fn bounds(&self) -> Vec<(f64, f64)> {
        let parameters = self.plant.header().parameters;
        let base = self.base.iter().map(|&i| (parameters[i].lower, parameters[i].upper));
        base.chain(self.effects.iter().flat_map(|e| e.header().parameters.iter().map(|p| (p.lower, p.upper)))).collect()
    }

    /// Whether a plant parameter (by its place in the plant's list) stands at a bound of what it may be.
    pub fn is_at_bound(&self, parameter: usize, value: f64) -> bool {
        let own = &self.plant.header().parameters[parameter];
        let mut bounds = [own.lower, own.upper].into_iter().filter(|bound| bound.is_finite());
        bounds.any(|bound| (value - bound).abs() <= 1e-9 * bound.abs().max(1.0))
    }

    /// First entry of the `n`-th effect.
    pub fn first_of(&self, n: usize) -> usize {
        self.base.len() + self.effects[..n].iter().map(|e| e.header().parameters.len()).sum::<usize>()
    }

    /// Entries of the effects' shapes: parameters that are no sizes.
    pub fn shapes(&self) -> Vec<usize> {
        let each = self.effects.iter().enumerate().flat_map(|(n, effect)| {
            let own = effect.header().parameters.iter().enumerate().filter(|(_, p)| !p.size);
            own.map(move |(i, _)| self.first_of(n) + i)
        });
        each.collect()
    }

    /// Plant parameters and effects for these values.
    pub fn expand<S: Number>(&self, theta: &[S]) -> (Vec<S>, EffectSet<S>) {
        let mut k: Vec<S> = self.fixed.iter().map(|v| S::constant(*v)).collect();
        for (i, value) in self.base.iter().zip(theta) {
            k[*i] = *value;
        }
        S::complete(self.plant, &mut k);
        let mut rest = &theta[self.base.len()..];
        let effects = self.effects.iter().map(|e| {
            let (own, after) = rest.split_at(e.header().parameters.len());
            rest = after;
            (*e, own.to_vec())
        });
        let set = EffectSet::new(self.plant.header().states.len(), effects.collect::<Vec<_>>());
        (k, set)
    }

    /// These values with the base's own as [`Plant::unbend`] sets them.
    pub fn unbent(&self, theta: &[f64]) -> Vec<f64> {
        let (mut k, _) = self.expand(theta);
        self.plant.unbend(&mut k);
        let base = self.base.iter().map(|&i| k[i]);
        base.chain(theta[self.base.len()..].iter().copied()).collect()
    }

    /// The same with one more effect.
    pub fn with(&self, effect: &'static dyn Effect) -> Self {
        let mut more = self.clone();
        more.effects.push(effect);
        more
    }
}

#[cfg(test)]
mod tests {
    use crate::common::layout;
    use model::Parameters;
    use model::parameters::index;

    #[test]
    fn a_parameter_stands_at_the_bounds_of_its_plant_and_nowhere_else() {
        let layout = layout(&Parameters::example());
        for (parameter, value, at_bound) in [
            (index::L1, -10.0, true),
            (index::L1, -9.99, false),
            (index::F3, 0.0, true),
            (index::F3, -0.25, false),
            (index::A, 0.2, true),
            (index::A, 3e-3, true),
            (index::A, 0.02, false),
            (index::M1, -10.0, false),
        ] {
            assert_eq!(layout.is_at_bound(parameter, value), at_bound, "{parameter}: {value}");
        }
    }
}
