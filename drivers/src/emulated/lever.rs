//! A lever that is led by hand: to an angle, smoothly, at finite speed, and then held there.

/// Rate of the critically damped approach, 1/s: a lever arrives about 0.1 s behind a ramp's end.
const APPROACH_PER_S: f64 = 60.0;
/// Closer than this, and slower than [`NEAR_RAD`] a tick, the lever is put on its angle and held, rad.
const NEAR_RAD: f64 = 1e-6;

pub(super) struct LedLever {
    velocity_rad_s: f64,
    most_rad_s: f64,
}

impl LedLever {
    pub fn new(most_deg_s: f64) -> Self {
        LedLever { velocity_rad_s: 0.0, most_rad_s: most_deg_s.to_radians() }
    }

    /// The lever stands: nothing moved it during the last tick.
    pub fn stands(&self) -> bool {
        self.velocity_rad_s == 0.0
    }

    pub fn stop(&mut self) {
        self.velocity_rad_s = 0.0;
    }

    /// A free lever moves at this velocity: from here it would be led on.
    pub fn moves_at(&mut self, velocity_rad_s: f64) {
        self.velocity_rad_s = velocity_rad_s;
    }

    /// Velocity (rad/s) for the next `dt` (s), on the way from `angle_rad` to `target_rad`.
    pub fn velocity_rad_s(&mut self, angle_rad: f64, target_rad: f64, dt: f64) -> f64 {
        let way_rad = target_rad - angle_rad;
        let near = way_rad.abs() < NEAR_RAD && self.velocity_rad_s.abs() * dt < NEAR_RAD;
        self.velocity_rad_s = if way_rad == 0.0 && near {
            0.0
        } else if near {
            way_rad / dt
        } else {
            // Critically damped, implicit in the velocity: stable for any dt.
            let (w, v) = (APPROACH_PER_S, self.velocity_rad_s);
            let next = (v + dt * w * w * way_rad) / (1.0 + 2.0 * w * dt + w * w * dt * dt);
            // The approach itself never brakes harder than this, so the limit softens the start alone.
            let change = 2.0 * w * self.most_rad_s * dt;
            next.clamp(v - change, v + change).clamp(-self.most_rad_s, self.most_rad_s)
        };
        self.velocity_rad_s
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arrives_smoothly_within_its_speed_and_then_stands_exactly() {
        let mut lever = LedLever::new(20.0);
        let (mut angle, target) = (-0.3_f64, 0.4_f64);
        let mut before = 0.0;
        let mut ticks = 0;
        loop {
            let velocity = lever.velocity_rad_s(angle, target, 1e-3);
            assert!(velocity.abs() <= 20.0_f64.to_radians() + 1e-12);
            assert!((velocity - before).abs() <= 0.06, "a jump from {before} to {velocity} rad/s");
            angle += 1e-3 * velocity;
            assert!(angle <= target + 1e-9, "beyond its target");
            before = velocity;
            ticks += 1;
            if lever.stands() {
                break;
            }
            assert!(ticks < 10_000);
        }
        // 40 degrees at 20 degrees a second, and the approach.
        assert!((2000..2500).contains(&ticks), "{ticks}");
        assert!((angle - target).abs() < 1e-12);
    }
}
