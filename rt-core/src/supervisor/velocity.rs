//! Velocity of the lever from the differences of its angles.

use super::VELOCITY_WINDOW_MAX;
use crate::types::Tick;

/// The last angles of the free lever, in fixed memory.
#[derive(Clone, Debug)]
pub(super) struct VelocityWindow {
    angles: [(u64, f64); VELOCITY_WINDOW_MAX],
    count: usize,
}

impl Default for VelocityWindow {
    fn default() -> Self {
        VelocityWindow { angles: [(0, 0.0); VELOCITY_WINDOW_MAX], count: 0 }
    }
}

impl VelocityWindow {
    pub fn clear(&mut self) {
        self.count = 0;
    }

    /// Adds an angle; the mean velocity since `window` angles ago, deg/s, once there are that many.
    pub fn push(&mut self, now: Tick, angle_deg: f64, window: usize) -> Option<f64> {
        // With one slot per angle of the window, the slot to be overwritten is the angle `window` pushes ago.
        let slot = self.count % window;
        let (then_ns, then_deg) = self.angles[slot];
        self.angles[slot] = (now.scheduled_ns, angle_deg);
        let full = self.count >= window;
        self.count += 1;
        let elapsed_s = now.scheduled_ns.saturating_sub(then_ns) as f64 * 1e-9;
        (full && elapsed_s > 0.0).then(|| (angle_deg - then_deg) / elapsed_s)
    }
}
