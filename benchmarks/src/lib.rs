//! What the benchmarks have in common: the emulated rig with a built-in profile, and a run of it in virtual time.
//!
//! | command | measures |
//! |---|---|
//! | `cargo run --release -p benchmarks --bin lockstep` | times real time in virtual time, without subscribers and with the recording logger; memory over an hour |
//! | `cargo run --release -p benchmarks --bin recording` | an hour of samples: cost of writing, size, samples read a second, rows exported a second, memory |
//! | `cargo run --release -p benchmarks --bin instructions` | instructions of a tick, in all and by stage (callgrind) |
//! | `cargo run --release -p benchmarks --bin serial_wire` | age of the newest report over a serial port, beside the bare port |
//! | `cargo run --release -p benchmarks --bin can_wire` | age of the newest sample over CAN, beside the bare socket |
//! | `cargo run --release -p benchmarks --bin coverage` | how often the identification's 95 % intervals hold the truth, over simulated campaigns |
//! | `cargo run --release -p benchmarks --bin service` | lateness with ten live clients and three subscribers against none; the service's processor time; age of samples at a client |
//! | `benchmarks/lateness.sh` | lateness of the loop's wake-ups against cyclictest, idle and under load |

pub mod campaign;
pub mod wire;

use bench::controller::{PumpController, Settings as ControllerSettings};
use drivers::EmulatedRig;
use drivers::emulated::Settings as RigSettings;
use model::Parameters;
use model::effects::EffectSet;
use profiles::{BUILTIN, Context, EXAMPLES, Plane, Playback, Script};
use rt_core::{
    Controller, Device, Ended, FlightLog, FlightRecorder, Limits, Lockstep, OverrunPolicy, Publish, Reference, Run,
    Stages, Supervisor,
};
use std::error::Error;
use std::fmt;
use std::process::ExitCode;

/// A figure beside what it is meant to be.
#[derive(Clone, Copy, Debug)]
pub enum Target {
    /// The more the better: at least this.
    AtLeast(f64),
    /// The less the better: at most this.
    AtMost(f64),
}

impl Target {
    /// Whether a figure reaches it; NaN does not.
    pub fn reached_by(self, figure: f64) -> bool {
        match self {
            Target::AtLeast(target) => figure >= target,
            Target::AtMost(target) => figure <= target,
        }
    }

    /// `figure / target  at least target  reached`
    pub fn judge(self, figure: f64) -> String {
        let (Target::AtLeast(target) | Target::AtMost(target)) = self;
        let verdict = if self.reached_by(figure) { "reached" } else { "MISSED" };
        format!("ratio {:.2} to {self}: {verdict}", figure / target)
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Target::AtLeast(target) => write!(f, "at least {target}"),
            Target::AtMost(target) => write!(f, "at most {target}"),
        }
    }
}

/// Exit code of a benchmark: 0 all targets are reached, 3 one is missed, 1 it failed.
pub fn exit(all_reached: Result<bool, Box<dyn Error>>) -> ExitCode {
    match all_reached {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::from(3),
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(1)
        }
    }
}

/// A built-in profile with the rig that it is played on.
pub struct Bench {
    /// The profile.
    pub script: Script,
    /// Its text.
    pub text: String,
    parameters: Parameters,
    supervisor: Supervisor,
    flight: FlightRecorder,
    _incidents: FlightLog,
}

impl Bench {
    /// The profile `name` of those that come with the bench, its text changed by `edit` first.
    ///
    /// # Errors
    /// There is no such profile, or the edit spoilt it.
    pub fn new(name: &str, edit: impl FnOnce(&str) -> String) -> Result<Bench, Box<dyn Error>> {
        let file = format!("{name}.toml");
        let (file, text) =
            BUILTIN.iter().chain(EXAMPLES).find(|(f, _)| **f == file).ok_or_else(|| format!("no profile {file}"))?;
        let text = edit(text);
        let script = Script::parse(&text, file)?;
        // The emulated chambers neither burst nor cavitate at the edge of what the profiles reach.
        let limits = Limits { pressure_min_bar: 0.3, pressure_max_bar: 9.0, ..Limits::default() };
        let (flight, _incidents) = rt_core::flight::recorder();
        let supervisor = Supervisor::new(limits)?;
        Ok(Bench { script, text, parameters: Parameters::example(), supervisor, flight, _incidents })
    }

    /// The rig before its first tick.
    ///
    /// # Errors
    /// The profile starts where the rig can't.
    pub fn rig(&self) -> Result<EmulatedRig, Box<dyn Error>> {
        let defaults = RigSettings::default();
        let settings = RigSettings {
            start: self.script.start(),
            fill_bar: self.script.fill_bar.unwrap_or(defaults.fill_bar),
            vertical: self.script.plane == Plane::Vertical,
            seed: 1,
            ..defaults
        };
        Ok(EmulatedRig::new(&self.parameters, EffectSet::none(), settings)?)
    }

    /// The profile before its first tick.
    ///
    /// # Errors
    /// The profile asks for more than the rig can.
    pub fn playback(&self) -> Result<Playback, Box<dyn Error>> {
        Ok(self.script.compile(&Context {
            u_max_v: self.parameters.pump.u_max,
            seed: 1,
            hands: profiles::Hands::Rig,
        })?)
    }

    /// Drives run `number` in virtual time; returns its ticks.
    ///
    /// # Errors
    /// It did not come to its end.
    pub fn run(
        &mut self,
        number: u32,
        device: &mut dyn Device,
        reference: &mut dyn Reference,
        controller: &mut dyn Controller,
        publish: &mut dyn Publish,
    ) -> Result<u64, Box<dyn Error>> {
        let stages = Stages {
            clock: &mut Lockstep::default(),
            device,
            operator: &mut (),
            supervisor: &mut self.supervisor,
            reference,
            controller,
            publish,
            flight: &mut self.flight,
        };
        let report = rt_core::run(stages, Run { number, overrun: OverrunPolicy::Skip })?;
        if report.ended != Ended::Completed {
            return Err(report.to_string().into());
        }
        Ok(report.statistics.ticks)
    }

    /// The controller of `bench run` with the rig's own model.
    ///
    /// # Errors
    /// None in a released state.
    pub fn controller(&self) -> Result<PumpController, Box<dyn Error>> {
        Ok(PumpController::with_model(&self.parameters, ControllerSettings::default())?)
    }

    /// Drives run `number` of a new rig.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn run_new(&mut self, number: u32, publish: &mut dyn Publish) -> Result<u64, Box<dyn Error>> {
        let (mut rig, mut playback, mut controller) = (self.rig()?, self.playback()?, self.controller()?);
        self.run(number, &mut rig, &mut playback, &mut controller, publish)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_target_is_reached_or_missed_and_says_so() {
        let (most, least) = (Target::AtMost(1.25), Target::AtLeast(500.0));
        assert!(most.reached_by(1.25) && !most.reached_by(1.26) && !most.reached_by(f64::NAN));
        assert!(least.reached_by(500.0) && !least.reached_by(499.0) && !least.reached_by(f64::NAN));
        assert_eq!(most.judge(2.5), "ratio 2.00 to at most 1.25: MISSED");
        assert_eq!(least.judge(750.0), "ratio 1.50 to at least 500: reached");
    }

    #[test]
    fn a_profile_is_driven_to_its_end_by_the_controller_that_it_needs() {
        for name in ["square_h", "angle_sine"] {
            let mut bench = Bench::new(name, str::to_owned).expect("it comes with the bench");
            let mut samples = Vec::new();
            let ticks = bench.run_new(3, &mut samples).expect("it ends");
            assert_eq!(samples.len() as u64, ticks, "{name}");
            assert!(samples.iter().any(|s| s.voltage_v != 0.0 && s.run == 3), "{name}");
        }
        assert!(Bench::new("levitate", str::to_owned).is_err());
    }
}
