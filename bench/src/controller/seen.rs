//! The last valid measurements: they bridge ticks at which one is missing.

use rt_core::{Input, Measurement};

/// The last valid angle and pressures; NaN before the first.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Degrees.
    pub angle_deg: f64,
    /// Bar absolute.
    pub pressure1_bar: f64,
    /// Bar absolute.
    pub pressure2_bar: f64,
}

impl Seen {
    /// Nothing was measured yet.
    pub const NOTHING: Seen = Seen { angle_deg: f64::NAN, pressure1_bar: f64::NAN, pressure2_bar: f64::NAN };

    /// Takes over what is there and sound.
    pub fn update(&mut self, measured: &Measurement) {
        for (input, value) in [
            (Input::Angle, &mut self.angle_deg),
            (Input::Pressure1, &mut self.pressure1_bar),
            (Input::Pressure2, &mut self.pressure2_bar),
        ] {
            if measured.is_valid(input) {
                *value = measured.value(input);
            }
        }
    }

    /// p1 and p2, bar absolute.
    pub fn pressure_bar(&self) -> [f64; 2] {
        [self.pressure1_bar, self.pressure2_bar]
    }

    /// p1 - p2, bar.
    pub fn dp_bar(&self) -> f64 {
        self.pressure1_bar - self.pressure2_bar
    }

    /// Everything was measured at least once.
    pub fn complete(&self) -> bool {
        self.angle_deg.is_finite() && self.dp_bar().is_finite()
    }
}
