//! A whole campaign in memory: every built-in experiment through the real loop on the emulated rig, in virtual time.

use bench::controller::PumpController;
use bench::emulation::draw_plain;
use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings};
use identify::identification::Loaded;
use model::Parameters;
use model::effects::EffectSet;
use profiles::{BUILTIN, Context, Hands, Plane, Script};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use recordings::{Campaign, Recording, RigFacts, RunEntry};
use rt_core::{Ended, Limits, Lockstep, OverrunPolicy, Run, Sample, Stages, Supervisor};
use std::error::Error;
use std::str::FromStr;

/// A rig without any effect. The same seed gives the same rig.
pub fn draw(seed: u64) -> Parameters {
    draw_plain(&mut ChaCha8Rng::seed_from_u64(seed))
}

/// Runs every built-in experiment on this rig. The controller knows the rig's own pump, as after a pump map.
///
/// # Errors
/// A run did not come to its end.
pub fn record(truth: &Parameters, noise: Noise, seed: u64) -> Result<Loaded, Box<dyn Error>> {
    let (campaign, recordings) = recorded(truth, noise, seed)?;
    Ok(Loaded::from_recordings(campaign, recordings))
}

/// As [`record`], before anything is made of the recordings.
///
/// # Errors
/// As there.
pub fn recorded(truth: &Parameters, noise: Noise, seed: u64) -> Result<(Campaign, Vec<Recording>), Box<dyn Error>> {
    let mut runs = Vec::new();
    let mut recordings = Vec::new();
    for (number, (file, text)) in BUILTIN.iter().enumerate() {
        let script = Script::parse(text, file)?;
        let run_seed = seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(number as u64);
        recordings.push(Recording::of_samples(&run(truth, &script, noise, run_seed)?));
        runs.push(RunEntry {
            file: format!("{}.mcap", script.name),
            protocol: FromStr::from_str(script.protocol.as_str())?,
            role: FromStr::from_str(script.role.as_str())?,
            plane: FromStr::from_str(script.plane.as_str())?,
        });
    }
    let rig = RigFacts { inertia_kg_m2: truth.load.J, gravity_nm: truth.load.G, u_max_v: truth.pump.u_max };
    let campaign = Campaign { dir: "memory".into(), name: format!("emulated rig, seed {seed}"), rig, runs };
    Ok((campaign, recordings))
}

/// Spoils this share of the samples of every measured channel: spikes, dropouts (to 0 or to nothing) and values that stand
/// still, a third each.
pub fn corrupt(r: &mut Recording, share: f64, seed: u64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let rows = r.len();
    let channels = [
        (&mut r.angle_deg, 5.0),
        (&mut r.pressure1_bar, 1.0),
        (&mut r.pressure2_bar, 1.0),
        (&mut r.torque_nm, 5.0),
        (&mut r.volume_ml, 5.0),
    ];
    for (values, size) in channels {
        let present = values.iter().filter(|v| v.is_finite()).count();
        let third = (share * present as f64 / 3.0) as usize;
        // a column with a value here and there is spoilt value by value
        let sparse = present * 5 < rows;
        let mut at = |length: usize| -> Vec<usize> {
            let first = rng.random_range(0..rows.saturating_sub(length).max(1));
            (first..(first + length).min(rows)).filter(|&i| values[i].is_finite()).collect()
        };
        let mut spoilt = [Vec::new(), Vec::new(), Vec::new()];
        for (kind, rows_of) in spoilt.iter_mut().enumerate() {
            let length = if kind == 0 || sparse { 1 } else { 25 };
            let mut count = 0;
            for _ in 0..200 * (third + 1) {
                if count >= third {
                    break;
                }
                let own = at(length);
                count += own.len();
                rows_of.push(own);
            }
        }
        let [spikes, dropouts, still] = spoilt;
        for i in spikes.into_iter().flatten() {
            let by = size * rng.random_range(0.2..2.0);
            values[i] += if rng.random::<bool>() { by } else { -by };
        }
        for (n, rows) in dropouts.into_iter().enumerate() {
            rows.into_iter().for_each(|i| values[i] = if n % 2 == 0 { 0.0 } else { f64::NAN });
        }
        for rows in still.into_iter().filter(|rows| rows.len() > 1) {
            let held = values[rows[0]];
            rows.into_iter().for_each(|i| values[i] = held);
        }
    }
}

fn run(truth: &Parameters, script: &Script, noise: Noise, seed: u64) -> Result<Vec<Sample>, Box<dyn Error>> {
    let defaults = Settings::default();
    let settings = Settings {
        start: script.start(),
        fill_bar: script.fill_bar.unwrap_or(defaults.fill_bar),
        vertical: script.plane == Plane::Vertical,
        seed,
        noise,
        ..defaults
    };
    let mut rig = EmulatedRig::new(truth, EffectSet::none(), settings)?;
    let mut reference = script.compile(&Context { u_max_v: truth.pump.u_max, seed, hands: Hands::Rig })?;
    let mut controller = PumpController::with_pump(truth.pump);
    // the emulated chambers neither burst nor cavitate at the edge of what the profiles reach
    let mut supervisor = Supervisor::new(Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() })?;
    let (mut flight, _incidents) = rt_core::flight::recorder();
    let mut samples: Vec<Sample> = Vec::new();
    let stages = Stages {
        clock: &mut Lockstep::default(),
        device: &mut rig,
        operator: &mut (),
        supervisor: &mut supervisor,
        reference: &mut reference,
        controller: &mut controller,
        publish: &mut samples,
        flight: &mut flight,
    };
    let report = rt_core::run(stages, Run { number: 0, overrun: OverrunPolicy::Skip })?;
    if report.ended != Ended::Completed {
        return Err(format!("{}: {report}", script.name).into());
    }
    Ok(samples)
}

/// The samples as columns. In virtual time every value is of its own tick.
#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drawn_rig_has_continuous_losses_and_a_seed_of_its_own() {
        assert_eq!(draw(3), draw(3));
        let (a, b) = (draw(1), draw(2));
        assert_ne!(a.torque, b.torque);
        let l = a.losses;
        assert!((l.l4 * l.a - (l.l1 * l.a * l.a + l.l2 * l.a + l.l3)).abs() < 1e-12);
        assert_eq!((a.load, a.capacity.a2), (Parameters::example().load, 0.0));
    }
}
