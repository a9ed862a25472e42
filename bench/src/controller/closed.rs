//! The closed loops: one at a time, for the quantity that the profile asks for.

use super::angle::{self, AngleLoop};
use super::constant_flow::voltage_with_rest;
use super::effects::KnownEffects;
use super::feed_forward::{Oil, Plant};
use super::pi::{Demand, Moment, Pi, Rates};
use super::pressure::PressureLoop;
use super::seen::Seen;
use super::settings::{ControllerError, Settings};
use model::Parameters;
use model::parameters::Pump;
use rt_core::{ControlledPressure, Input, Measurement, Tick};

/// A pump that turns is let turn down to this share of the flow at which it would be started.
const REST_SHARE_IF_IT_TURNS: f64 = 0.5;

/// What a loop is closed around, with its reference.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Goal {
    /// Angle of the free lever.
    Angle {
        /// Degrees.
        angle_deg: f64,
        /// Degrees per second.
        velocity_deg_s: f64,
    },
    /// A pressure.
    Pressure {
        /// Which one.
        of: ControlledPressure,
        /// Bar.
        bar: f64,
    },
}

/// The loop that is closed around a kind of goal.
#[derive(Clone, Copy, Debug)]
enum Around {
    Angle(AngleLoop),
    Pressure(PressureLoop),
}

impl Around {
    fn new(goal: Goal) -> Self {
        match goal {
            Goal::Angle { .. } => Around::Angle(AngleLoop::default()),
            Goal::Pressure { of, .. } => Around::Pressure(PressureLoop::new(of)),
        }
    }

    fn serves(&self, goal: Goal) -> bool {
        match (self, goal) {
            (Around::Angle(_), Goal::Angle { .. }) => true,
            (Around::Pressure(pressure), Goal::Pressure { of, .. }) => pressure.of() == of,
            _ => false,
        }
    }

    /// The inputs without which there is no error.
    fn needs(&self) -> u32 {
        match self {
            Around::Angle(_) => Input::Angle.bit(),
            Around::Pressure(pressure) => pressure.needs(),
        }
    }

    fn rates(&self, settings: &Settings) -> Rates {
        match self {
            Around::Angle(_) => Rates::from_hz(settings.angle_bandwidth_hz, settings.angle_integral_hz),
            Around::Pressure(_) => Rates::from_hz(settings.pressure_bandwidth_hz, settings.pressure_integral_hz),
        }
    }

    fn demand(&mut self, plant: &Plant, settings: &Settings, at: &Moment, goal: Goal) -> Demand {
        match (self, goal) {
            (Around::Angle(angle), Goal::Angle { angle_deg, velocity_deg_s }) => {
                angle.demand(plant, settings, at, angle_deg, velocity_deg_s)
            }
            (Around::Pressure(pressure), Goal::Pressure { bar, .. }) => pressure.demand(plant, settings, at, bar),
            _ => unreachable!("a loop is asked only for goals that it serves"),
        }
    }

    /// Flow that makes up for the leaks that the model knows, ml/s.
    fn holding_ml_s(&self, oil: &Oil) -> f64 {
        match self {
            Around::Angle(_) => oil.holding_ml_s(),
            Around::Pressure(pressure) => pressure.holding_ml_s(oil),
        }
    }

    /// Oil that the pump must have moved between two measurements, ml.
    fn moved_ml(&self, oil: &Oil, before: &Seen, seen: &Seen) -> f64 {
        match self {
            Around::Angle(_) => angle::moved_ml(oil, before, seen),
            Around::Pressure(pressure) => pressure.moved_ml(oil, before, seen),
        }
    }
}

/// The loop in action, as it was left at the last tick at which it had what it needs.
#[derive(Clone, Copy, Debug)]
struct Closed {
    around: Around,
    pi: Pi,
    then: Tick,
    before: Seen,
    /// What the pump was set to deliver, ml/s.
    delivered_ml_s: f64,
    /// The pump was set to turn.
    turns: bool,
}

/// Angle and pressure control with an identified model.
#[derive(Clone, Debug)]
pub struct ClosedLoops {
    plant: Plant,
    pump: Pump,
    settings: Settings,
    closed: Option<Closed>,
}

impl ClosedLoops {
    /// Loops for the rig that this model describes.
    pub fn new(parameters: &Parameters, effects: KnownEffects, settings: Settings) -> Result<Self, ControllerError> {
        let plant = Plant::new(parameters, effects, settings.vertical)?;
        settings.validate(&plant)?;
        Ok(ClosedLoops { plant, pump: parameters.pump, settings, closed: None })
    }

    /// Nothing is controlled at this tick; the next goal finds its loop open.
    pub fn open(&mut self) {
        self.closed = None;
    }

    /// Voltage for this tick, V. `acting_v` is the one before: it is held where a measurement is missing, and a loop that is
    /// closed at this tick begins with its flow.
    pub fn voltage_v(&mut self, now: Tick, measured: &Measurement, seen: &Seen, goal: Goal, acting_v: f64) -> f64 {
        let ClosedLoops { plant, pump, settings, closed } = self;
        *closed = closed.filter(|closed| closed.around.serves(goal));
        let mut around = closed.map_or_else(|| Around::new(goal), |closed| closed.around);
        if !seen.complete() || measured.valid() & around.needs() != around.needs() {
            return acting_v;
        }
        let rates = around.rates(settings);
        let (pressure_bar, dp_bar) = (seen.pressure_bar(), seen.dp_bar());
        let then = closed.map_or(now, |closed| closed.then);
        let elapsed_s = now.scheduled_ns.saturating_sub(then.scheduled_ns) as f64 * 1e-9;
        let time_s = now.seconds();
        let oil = plant.oil(time_s, seen);
        let demand = around.demand(plant, settings, &Moment { now, seen, oil }, goal);
        let pi = match closed {
            Some(closed) => {
                // what the feed-forward makes up for is not learnt again
                let known_ml_s = if settings.feed_forward { around.holding_ml_s(&oil) } else { 0.0 };
                let moved_ml = around.moved_ml(&oil, &closed.before, seen) + known_ml_s * elapsed_s;
                closed.pi.learn(elapsed_s, closed.delivered_ml_s, moved_ml, demand, rates);
                closed.pi
            }
            None => Pi::closed_at(plant.flow_ml_s(time_s, acting_v, pressure_bar), demand, rates),
        };
        let flow_ml_s = pi.flow_ml_s(demand, rates);
        let rest_share = if closed.is_some_and(|closed| closed.turns) { REST_SHARE_IF_IT_TURNS } else { 1.0 };
        let inverse = |flow_ml_s| voltage_with_rest(pump, flow_ml_s, dp_bar, rest_share * settings.rest_flow_ml_s);
        let voltage_v = plant.voltage_v(time_s, flow_ml_s, pressure_bar, inverse);
        let delivered_ml_s =
            if settings.anti_windup { plant.flow_ml_s(time_s, voltage_v, pressure_bar) } else { flow_ml_s };
        *closed = Some(Closed { around, pi, then: now, before: *seen, delivered_ml_s, turns: voltage_v != 0.0 });
        voltage_v
    }
}
