//! The lever's ramp under a `driven` fixture.

use crate::values::{MAX_HOLD_S, ticks_at_least};
use rt_core::{Fixture, Tick};

/// From where the lever stood to where it is led.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Ramp {
    pub from_deg: f64,
    pub to_deg: f64,
    pub rate_deg_s: f64,
}

impl Ramp {
    /// What is commanded so many ticks after it began.
    pub fn fixture(&self, ticks: u64) -> Fixture {
        let way_deg = self.to_deg - self.from_deg;
        let done_deg = self.rate_deg_s * Tick::at(ticks).seconds();
        let arrived = done_deg >= way_deg.abs();
        Fixture::Driven { angle_deg: if arrived { self.to_deg } else { self.from_deg + done_deg.copysign(way_deg) } }
    }

    /// Ticks up to the one that commands the end. The way itself decides: a lever may stand where no script would lead it.
    pub fn ticks(&self) -> u64 {
        let way_s = (self.to_deg - self.from_deg).abs() / self.rate_deg_s;
        // So far away is only what no encoder reads; its ticks must be a number all the same.
        ticks_at_least(way_s.min(MAX_HOLD_S)) + 1
    }
}

/// The angle at which the lever was told to be.
pub(crate) fn commanded_deg(fixture: &Fixture) -> Option<f64> {
    match *fixture {
        Fixture::Clamped { angle_deg }
        | Fixture::Driven { angle_deg }
        | Fixture::Filled { angle_deg, .. }
        | Fixture::Released { angle_deg, .. } => Some(angle_deg),
        Fixture::Free | Fixture::PumpBench { .. } => None,
    }
}
