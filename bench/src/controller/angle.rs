//! Angle of a free lever.
//!
//! The integrator's oil is that of the lever's way and that which the chambers store while the lever lags behind or sticks: to
//! push harder and harder against friction is not its business, so it does not make the lever jump to and fro.

use super::feed_forward::{Oil, Plant, Rate};
use super::pi::{Demand, Moment};
use super::seen::Seen;
use super::settings::Settings;

/// What the angle's loop remembers beside its PI.
#[derive(Clone, Copy, Debug, Default)]
pub struct AngleLoop {
    /// Of the pressure difference that the reference asks for.
    equilibrium: Rate,
}

impl AngleLoop {
    /// What the reference (degrees, degrees per second) asks for.
    pub fn demand(
        &mut self,
        plant: &Plant,
        settings: &Settings,
        at: &Moment,
        angle_deg: f64,
        velocity_deg_s: f64,
    ) -> Demand {
        let Oil { angle_ml_deg, series_ml_bar, .. } = at.oil;
        let feed_forward_ml_s = if settings.feed_forward {
            let most_bar_s = plant.most_flow_ml_s() / series_ml_bar;
            let sum_bar = at.seen.pressure1_bar + at.seen.pressure2_bar;
            let equilibrium_bar = plant.equilibrium_dp_bar(at.now.seconds(), angle_deg, velocity_deg_s, sum_bar);
            let rate_bar_s = self.equilibrium.per_s(at.now, equilibrium_bar, most_bar_s);
            angle_ml_deg * velocity_deg_s + series_ml_bar * rate_bar_s + at.oil.holding_ml_s()
        } else {
            0.0
        };
        Demand {
            feed_forward_ml_s,
            missing_ml: angle_ml_deg * (angle_deg - at.seen.angle_deg),
            close_ml: angle_ml_deg * settings.angle_deadband_deg,
        }
    }
}

/// Oil that the pump must have moved between two measurements, ml.
pub fn moved_ml(oil: &Oil, before: &Seen, seen: &Seen) -> f64 {
    oil.angle_ml_deg * (seen.angle_deg - before.angle_deg) + oil.series_ml_bar * (seen.dp_bar() - before.dp_bar())
}
