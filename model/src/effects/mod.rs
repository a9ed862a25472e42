//! The library of effects: physical effects that the reference model lacks, one file each.
//!
//! Adding an effect = one file with a [`Law`] + one line in [`LIBRARY`] and one in `order.rs` (or one in [`MECHANICAL`], for other plants than the rig). The emulated rig can be given it, identification
//! can fit it, and the diagnosis proposes it; the tests over the list hold it to the rules.

use crate::port::{Port, PortKind, Rest};
use crate::scalar::{Scalar, Tangent};

mod angle_offset;
mod asymmetric_coulomb;
mod backlash;
mod brake_valve_lag;
mod bypass_valve_lag;
mod chamber_asymmetry;
mod coulomb_friction;
mod cross_leakage;
mod cubic_stiffness;
mod displacement_pressure;
mod elastic_hysteresis;
pub mod empirical;
mod end_stop;
mod external_leakage;
mod force_offset;
mod gap;
mod lag;
mod line_inertance;
mod order;
mod pressure_drift;
mod pressure_friction;
mod pressure_lag;
mod pump_asymmetry;
mod pump_lag;
mod pump_warming;
mod quadratic_drag;
mod quadratic_stiffness;
mod set;
mod stribeck_friction;
mod tilt;
mod torque_cubic;
mod trapped_air;
mod valve;
mod wall_creep;

pub use asymmetric_coulomb::AsymmetricCoulomb;
pub use coulomb_friction::CoulombFriction;
pub use cross_leakage::CrossLeakage;
pub use cubic_stiffness::CubicStiffness;
pub use external_leakage::ExternalLeakage;
pub use force_offset::ForceOffset;
pub use quadratic_drag::QuadraticDrag;
pub use quadratic_stiffness::QuadraticStiffness;
pub use set::EffectSet;
pub use stribeck_friction::StribeckFriction;

/// Every effect of the library of the REC rig.
pub static LIBRARY: &[&dyn Effect] = &[
    &tilt::Tilt,
    &pressure_friction::PressureFriction,
    &torque_cubic::TorqueCubic,
    &stribeck_friction::StribeckFriction,
    &elastic_hysteresis::ElasticHysteresis,
    &end_stop::EndStop,
    &backlash::Backlash,
    &cross_leakage::CrossLeakage,
    &external_leakage::ExternalLeakage,
    &chamber_asymmetry::ChamberAsymmetry,
    &wall_creep::WallCreep,
    &trapped_air::TrappedAir,
    &displacement_pressure::DisplacementPressure,
    &pump_lag::PumpLag,
    &pump_asymmetry::PumpAsymmetry,
    &pump_warming::PumpWarming,
    &line_inertance::LineInertance,
    &brake_valve_lag::BRAKE_VALVE_LAG,
    &bypass_valve_lag::BYPASS_VALVE_LAG,
    &pressure_lag::PressureLag,
    &pressure_drift::PressureDrift,
    &angle_offset::AngleOffset,
];

/// General effects on a body that moves, for plants other than the REC rig, whose own equations hold most of them already. Ids
/// differ from those of [`LIBRARY`]; a plant names those of both lists that mean something on it.
pub static MECHANICAL: &[&dyn Effect] =
    &[&QuadraticStiffness, &CubicStiffness, &ForceOffset, &CoulombFriction, &AsymmetricCoulomb, &QuadraticDrag];

/// The effect of the REC rig's library with this id.
pub fn find(id: &str) -> Option<&'static dyn Effect> {
    LIBRARY.iter().copied().find(|e| e.header().id == id)
}

/// The form of the effect with this id to which these parameters belong: the library's, or its refined one where `given` knows a parameter
/// that only that has.
pub fn find_form(id: &str, given: impl Fn(&str) -> bool) -> Option<&'static dyn Effect> {
    let effect = find(id)?;
    let plain = effect.header().parameters.len();
    let refined = effect.refined().map(|r| r.effect);
    refined.filter(|r| r.header().parameters[plain..].iter().any(|p| given(p.name))).or(Some(effect))
}

/// The more general form of an effect, by which its form is refined once its name stands: a search over the library need not carry its
/// parameters.
pub struct Refined {
    /// The law. It has the id of the effect and its parameters, and behind them some of its own.
    pub effect: &'static dyn Effect,
    /// Values of its own parameters at which it is the library's form.
    pub neutral: &'static [f64],
    /// Values of its own parameters from which it is fitted, those of the library's form being as they were found.
    pub starts: &'static [&'static [f64]],
    /// Starts where a form of another kind has them elsewhere: factors of what was found, and its own values.
    pub away: &'static [(&'static [f64], &'static [f64])],
    /// Values of all its parameters at which it does what the library's form takes little of: a search asks for them as well as for the library's starts.
    pub screened: &'static [&'static [f64]],
}

impl Refined {
    /// Every place from which it is fitted, given the `found` values of the library's form: values in the order of the general form's header, within its bounds.
    pub fn all_starts(&self, found: &[f64]) -> Vec<Vec<f64>> {
        let bent = self.starts.iter().map(|own| [found, own].concat());
        let bounds = self.effect.header().parameters;
        let away = self.away.iter().map(|(factors, own)| {
            let moved =
                found.iter().zip(*factors).zip(bounds).map(|((v, factor), p)| (v * factor).clamp(p.lower, p.upper));
            moved.chain(own.iter().copied()).collect()
        });
        bent.chain(away).chain(self.effect.header().starts.iter().map(|s| s.to_vec())).collect()
    }

    /// Places beside the library's form with its `found` values: [`BESIDE`] of the way to each start of its own parameters. Where a little of another law is
    /// much beside the noise, a fit from one of [`Self::all_starts`] begins far above what the library's form leaves, and such a one does not.
    pub fn beside(&self, found: &[f64]) -> Vec<Vec<f64>> {
        let part = |own: &[f64]| self.neutral.iter().zip(own).map(|(n, o)| n + BESIDE * (o - n)).collect::<Vec<f64>>();
        self.starts.iter().map(|own| [found, &part(own)].concat()).collect()
    }
}

/// Share of the way from a library's form to a general one's starts.
const BESIDE: f64 = 0.05;

/// The balance of the plant that an effect disturbs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Balance {
    /// Torques on the lever.
    Torque,
    /// Oil of the chambers.
    Flow,
    /// Pump, valves and line.
    Pump,
    /// Sensors.
    Sensor,
}

impl Balance {
    /// All, in the order of reports.
    pub const ALL: [Balance; 4] = [Balance::Torque, Balance::Flow, Balance::Pump, Balance::Sensor];
    /// Name in files.
    pub fn as_str(self) -> &'static str {
        match self {
            Balance::Torque => "torque",
            Balance::Flow => "flow",
            Balance::Pump => "pump",
            Balance::Sensor => "sensor",
        }
    }
}

/// A parameter of an effect.
#[derive(Clone, Copy, Debug)]
pub struct Parameter {
    /// Name, with no unit in it.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Least physical value.
    pub lower: f64,
    /// Greatest physical value.
    pub upper: f64,
    /// A size that one meets: the scale of a step in a search.
    pub typical: f64,
    /// `true`: the effect vanishes where all such parameters are 0. `false`: a shape, which alone does nothing.
    pub size: bool,
}

/// What is known of an effect.
#[derive(Debug)]
pub struct Header {
    /// Unique id.
    pub id: &'static str,
    /// The balance that it disturbs.
    pub balance: Balance,
    /// The ports that it acts on.
    pub ports: &'static [PortKind],
    /// One sentence for a report.
    pub summary: &'static str,
    /// The equation as implemented.
    pub equation: &'static str,
    /// Where the equation holds.
    pub validity: &'static str,
    /// How one would measure it on a rig.
    pub measure: &'static str,
    /// Literature.
    pub literature: &'static str,
    /// Parameters.
    pub parameters: &'static [Parameter],
    /// Number of states.
    pub states: usize,
    /// Parameter vectors to start a search from: small, typical, large; different shapes and signs.
    pub starts: &'static [&'static [f64]],
    /// Takes energy out of the plant, never adds any (checked by test).
    pub passive: bool,
}

impl Header {
    /// Values with all sizes times `factor`, within their bounds; shapes as they are.
    pub fn scaled(&self, values: &[f64], factor: f64) -> Vec<f64> {
        let each = self.parameters.iter().zip(values);
        each.map(|(p, v)| if p.size { (v * factor).clamp(p.lower, p.upper) } else { *v }).collect()
    }
}

/// An effect's equation, generic over the scalar.
pub trait Law: Sync + 'static {
    /// What is known of it.
    const HEADER: Header;
    /// Asks for [`crate::port::HydraulicPort::stored_slope_ml_rad`], which is 0 where no effect does: it is dear.
    const CLOSES_VOLUME: bool = false;
    /// A more general form, where there is one.
    const REFINED: Option<Refined> = None;
    /// Acts on a port: `k` parameters in the header's order, `x` own states, `dx` their derivatives (zero on entry).
    fn act<S: Scalar>(&self, k: &[S], x: &[S], dx: &mut [S], port: &mut Port<'_, S>);
    /// Own states at rest.
    fn rest<S: Scalar>(&self, _k: &[S], _rest: &Rest<S>, x: &mut [S]) {
        x.fill(S::zero());
    }
    /// With these parameters it is what its name says: what acts from the middle of the stroke on, say, is no end stop, though its law can be bent to it.
    fn is_itself(&self, _k: &[f64]) -> bool {
        true
    }
}

/// A [`Law`] behind a pointer: one entry point for each scalar.
pub trait Effect: Sync {
    /// What is known of it.
    fn header(&self) -> &'static Header;
    /// [`Law::CLOSES_VOLUME`].
    fn closes_volume(&self) -> bool;
    /// [`Law::REFINED`].
    fn refined(&self) -> Option<&'static Refined>;
    /// [`Law::is_itself`].
    fn is_itself(&self, k: &[f64]) -> bool;
    /// [`Law::act`] for values.
    fn act_value(&self, k: &[f64], x: &[f64], dx: &mut [f64], port: &mut Port<'_, f64>);
    /// [`Law::act`] with derivatives.
    fn act_tangent(&self, k: &[Tangent], x: &[Tangent], dx: &mut [Tangent], port: &mut Port<'_, Tangent>);
    /// [`Law::rest`] for values.
    fn rest_value(&self, k: &[f64], rest: &Rest<f64>, x: &mut [f64]);
    /// [`Law::rest`] with derivatives.
    fn rest_tangent(&self, k: &[Tangent], rest: &Rest<Tangent>, x: &mut [Tangent]);
}

impl<L: Law> Effect for L {
    fn header(&self) -> &'static Header {
        const { &L::HEADER }
    }
    fn closes_volume(&self) -> bool {
        L::CLOSES_VOLUME
    }
    fn refined(&self) -> Option<&'static Refined> {
        const { &L::REFINED }.as_ref()
    }
    fn is_itself(&self, k: &[f64]) -> bool {
        Law::is_itself(self, k)
    }
    fn act_value(&self, k: &[f64], x: &[f64], dx: &mut [f64], port: &mut Port<'_, f64>) {
        self.act(k, x, dx, port);
    }
    fn act_tangent(&self, k: &[Tangent], x: &[Tangent], dx: &mut [Tangent], port: &mut Port<'_, Tangent>) {
        self.act(k, x, dx, port);
    }
    fn rest_value(&self, k: &[f64], rest: &Rest<f64>, x: &mut [f64]) {
        self.rest(k, rest, x);
    }
    fn rest_tangent(&self, k: &[Tangent], rest: &Rest<Tangent>, x: &mut [Tangent]) {
        self.rest(k, rest, x);
    }
}

impl std::fmt::Debug for dyn Effect {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(self.header().id)
    }
}

#[cfg(test)]
mod tests;
