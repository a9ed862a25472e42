//! What the engine knows of a plant: everything behind this trait. Fitting, scoring, comparing and refusing are the same for all.
//!
//! The REC rig ([`crate::plants::rec`]) has its own fast simulation. Any other plant is written as
//! [`crate::equations::Equations`], in one file, and gets its simulation and derivatives from there.

use model::effects::{Balance, Effect};
use model::integrate::SimulationError;
use model::port::PortKind;
use model::scalar::{Scalar, Tangent};

use crate::layout::Layout;
use crate::predict::Linear;
use crate::prepare::Stretch;

/// A quantity of a plant: a state, an input or an output.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// Name, with no unit in it.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
}

/// A parameter of a plant without effects.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BaseParameter {
    /// Name, with no unit in it.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Least physical value.
    pub lower: f64,
    /// Greatest physical value.
    pub upper: f64,
    /// Where a fit starts.
    pub start: f64,
}

/// What is known of a plant.
#[derive(Debug)]
pub struct PlantHeader {
    /// Word on the command line.
    pub id: &'static str,
    /// One sentence.
    pub summary: &'static str,
    /// The equations as implemented, without effects.
    pub equation: &'static str,
    /// States of the plant itself; those of the effects follow.
    pub states: &'static [Quantity],
    /// What acts from outside.
    pub inputs: &'static [Quantity],
    /// What is measured and compared, in the order of [`crate::prepare::Channel`].
    pub channels: &'static [Quantity],
    /// Base parameters.
    pub parameters: &'static [BaseParameter],
    /// Its balances with the word for each on this plant.
    pub balances: &'static [(Balance, &'static str)],
    /// Ports that it fills.
    pub ports: &'static [PortKind],
    /// Effects that are offered: ports that it fills, signals that mean something there.
    pub library: &'static [&'static dyn Effect],
}

/// A plant. See the module.
pub trait Plant: Sync {
    /// What is known of it.
    fn header(&self) -> &'static PlantHeader;

    /// Length (s) of the clusters of a stretch, over which what the residual remembers is forgotten; `None`: the stretch is one.
    fn cluster_s(&self, stretch: &Stretch) -> Option<f64>;

    /// Rows at the start of a stretch during which the plant rests, so that the measured values show the noise's own colour.
    fn rest_rows(&self, _stretch: &Stretch) -> usize {
        0
    }

    /// Its simulation heeds [`Stretch::guide`].
    fn can_be_guided(&self) -> bool {
        false
    }

    /// Sets the parameters that follow from others.
    fn complete_values(&self, _k: &mut [f64]) {}

    /// The same with derivatives.
    fn complete_tangents(&self, _k: &mut [Tangent]) {}

    /// Sets those base values to where a fit starts afresh that take the place of an effect while it is not in the model, and hardly find back from there.
    fn unbend(&self, _k: &mut [f64]) {}

    /// Predictions at a stretch's targets: free run from its initial state, corrected by `initial`, with the recorded inputs.
    fn predict(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<f64>, SimulationError>;

    /// The same with derivatives.
    fn linearise(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Linear, SimulationError>;

    /// Predictions at every row: one value a channel, `NaN` for one that is no output there.
    fn rows(
        &self,
        stretch: &Stretch,
        layout: &Layout,
        theta: &[f64],
        initial: &[f64],
    ) -> Result<Vec<Vec<f64>>, SimulationError>;
}

impl std::fmt::Debug for dyn Plant {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.header().id)
    }
}

/// A [`Scalar`] that chooses a plant's entry point.
pub trait Number: Scalar {
    /// Sets the parameters that follow from others.
    fn complete(plant: &dyn Plant, k: &mut [Self]);
}

impl Number for f64 {
    fn complete(plant: &dyn Plant, k: &mut [f64]) {
        plant.complete_values(k);
    }
}

impl Number for Tangent {
    fn complete(plant: &dyn Plant, k: &mut [Tangent]) {
        plant.complete_tangents(k);
    }
}
