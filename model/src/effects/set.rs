//! The effects that a plant carries: which act at which of its ports, in which order, and where their states are.

use super::{Effect, order};
use crate::port::{Port, PortKind, Rest};
use crate::scalar::{Scalar, Tangent};

/// An effect with its parameters and the place of its states.
struct Active<S> {
    effect: &'static dyn Effect,
    /// Its place among those that act.
    rank: usize,
    k: Vec<S>,
    /// Its states in the plant's state vector.
    own: std::ops::Range<usize>,
    /// Bits of the ports that it acts on.
    ports: u8,
}

/// The effects that a plant carries.
pub struct EffectSet<S> {
    /// In the order in which they act, which is not that of their states.
    items: Vec<Active<S>>,
    /// Number of the plant's own states.
    plant_states: usize,
    /// Number of states of all effects together.
    pub states: usize,
    ports: u8,
    /// An effect at the sensor port has states of its own.
    pub(crate) sensor_states: bool,
    /// An effect asks for the slope of the stored oil.
    pub(crate) closes_volume: bool,
}

impl EffectSet<Tangent> {
    /// The same effects by their values, without derivatives.
    pub(crate) fn values(&self) -> EffectSet<f64> {
        let value = |a: &Active<Tangent>| Active {
            effect: a.effect,
            rank: a.rank,
            k: a.k.iter().map(|v| v.value).collect(),
            own: a.own.clone(),
            ports: a.ports,
        };
        let EffectSet { plant_states, states, ports, sensor_states, closes_volume, .. } = *self;
        let items = self.items.iter().map(value).collect();
        EffectSet { items, plant_states, states, ports, sensor_states, closes_volume }
    }
}

impl<S: Scalar> EffectSet<S> {
    /// No effect: the reference model.
    pub fn none() -> Self {
        let items = Vec::new();
        EffectSet { items, plant_states: 0, states: 0, ports: 0, sensor_states: false, closes_volume: false }
    }

    /// These effects, each with parameters in its header's order. `plant_states`: number of the plant's own states. Their states follow in the order given;
    /// they act in a physical order, whichever is given.
    pub fn new(plant_states: usize, effects: impl IntoIterator<Item = (&'static dyn Effect, Vec<S>)>) -> Self {
        let mut set = EffectSet { plant_states, ..Self::none() };
        for (effect, k) in effects {
            let header = effect.header();
            assert_eq!(k.len(), header.parameters.len(), "{} takes {} parameters", header.id, header.parameters.len());
            let first = plant_states + set.states;
            let ports = header.ports.iter().fold(0, |bits, port| bits | 1 << *port as u8);
            let rank = order::rank(header.id);
            let place = set.items.partition_point(|a| a.rank <= rank);
            set.items.insert(place, Active { effect, rank, k, own: first..first + header.states, ports });
            set.states += header.states;
            set.ports |= ports;
            set.closes_volume |= effect.closes_volume();
            set.sensor_states |= header.states > 0 && header.ports.contains(&PortKind::Sensor);
        }
        set
    }

    /// The plant moves as the reference model does: there is no effect, or none but on what the sensors show.
    pub fn leave_the_plant_alone(&self) -> bool {
        self.ports & !(1 << PortKind::Sensor as u8) == 0 && !self.sensor_states
    }

    /// Places of the states of each effect that acts at the chambers alone, in the plant's state vector.
    pub fn at_chambers(&self) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        self.with_states().filter(|a| a.ports == 1 << PortKind::Hydraulic as u8).map(|a| a.own.clone())
    }

    /// The same of each effect in a sensor, or of each that is in none.
    pub fn in_sensors(&self, within: bool) -> impl Iterator<Item = std::ops::Range<usize>> + '_ {
        let in_sensor = |a: &Active<S>| a.ports & 1 << PortKind::Sensor as u8 != 0;
        self.with_states().filter(move |a| in_sensor(a) == within).map(|a| a.own.clone())
    }

    fn with_states(&self) -> impl Iterator<Item = &Active<S>> {
        self.items.iter().filter(|a| !a.own.is_empty())
    }

    /// Some effect acts on this port.
    #[inline(always)]
    pub fn touches(&self, port: PortKind) -> bool {
        self.ports & (1 << port as u8) != 0
    }

    /// Nothing moves between the lever and the oil that has kinks of its own (a play that closes): a lever at rest is set in motion by what pushes it alone.
    pub fn let_the_lever_rest(&self) -> bool {
        !(self.touches(PortKind::Hydraulic) && self.states > 0)
    }

    /// Lets every effect of this port act.
    pub fn act(&self, x: &[S], dx: &mut [S], mut port: Port<'_, S>) {
        let bit = 1 << port.kind() as u8;
        for a in &self.items {
            if a.ports & bit != 0 {
                S::act(a.effect, &a.k, &x[a.own.clone()], &mut dx[a.own.clone()], &mut port);
            }
        }
    }

    /// Sets every effect's states for the plant at rest; `x`: the effects' states, in the order in which they were given.
    pub fn rest(&self, rest: &Rest<S>, x: &mut [S]) {
        for a in &self.items {
            S::rest(a.effect, &a.k, rest, &mut x[a.own.start - self.plant_states..a.own.end - self.plant_states]);
        }
    }
}
