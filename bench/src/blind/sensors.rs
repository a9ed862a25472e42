//! Sensors of many makes: an emulated rig with perfect ones, seen through errors that are drawn. What they should have shown is kept, for
//! the judge alone.

use super::plan::{Stream, chance};
use drivers::EmulatedRig;
use rand::Rng;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use rt_core::{Command, Device, DeviceError, Measurement, Tick};
use serde::{Deserialize, Serialize};

/// Errors of one sensor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Error {
    /// Standard deviation of the noise, in the channel's unit.
    pub std: f64,
    /// Time after which the noise remembers 1/e of itself, s; 0 = white.
    pub memory_s: f64,
    /// Step of the display, in the channel's unit; 0 = none.
    pub step: f64,
}

impl Error {
    const NONE: Error = Error { std: 0.0, memory_s: 0.0, step: 0.0 };
}

/// Errors of all sensors.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Encoder, degrees.
    pub angle: Error,
    /// Pressure sensors, bar.
    pub pressure: [Error; 2],
    /// Force sensor, Nm.
    pub torque: Error,
    /// One reading of the measuring cylinder, ml (standard deviation).
    pub volume_ml: f64,
}

impl Errors {
    /// Perfect sensors.
    pub const NONE: Errors =
        Errors { angle: Error::NONE, pressure: [Error::NONE; 2], torque: Error::NONE, volume_ml: 0.0 };

    /// Sensors as they are bought: most of them white, some of them filtered (coloured), most with the steps of a converter.
    pub(super) fn draw(rng: &mut impl Rng) -> Errors {
        let log = |rng: &mut _, low: f64, high: f64| in_log(rng, low, high);
        let coloured = rng.random_bool(0.4);
        let memory = |rng: &mut _| if coloured { in_log(rng, 2e-3, 20e-3) } else { 0.0 };
        let angle_steps = [0.0, 360.0 / 65536.0, 360.0 / 16384.0, 360.0 / 8192.0];
        let pressure_steps = [0.0, 10.0 / 65536.0, 10.0 / 4096.0];
        let pressure_std = log(rng, 0.003, 0.012);
        let step = pressure_steps[rng.random_range(0..pressure_steps.len())];
        let pressure = |rng: &mut _| Error { std: pressure_std * log(rng, 0.8, 1.25), memory_s: memory(rng), step };
        Errors {
            pressure: [pressure(rng), pressure(rng)],
            angle: Error {
                std: log(rng, 0.006, 0.025),
                memory_s: memory(rng),
                step: angle_steps[rng.random_range(0..angle_steps.len())],
            },
            torque: Error { std: log(rng, 0.02, 0.1), ..Error::NONE },
            volume_ml: log(rng, 0.03, 0.08),
        }
    }
}

/// A number whose logarithm is even between two bounds.
pub(super) fn in_log(rng: &mut impl Rng, low: f64, high: f64) -> f64 {
    rng.random_range(low.ln()..=high.ln()).exp()
}

/// One sensor at work.
struct Sensor {
    error: Error,
    rng: ChaCha8Rng,
    /// Its noise at the last reading, and the tick of that.
    last: Option<(u64, f64)>,
}

impl Sensor {
    fn show(&mut self, tick: u64, value: f64) -> f64 {
        let Error { std, memory_s, step } = self.error;
        let fresh: f64 = self.rng.sample(StandardNormal);
        let kept = match self.last {
            Some((before, _)) if memory_s > 0.0 => (-Tick::at(tick - before).seconds() / memory_s).exp(),
            _ => 0.0,
        };
        let noise = kept * self.last.map_or(0.0, |(_, noise)| noise) + (1.0 - kept * kept).sqrt() * std * fresh;
        self.last = Some((tick, noise));
        let shown = value + noise;
        if step > 0.0 { (shown / step).round() * step } else { shown }
    }
}

/// An emulated rig behind such sensors.
pub(super) struct Seen {
    rig: EmulatedRig,
    sensors: [Sensor; 4],
    /// Angle (deg) and pressures (bar absolute) as perfect sensors show them, one a reading.
    pub clean: Vec<[f64; 3]>,
}

impl Seen {
    /// `rig` must have perfect sensors, but for the cylinder, whose readings are its own.
    pub fn new(rig: EmulatedRig, errors: &Errors, seed: u64, run: u64) -> Self {
        let Errors { angle, pressure, torque, .. } = *errors;
        let mut number = 4 * run;
        let sensors = [angle, pressure[0], pressure[1], torque].map(|error| {
            number += 1;
            Sensor { error, rng: chance(seed, Stream::Sensors, number), last: None }
        });
        Seen { rig, sensors, clean: Vec::new() }
    }
}

impl Device for Seen {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let mut measured = self.rig.read(now)?;
        self.clean.push([measured.angle_deg, measured.pressure1_bar, measured.pressure2_bar]);
        let [angle, pressure1, pressure2, torque] = &mut self.sensors;
        measured.angle_deg = angle.show(now.index, measured.angle_deg);
        measured.pressure1_bar = pressure1.show(now.index, measured.pressure1_bar);
        measured.pressure2_bar = pressure2.show(now.index, measured.pressure2_bar);
        measured.torque_nm = torque.show(now.index, measured.torque_nm);
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.rig.write(now, command)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn series(error: Error) -> Vec<f64> {
        let mut sensor = Sensor { error, rng: chance(3, Stream::Sensors, 0), last: None };
        (0..40_000).map(|tick| sensor.show(tick, 5.0) - 5.0).collect()
    }

    fn product(v: &[f64], lag: usize) -> f64 {
        let n = v.len() - lag;
        v.iter().zip(&v[lag..]).map(|(a, b)| a * b).sum::<f64>() / n as f64
    }

    #[test]
    fn noise_has_the_size_and_the_colour_that_it_is_given() {
        let white = series(Error { std: 0.02, memory_s: 0.0, step: 0.0 });
        assert!((product(&white, 0).sqrt() / 0.02 - 1.0).abs() < 0.03);
        assert!(product(&white, 1).abs() < 0.03 * 4e-4);
        let coloured = series(Error { std: 0.02, memory_s: 5e-3, step: 0.0 });
        assert!((product(&coloured, 0).sqrt() / 0.02 - 1.0).abs() < 0.05);
        let remembered = product(&coloured, 5) / product(&coloured, 0);
        assert!((remembered - (-1.0f64).exp()).abs() < 0.05, "{remembered}");
    }

    #[test]
    fn a_display_shows_its_steps_alone() {
        let shown = series(Error { std: 0.02, memory_s: 0.0, step: 0.05 });
        assert!(shown.iter().all(|v| ((v + 5.0) / 0.05 - ((v + 5.0) / 0.05).round()).abs() < 1e-6));
        assert!(product(&shown, 0) > 1.1 * 0.02f64.powi(2), "steps add to the noise");
    }
}
