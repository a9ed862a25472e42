//! The sensors' noise and steps.

use super::settings::Noise;
use super::{rng, stream};
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rt_core::Measurement;

pub(super) struct Sensors {
    noise: Noise,
    angle: ChaCha8Rng,
    pressure: [ChaCha8Rng; 2],
    torque: ChaCha8Rng,
}

impl Sensors {
    pub fn new(seed: u64, noise: &Noise) -> Self {
        Sensors {
            noise: *noise,
            angle: rng(seed, stream::ANGLE),
            pressure: [rng(seed, stream::PRESSURE1), rng(seed, stream::PRESSURE2)],
            torque: rng(seed, stream::TORQUE),
        }
    }

    /// A measurement of angle (degrees) and pressures (bar absolute) as the plant's sensors show them, and of the torque (Nm); NaN =
    /// not measured. Every sensor draws at every tick, so that what one shows does not depend on another.
    pub fn show(&mut self, shown: [f64; 3], on_bench: bool, torque_nm: f64, volume_ml: f64) -> Measurement {
        let Noise { encoder_step_deg, angle_deg, pressure_bar, torque_nm: torque_noise_nm, .. } = self.noise;
        let angle = shown[0] + angle_deg * normal(&mut self.angle);
        let angle = if encoder_step_deg > 0.0 { (angle / encoder_step_deg).round() * encoder_step_deg } else { angle };
        Measurement {
            angle_deg: if on_bench { f64::NAN } else { angle },
            pressure1_bar: shown[1] + pressure_bar * normal(&mut self.pressure[0]),
            pressure2_bar: shown[2] + pressure_bar * normal(&mut self.pressure[1]),
            torque_nm: torque_nm + torque_noise_nm * normal(&mut self.torque),
            volume_ml,
            ..Measurement::NONE
        }
    }
}

fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}
