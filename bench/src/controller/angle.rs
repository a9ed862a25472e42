//! Angle of a free lever.
//!
//! Oil that the chambers store while the lever lags behind (friction, its own mass) is counted as moved: without, the loop
//! would push until the lever jumps. In the long run only the angle counts, so this share is let go of, slower than the loop
//! corrects (in hydraulics: dynamic pressure feedback).

use super::feed_forward::{Plant, Rate};
use super::pi::{Demand, Instant, decay};
use super::seen::Seen;
use super::settings::Settings;

/// The stored share is let go of at this part of the loop's bandwidth.
const LETTING_GO_SHARE: f64 = 0.25;

/// What the angle's loop remembers beside its PI.
#[derive(Clone, Copy, Debug, Default)]
pub struct AngleLoop {
    /// Of the pressure difference that the reference asks for.
    equilibrium: Rate,
    /// The lasting part of what the pressure difference is beyond that, bar.
    lasting_bar: Option<f64>,
}

impl AngleLoop {
    /// What the reference (degrees, degrees per second) asks for.
    pub fn demand(
        &mut self,
        plant: &Plant,
        settings: &Settings,
        at: &Instant,
        angle_deg: f64,
        velocity_deg_s: f64,
    ) -> Demand {
        let displacement_ml_deg = plant.displacement_ml_deg(at.seen);
        let capacity_ml_bar = plant.series_capacity_ml_bar(at.seen);
        let (equilibrium_bar, feed_forward_ml_s) = if settings.feed_forward {
            let bar = plant.equilibrium_dp_bar(angle_deg, velocity_deg_s);
            let most_bar_s = plant.most_flow_ml_s() / capacity_ml_bar;
            let rate_bar_s = self.equilibrium.per_s(at.now, bar, most_bar_s);
            (bar, displacement_ml_deg * velocity_deg_s + capacity_ml_bar * rate_bar_s)
        } else {
            (0.0, 0.0)
        };
        let excess_bar = at.seen.dp_bar() - equilibrium_bar;
        let lasting_bar = self.lasting_bar.get_or_insert(excess_bar);
        let let_go = 1.0 - decay(LETTING_GO_SHARE * at.rates.kp_per_s, at.elapsed_s);
        *lasting_bar += let_go * (excess_bar - *lasting_bar);
        let stored_ml = capacity_ml_bar * (excess_bar - *lasting_bar);
        let missing_ml = displacement_ml_deg * (angle_deg - at.seen.angle_deg) - stored_ml;
        let close_ml = displacement_ml_deg * settings.angle_deadband_deg;
        Demand { feed_forward_ml_s, missing_ml, close_ml }
    }
}

/// Oil that the pump must have moved between two measurements, ml.
pub fn moved_ml(plant: &Plant, before: &Seen, seen: &Seen) -> f64 {
    plant.displacement_ml_deg(seen) * (seen.angle_deg - before.angle_deg)
        + plant.series_capacity_ml_bar(seen) * (seen.dp_bar() - before.dp_bar())
}
