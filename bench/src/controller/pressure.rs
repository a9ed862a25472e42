//! Pressure of a chamber, or the difference of both.
//!
//! The gain is that of a held lever. A free lever gives way, slowly against the pressure: what then flows into its motion is
//! learnt by the integrator, and as pressure and flow meet at the same place, the loop stays damped.

use super::feed_forward::{Oil, Plant, Rate};
use super::pi::{Demand, Moment};
use super::seen::Seen;
use super::settings::Settings;
use rt_core::{ControlledPressure, Input};

/// What a pressure's loop remembers beside its PI.
#[derive(Clone, Copy, Debug)]
pub struct PressureLoop {
    of: ControlledPressure,
    reference: Rate,
}

impl PressureLoop {
    pub fn new(of: ControlledPressure) -> Self {
        PressureLoop { of, reference: Rate::default() }
    }

    pub fn of(&self) -> ControlledPressure {
        self.of
    }

    /// The controlled pressure, bar.
    fn value_bar(&self, seen: &Seen) -> f64 {
        match self.of {
            ControlledPressure::Chamber1 => seen.pressure1_bar,
            ControlledPressure::Chamber2 => seen.pressure2_bar,
            ControlledPressure::Difference => seen.dp_bar(),
        }
    }

    /// Oil that the pump moves for 1 bar of it while the lever stands, ml/bar; negative where it falls with the flow.
    fn capacity_ml_bar(&self, oil: &Oil) -> f64 {
        match self.of {
            ControlledPressure::Chamber1 => oil.chambers_ml_bar[0],
            ControlledPressure::Chamber2 => -oil.chambers_ml_bar[1],
            ControlledPressure::Difference => oil.series_ml_bar,
        }
    }

    /// Flow that makes up for the leaks, ml/s.
    pub fn holding_ml_s(&self, oil: &Oil) -> f64 {
        match self.of {
            ControlledPressure::Chamber1 => -oil.leaks_ml_s[0],
            ControlledPressure::Chamber2 => oil.leaks_ml_s[1],
            ControlledPressure::Difference => oil.holding_ml_s(),
        }
    }

    /// The inputs without which there is no error.
    pub fn needs(&self) -> u32 {
        match self.of {
            ControlledPressure::Chamber1 => Input::Pressure1.bit(),
            ControlledPressure::Chamber2 => Input::Pressure2.bit(),
            ControlledPressure::Difference => Input::Pressure1.bit() | Input::Pressure2.bit(),
        }
    }

    /// What the reference (bar) asks for.
    pub fn demand(&mut self, plant: &Plant, settings: &Settings, at: &Moment, bar: f64) -> Demand {
        let capacity_ml_bar = self.capacity_ml_bar(&at.oil);
        let most_bar_s = plant.most_flow_ml_s() / capacity_ml_bar.abs();
        let rate_bar_s = self.reference.per_s(at.now, bar, most_bar_s);
        let missing_ml = capacity_ml_bar * (bar - self.value_bar(at.seen));
        let close_ml = capacity_ml_bar.abs() * settings.pressure_deadband_bar;
        let feed_forward_ml_s =
            if settings.feed_forward { capacity_ml_bar * rate_bar_s + self.holding_ml_s(&at.oil) } else { 0.0 };
        Demand { feed_forward_ml_s, missing_ml, close_ml }
    }

    /// Oil that the pump must have moved between two measurements, ml.
    pub fn moved_ml(&self, oil: &Oil, before: &Seen, seen: &Seen) -> f64 {
        self.capacity_ml_bar(oil) * (self.value_bar(seen) - self.value_bar(before))
    }
}
