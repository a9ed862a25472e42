//! A campaign in memory: the real loop in virtual time on an emulated rig behind drawn sensors, without shared memory and without a file.

use super::plan::{Stream, chance};
use super::rig::{Rig, Truth};
use super::scripts::scripts;
use super::sensors::Seen;
use crate::failure::{Failure, Kind};
use crate::runner::judge;
use crate::setup::Knowledge;
use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings};
use identify::component::{fit_pump, pump_points};
use identify::identification::Loaded;
use model::{ModelFile, Parameters};
use profiles::{Context, Hands, Plane, Script};
use rand::Rng;
use recordings::{Campaign, Protocol, Recording, RigFacts, RunEntry, UnknownWord};
use rt_core::{Clock, Limits, Run, Sample, Stages, Supervisor, Tick, Wake};
use std::path::PathBuf;
use std::str::FromStr;

/// The sealed campaign, and what its sensors should have shown.
pub struct Recorded {
    /// All that a diagnosis may see.
    pub loaded: Loaded,
    /// By run and row: angle (deg) and pressures (bar absolute) without the sensors' errors.
    pub clean: Vec<Vec<[f64; 3]>>,
    /// Rig time of all runs, s.
    pub seconds: f64,
}

/// Runs the case's experiments on a rig with these parameters and effects.
///
/// # Errors
/// The rig can't run them: no equilibrium, a trip, a pump that delivers nothing.
pub fn record(truth: &Truth, rig: &Rig, seed: u64, case: usize) -> Result<Recorded, Failure> {
    let load = truth.parameters.load;
    let u_max_v = truth.parameters.pump.u_max;
    let facts = RigFacts { inertia_kg_m2: load.J, gravity_nm: load.G, u_max_v };
    let mut knowledge = Knowledge::Nothing;
    let mut entries = Vec::new();
    let mut recordings: Vec<Recording> = Vec::new();
    let mut clean = Vec::new();
    let own_seed = chance(seed, Stream::Sensors, case as u64).random();
    for (number, script) in scripts(rig, seed, case)?.iter().enumerate() {
        let entry = entry(script).map_err(|e| Failure::of(Kind::Internal, &e))?;
        let (recording, shown) = run(script, truth, rig, own_seed, number as u32, &knowledge)?;
        if entry.protocol == Protocol::PumpMap {
            knowledge = Knowledge::Pump(measured_pump(&recording, u_max_v)?);
        }
        entries.push(entry);
        recordings.push(recording);
        clean.push(shown);
    }
    let seconds = recordings.iter().filter_map(|r| r.time_s.last()).sum();
    // A folder that is not there: the name alone is said in messages.
    let dir = PathBuf::from(format!("blind-case-{case}"));
    let campaign = Campaign { dir, name: format!("blind case {case}"), rig: facts, runs: entries };
    Ok(Recorded { loaded: Loaded::from_recordings(campaign, recordings), clean, seconds })
}

fn run(
    script: &Script,
    truth: &Truth,
    rig: &Rig,
    seed: u64,
    number: u32,
    knowledge: &Knowledge,
) -> Result<(Recording, Vec<[f64; 3]>), Failure> {
    let input = |e: &dyn std::error::Error| Failure::of(Kind::Input, e);
    let context = Context { u_max_v: truth.parameters.pump.u_max, seed, hands: Hands::Rig };
    let mut playback = script.compile(&context).map_err(|e| input(&e))?;
    let mut controller = knowledge.controller(script.plane)?;
    let settings = Settings {
        start: script.start(),
        fill_bar: script.fill_bar.unwrap_or(rig.fill_bar),
        vertical: script.plane == Plane::Vertical,
        seed: seed.wrapping_add(u64::from(number)),
        noise: Noise { volume_ml: rig.errors.volume_ml, ..Noise::NONE },
        ..Settings::default()
    };
    let emulated =
        EmulatedRig::new(&truth.parameters, truth.effect_set(), settings).map_err(|e| Failure::of(Kind::Device, &e))?;
    let mut device = Seen::new(emulated, &rig.errors, seed, u64::from(number));
    // The emulated chambers neither burst nor cavitate; what an unusual rig reaches is no reason to stop.
    let limits = Limits { pressure_min_bar: 0.2, pressure_max_bar: 12.0, angle_max_deg: 75.0, ..Limits::default() };
    let mut supervisor = Supervisor::new(limits).map_err(|e| input(&e))?;
    let free = matches!(
        script.protocol,
        profiles::Protocol::ConstantFlow | profiles::Protocol::SquareWave | profiles::Protocol::RandomSteps
    );
    let mut clock = Sparse { every: if free { rig.free_every } else { rig.bench_every }, now_ns: 0 };
    let mut samples: Vec<Sample> = Vec::new();
    let (mut flight, _log) = rt_core::flight::recorder();
    let stages = Stages {
        clock: &mut clock,
        device: &mut device,
        operator: &mut (),
        supervisor: &mut supervisor,
        reference: &mut playback,
        controller: &mut *controller,
        publish: &mut samples,
        flight: &mut flight,
    };
    let report =
        rt_core::run(stages, Run { number, overrun: script.overrun }).map_err(|e| Failure::of(Kind::Device, &e))?;
    judge(&script.name, &report)?;
    Ok((Recording::of_samples(&samples), device.clean))
}

/// Virtual time in which only every so many ticks take place: a loop of a slower rig.
struct Sparse {
    every: u64,
    now_ns: u64,
}

impl Clock for Sparse {
    fn start(&mut self) {
        self.now_ns = 0;
    }

    fn wait(&mut self, index: u64) -> Wake {
        let tick = Tick::at(index.next_multiple_of(self.every));
        self.now_ns = tick.scheduled_ns;
        Wake { tick, woken_ns: 0, lateness_ns: 0, behind_ns: 0 }
    }

    fn now_ns(&mut self) -> u64 {
        self.now_ns
    }
}

fn entry(script: &Script) -> Result<RunEntry, UnknownWord> {
    Ok(RunEntry {
        file: format!("{}.csv.gz", script.name),
        protocol: FromStr::from_str(script.protocol.as_str())?,
        role: FromStr::from_str(script.role.as_str())?,
        plane: FromStr::from_str(script.plane.as_str())?,
    })
}

/// The example with the pump's parameters from its map, for the strokes at constant flow.
fn measured_pump(map: &Recording, u_max_v: f64) -> Result<ModelFile, Failure> {
    let mut parameters = Parameters::example();
    parameters.pump.u_max = u_max_v;
    if fit_pump(&pump_points(map), &mut parameters) {
        Ok(ModelFile::plain(parameters))
    } else {
        Err(Failure::new(Kind::Acceptance, "the drawn pump's map does not fit eq. (10): no flow can be commanded"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::blind::rig::draw;

    #[test]
    fn a_slow_rig_is_sampled_at_its_own_ticks_and_gives_a_campaign() {
        let rig = Rig { free_every: 4, bench_every: 2, length: 0.0, ..draw(1, 0, 0) };
        let truth = Truth { parameters: rig.parameters, effects: Vec::new() };
        let recorded = record(&truth, &rig, 1, 0).expect("a rig that runs");
        let runs = &recorded.loaded.runs;
        let spacing = |name: &str| {
            let run = runs.iter().find(|r| r.entry.file.starts_with(name)).expect("the run");
            let time_s = &run.recording.time_s;
            assert!(time_s.windows(2).all(|w| (w[1] - w[0] - (time_s[1] - time_s[0])).abs() < 1e-9));
            time_s[1] - time_s[0]
        };
        assert!((spacing("random_a") - 4e-3).abs() < 1e-9);
        let random_a = runs.iter().find(|r| r.entry.file.starts_with("random_a")).expect("the run");
        assert_eq!(
            random_a.recording.bypass_open.last(),
            Some(&true),
            "its end tells of the bypass, whatever was drawn"
        );
        assert!((spacing("pump_map") - 2e-3).abs() < 1e-9);
        for (run, clean) in runs.iter().zip(&recorded.clean) {
            assert_eq!(run.recording.len(), clean.len(), "{}", run.entry.file);
        }
        let volumes = runs[2].recording.volume_ml.iter().filter(|v| v.is_finite()).count();
        assert!(volumes > 100, "the cylinder is read on the bench, got {volumes}");
        assert!((120.0..900.0).contains(&recorded.seconds), "{}", recorded.seconds);
    }

    #[test]
    fn a_case_is_the_same_each_time() {
        let rig = draw(2, 3, 0);
        let truth = Truth { parameters: rig.parameters, effects: Vec::new() };
        let [one, two] = [0, 1].map(|_| record(&truth, &rig, 2, 3).expect("a rig that runs"));
        let bits = |r: &Recorded| {
            let runs = r.loaded.runs.iter().map(|r| &r.recording);
            runs.flat_map(|r| r.angle_deg.iter().chain(&r.pressure1_bar)).map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        assert_eq!(bits(&one), bits(&two));
        let other = record(&truth, &rig, 3, 3).expect("a rig that runs");
        assert_ne!(bits(&one), bits(&other), "another seed draws other noise");
    }
}
