//! Guided simulation: a lever and pressures that follow what was measured, as an observer does (Luenberger, IEEE Trans. Mil. Electron. 8, 1964).
//!
//! A free run of a model that lacks an effect soon is elsewhere than the rig was: its lever sticks at other angles, reverses at other times, and the
//! misfit says little of the effect. A simulation that is drawn back to what was measured stays where the rig was; what a model lacks then shows
//! where and when it acts, and the misfit has few false minima. It is a way to a start, never a measure: every fit ends in free run.

use model::rec::state;

use crate::prepare::Channel;

/// How fast a guided simulation goes back to what was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Guide {
    /// Time constants of the double pole of the lever's error, s.
    pub lever_s: f64,
    /// Time constant of a pressure's error, s.
    pub pressure_s: f64,
}

/// One state that is drawn along with the error of one channel.
pub struct Pull {
    /// What is compared.
    pub channel: Channel,
    /// The state.
    pub state: usize,
    /// Its change at a row, in its unit, per unit of the channel's error.
    pub gain: f64,
}

impl Guide {
    /// What is drawn at a row that is followed by the next after `dt` seconds.
    pub fn pulls(&self, dt: f64) -> [Pull; 4] {
        let degree = std::f64::consts::PI / 180.0;
        let kept = (-dt / self.lever_s).exp();
        // poles of the discrete observer of a double integrator: both at `kept`
        let (angle, velocity) = (1.0 - kept * kept, (1.0 - kept).powi(2) / dt);
        let pressure = 1.0 - (-dt / self.pressure_s).exp();
        let pull = |channel, state, gain| Pull { channel, state, gain };
        [
            pull(Channel::Angle, state::ANGLE, angle * degree),
            pull(Channel::Angle, state::VELOCITY, velocity * degree),
            pull(Channel::Pressure1, state::PRESSURE1, pressure),
            pull(Channel::Pressure2, state::PRESSURE2, pressure),
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Error of angle (rad) and velocity (rad/s) of a body free of torque after some rows.
    fn error_after(seconds: f64, dt: f64) -> [f64; 2] {
        let [angle, velocity, ..] = Guide { lever_s: 0.1, pressure_s: 0.5 }.pulls(dt);
        let mut e = [1.0, 0.0];
        for _ in 0..(seconds / dt) as usize {
            let shown_deg = e[0] * 180.0 / std::f64::consts::PI;
            e = [e[0] - angle.gain * shown_deg, e[1] - velocity.gain * shown_deg];
            e[0] += e[1] * dt;
        }
        e
    }

    #[test]
    fn an_error_dies_with_the_time_constant_whatever_the_rate() {
        for dt in [1e-3, 4e-3, 2e-2] {
            let [angle, velocity] = error_after(1.0, dt);
            // (1 - t/tau) exp(-t/tau) after ten time constants
            let expected = 9.0 * (-10.0f64).exp();
            assert!((angle.abs() / expected - 1.0).abs() < 0.4, "{dt}: {angle} {expected}");
            assert!(velocity.abs() < 0.02, "{velocity}");
        }
    }
}
