//! A device whose values tell when they were measured, played with faults; and one fault of each kind.

use drivers::EmulatedRig;
use drivers::emulated::Settings;
use drivers::faults::Faulty;
use drivers::journal::{JournalReader, Occurrence};
use model::Parameters;
use model::effects::EffectSet;
use rt_core::fault::{Fault, FaultKind, Route, Valve, full_scale};
use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, Tick};
use std::cell::RefCell;
use std::rc::Rc;

pub const ANGLE: Input = Input::Angle;

pub const FREE: Command =
    Command { voltage_v: 5.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };

/// Shows the tick's number as angle, and fractions of it elsewhere, so that each value tells when it was measured.
#[derive(Clone, Default)]
pub struct Ramp {
    pub told: Rc<RefCell<Vec<(u64, Command)>>>,
    pub allocated: bool,
}

impl Device for Ramp {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let k = now.index as f64;
        let (pressure1_bar, pressure2_bar, torque_nm, volume_ml) = (2.0 + k * 1e-4, 3.0 - k * 1e-4, k * 1e-2, k * 0.1);
        Ok(Measurement { angle_deg: k, pressure1_bar, pressure2_bar, torque_nm, volume_ml, ..Measurement::NONE })
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        if !self.allocated {
            self.told.borrow_mut().push((now.index, *command));
        }
        Ok(())
    }
}

pub fn fault(kind: FaultKind, from_tick: u64, ticks: u64) -> Fault {
    Fault { kind, from_tick, ticks: Some(ticks), probability: 1.0 }
}

/// What came of a run: what the loop read, what the device was told, what the journal says.
pub struct Played {
    pub read: Vec<Result<Measurement, DeviceError>>,
    pub told: Vec<(u64, Command)>,
    pub journal: Vec<Occurrence>,
}

impl Played {
    pub fn at(&self, tick: usize) -> Measurement {
        self.read[tick].clone().unwrap()
    }

    /// Value and age in ticks.
    pub fn angle(&self, tick: usize) -> (f64, u32) {
        let measured = self.at(tick);
        assert_eq!(measured.age_ns[0] % 1_000_000, 0);
        (measured.angle_deg, measured.age_ns[0] / 1_000_000)
    }

    pub fn volts(&self) -> Vec<f64> {
        self.told.iter().map(|(_, command)| command.voltage_v).collect()
    }

    pub fn texts(&self) -> Vec<&str> {
        self.journal.iter().map(|entry| &*entry.text).collect()
    }
}

/// Plays so many ticks; each command is the tick's number in mV.
pub fn play(faults: &[Fault], seed: u64, ticks: u64) -> Played {
    let mut journals = JournalReader::default();
    let ramp = Ramp::default();
    let told = ramp.told.clone();
    let mut device = Faulty::new(ramp, faults, seed, journals.journal("faults")).unwrap();
    device.begin_run(0);
    let mut read = vec![];
    for tick in 0..ticks {
        read.push(device.read(Tick::at(tick)));
        let bypass_open = tick % 2 == 1;
        device.write(Tick::at(tick), &Command { voltage_v: tick as f64 * 1e-3, bypass_open, ..FREE }).unwrap();
    }
    drop(device);
    let told = told.take();
    Played { read, told, journal: journals.read() }
}

/// One of each kind, on everything that it can hit, with a share where it can have one.
pub fn all_kinds() -> Vec<Fault> {
    let mut kinds = vec![
        FaultKind::PortGone { timeout_ticks: 20 },
        FaultKind::BusOff { timeout_ticks: 20 },
        FaultKind::AmplifierFault { code: 9 },
        FaultKind::ValveStuck { valve: Valve::Brake, open: Some(false) },
        FaultKind::ValveStuck { valve: Valve::Bypass, open: None },
    ];
    let mut routes = vec![Route::Voltage { timeout_ticks: 50 }, Route::Valves { timeout_ticks: 50 }];
    for input in Input::ALL {
        let (low, high) = full_scale(input);
        routes.push(Route::Input(input));
        kinds.extend([
            FaultKind::Repeated { input, unnoticed: false },
            FaultKind::Repeated { input, unnoticed: true },
            FaultKind::Swapped { input, unnoticed: false },
            FaultKind::Swapped { input, unnoticed: true },
            FaultKind::BitFlip { input, bit: None, low, high },
            FaultKind::BitFlip { input, bit: Some(5), low, high },
            FaultKind::CrcError { input },
            FaultKind::Stuck { input },
            FaultKind::Drift { input, per_s: -0.5 },
            FaultKind::Nan { input },
        ]);
    }
    for route in routes {
        kinds.push(FaultKind::Lost { route });
        kinds.push(FaultKind::Late { route, ticks: 7, unnoticed: false });
        if matches!(route, Route::Input(_)) {
            kinds.push(FaultKind::Late { route, ticks: 7, unnoticed: true });
        }
    }
    let share = |kind: &FaultKind| if kind.hits_frames() { 0.5 } else { 1.0 };
    kinds.iter().map(|kind| Fault { probability: share(kind), ..fault(*kind, 100, 200) }).collect()
}

pub fn rig(seed: u64) -> EmulatedRig {
    let settings = Settings { start: Command { voltage_v: 0.0, ..FREE }, seed, ..Settings::default() };
    EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).unwrap()
}
