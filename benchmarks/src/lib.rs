//! What the benchmarks have in common: the emulated rig with a built-in profile, and a run of it in virtual time.
//!
//! | command | measures |
//! |---|---|
//! | `cargo run --release -p benchmarks --bin lockstep` | times real time in virtual time, without subscribers and with the recording logger; memory over an hour |
//! | `cargo run --release -p benchmarks --bin instructions` | instructions of a tick, in all and by stage (callgrind) |
//! | `benchmarks/lateness.sh` | lateness of the loop's wake-ups against cyclictest, idle and under load |

use drivers::EmulatedRig;
use drivers::emulated::Settings;
use model::Parameters;
use model::effects::EffectSet;
use profiles::{BUILTIN, Context, Plane, Playback, Script};
use rt_core::{
    Controller, Device, Ended, FlightLog, FlightRecorder, Limits, Lockstep, OpenLoop, OverrunPolicy, Publish,
    Reference, Run, Stages, Supervisor,
};
use std::error::Error;

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
    /// The built-in profile `name`, its text changed by `edit` first.
    ///
    /// # Errors
    /// There is no such profile, or the edit spoilt it.
    pub fn new(name: &str, edit: impl FnOnce(&str) -> String) -> Result<Bench, Box<dyn Error>> {
        let file = format!("{name}.toml");
        let (file, text) = BUILTIN.iter().find(|(f, _)| **f == file).ok_or_else(|| format!("no built-in {file}"))?;
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
        let defaults = Settings::default();
        let settings = Settings {
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
        Ok(self.script.compile(&Context { u_max_v: self.parameters.pump.u_max, seed: 1 })?)
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

    /// Drives run `number` of a new rig in open loop.
    ///
    /// # Errors
    /// As [`run`](Self::run).
    pub fn run_open_loop(&mut self, number: u32, publish: &mut dyn Publish) -> Result<u64, Box<dyn Error>> {
        let (mut rig, mut playback) = (self.rig()?, self.playback()?);
        self.run(number, &mut rig, &mut playback, &mut OpenLoop, publish)
    }
}
