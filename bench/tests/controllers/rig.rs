//! The emulated rig under a controller, in lockstep through the loop.

use bench::controller::{PumpController, Settings};
use drivers::EmulatedRig;
use drivers::emulated::{Noise, Settings as RigSettings};
use model::Parameters;
use model::effects::{EffectSet, find};
use model::parameters::index;
use model::rec::STATES;
use rt_core::{
    Clock, Command, Device, DeviceError, Ended, Fixture, Limits, Lockstep, Measurement, OverrunPolicy, PERIOD_NS,
    Reference, Run, Sample, Stages, Step, Supervisor, Target, Tick, Wake, flight, run,
};

/// What is wanted as a function of time, s.
pub struct Wanted<F> {
    pub target: F,
    pub ticks: u64,
    pub fixture: Fixture,
}

impl<F: Fn(f64) -> Target> Reference for Wanted<F> {
    fn step(&mut self, now: Tick, _measured: &Measurement) -> Step {
        Step {
            target: (self.target)(now.seconds()),
            brake_open: true,
            bypass_open: false,
            fixture: self.fixture,
            segment: 0,
            index: 0,
            last: now.index + 1 >= self.ticks,
            waiting: None,
            hands_on: false,
        }
    }
}

/// An angle that jumps from 0 at 0.5 s.
pub fn angle_step(angle_deg: f64) -> impl Fn(f64) -> Target {
    move |time_s| Target::AngleDeg { angle_deg: if time_s < 0.5 { 0.0 } else { angle_deg }, velocity_deg_s: 0.0 }
}

/// The example's parameters, each wrong by +10 % or -10 %: a pattern of signs for every number.
pub fn off_by_a_tenth(pattern: u64) -> Parameters {
    let example = Parameters::example();
    let mut k = example.to_vector();
    let mut bits = pattern.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    for value in &mut k {
        bits ^= bits >> 29;
        bits = bits.wrapping_mul(0xBF58_476D_1CE4_E5B9);
        *value *= if bits >> 63 == 0 { 0.9 } else { 1.1 };
    }
    let a = k[index::A];
    k[index::L4] = (k[index::L1] * a * a + k[index::L2] * a + k[index::L3]) / a;
    Parameters::from_vector(&k, example.pump.u_max)
}

/// A rig and what the controller knows of it.
#[derive(Clone, Debug)]
pub struct Bench {
    pub plant: Parameters,
    pub effect: Option<(&'static str, Vec<f64>)>,
    pub noise: Noise,
    pub fixture: Fixture,
    /// What the controller takes the plant for.
    pub model: Parameters,
    pub settings: Settings,
}

impl Bench {
    /// The example with its sensors' noise, lever free and horizontal, known exactly.
    pub fn new() -> Self {
        Bench {
            plant: Parameters::example(),
            effect: None,
            noise: Noise::default(),
            fixture: Fixture::Free,
            model: Parameters::example(),
            settings: Settings::default(),
        }
    }

    pub fn controller(&self) -> PumpController {
        PumpController::with_model(&self.model, self.settings).expect("a sound model")
    }

    pub fn rig(&self) -> EmulatedRig {
        let start = Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: self.fixture, segment: 0 };
        let effects = self.effect.iter().map(|(id, k)| (find(id).expect("in the library"), k.clone()));
        let settings = RigSettings {
            start,
            vertical: self.settings.vertical,
            noise: self.noise,
            seed: 7,
            ..RigSettings::default()
        };
        EmulatedRig::new(&self.plant, EffectSet::new(STATES, effects), settings).expect("a rig")
    }

    /// Samples of a run that is completed.
    pub fn play(&self, seconds: f64, target: impl Fn(f64) -> Target) -> Vec<Sample> {
        let (samples, ended) = self.play_to_the_end(seconds, target);
        assert_eq!(ended, Ended::Completed, "after {} samples", samples.len());
        samples
    }

    pub fn play_to_the_end(&self, seconds: f64, target: impl Fn(f64) -> Target) -> (Vec<Sample>, Ended) {
        play(&mut self.rig(), &mut self.controller(), &mut Lockstep::default(), self.fixture, seconds, target)
    }
}

pub fn play(
    device: &mut dyn Device,
    controller: &mut PumpController,
    clock: &mut dyn Clock,
    fixture: Fixture,
    seconds: f64,
    target: impl Fn(f64) -> Target,
) -> (Vec<Sample>, Ended) {
    let mut samples: Vec<Sample> = Vec::new();
    let mut reference = Wanted { target, ticks: (seconds * 1e3) as u64, fixture };
    let stages = Stages {
        clock,
        device,
        operator: &mut (),
        supervisor: &mut Supervisor::new(Limits::default()).expect("sound limits"),
        reference: &mut reference,
        controller,
        publish: &mut samples,
        flight: &mut flight::recorder().0,
    };
    let report = run(stages, Run { number: 1, overrun: OverrunPolicy::Skip }).expect("the emulated rig does not fail");
    (samples, report.ended)
}

/// The rig seen in a mirror: chambers exchanged, angle and voltage of the other sign.
pub struct Mirror(pub EmulatedRig);

impl Device for Mirror {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let m = self.0.read(now)?;
        let (pressure1_bar, pressure2_bar) = (m.pressure2_bar, m.pressure1_bar);
        Ok(Measurement { angle_deg: -m.angle_deg, pressure1_bar, pressure2_bar, torque_nm: -m.torque_nm, ..m })
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.0.write(now, &Command { voltage_v: -command.voltage_v, ..*command })
    }
}

/// The rig with sensors that fail to answer: each at about a fifth of the ticks, up to 15 in a row and then not for 15 ticks.
pub struct Gaps {
    pub rig: EmulatedRig,
    pub left: [u32; 3],
    pub bits: u64,
}

impl Device for Gaps {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let mut m = self.rig.read(now)?;
        for (left, value) in self.left.iter_mut().zip([&mut m.angle_deg, &mut m.pressure1_bar, &mut m.pressure2_bar]) {
            self.bits = self.bits.wrapping_mul(0x5851_F42D_4C95_7F2D).wrapping_add(1);
            // 30..=16: no answer; 15..=1: answers that can be relied on.
            if *left == 0 && self.bits >> 60 == 0 {
                *left = 16 + (self.bits >> 40) as u32 % 15;
            }
            if *left > 15 {
                *value = f64::NAN;
            }
            *left = left.saturating_sub(1);
        }
        Ok(m)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.rig.write(now, command)
    }
}

/// Virtual time in which every few ticks one takes so long that those after it are skipped.
#[derive(Default)]
pub struct Stalling {
    time: Lockstep,
    index: u64,
}

impl Clock for Stalling {
    fn start(&mut self) {
        self.time.start();
    }

    fn wait(&mut self, index: u64) -> Wake {
        self.index = index;
        self.time.wait(index)
    }

    fn now_ns(&mut self) -> u64 {
        let stalled = [4, 9, 0].map(|ticks| ticks * PERIOD_NS)[self.index as usize % 3];
        self.time.now_ns() + stalled
    }
}
