//! The contract of devices, in process and in virtual time: the emulated rig, alone and behind fault injection.
#![allow(clippy::unwrap_used, reason = "a test")]

use drivers::EmulatedRig;
use drivers::contract::{self, Clause, Cut, FarEnd, Subject, Trouble, Violation, Wire};
use drivers::emulated::Settings;
use drivers::faults::Faulty;
use drivers::journal::JournalReader;
use model::Parameters;
use model::effects::EffectSet;
use rt_core::fault::{Fault, FaultKind};
use rt_core::{Command, Device, DeviceError, Fixture, Input, Measurement, Tick};
use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// A rig that stays when its device is dropped, with what it showed.
struct Rig {
    emulated: EmulatedRig,
    shown: BTreeMap<u64, Measurement>,
}

impl Rig {
    fn new(seed: u64) -> Rig {
        let start =
            Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
        let settings = Settings { start, seed, ..Settings::default() };
        let emulated = EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings).unwrap();
        Rig { emulated, shown: BTreeMap::new() }
    }
}

/// The emulated rig as a device, with its far end in the subject's hands.
#[derive(Clone)]
struct Shared(Rc<RefCell<Rig>>);

impl Shared {
    fn new() -> Self {
        Shared(Rc::new(RefCell::new(Rig::new(1))))
    }
}

impl Device for Shared {
    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let mut rig = self.0.borrow_mut();
        let measured = rig.emulated.read(now)?;
        rig.shown.insert(now.index, measured);
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.0.borrow_mut().emulated.write(now, command)
    }
}

/// What both subjects have in common.
struct FarSide(Shared);

impl FarSide {
    fn renew(&mut self) -> Shared {
        *self.0.0.borrow_mut() = Rig::new(1);
        self.0.clone()
    }

    fn in_force(&self) -> FarEnd {
        let Command { voltage_v, brake_open, bypass_open, .. } = self.0.0.borrow().emulated.command();
        FarEnd { voltage_v, brake_open, bypass_open }
    }

    fn shown(&self, tick: u64) -> Option<Measurement> {
        self.0.0.borrow().shown.get(&tick).copied()
    }
}

/// The emulated rig itself.
struct InProcess(FarSide);

impl Subject for InProcess {
    type Device = Shared;

    fn open(&mut self, _cut: Option<Cut>) -> Result<Shared, Trouble> {
        let mut device = self.0.renew();
        device.begin_run(0);
        Ok(device)
    }

    fn far_end(&mut self) -> Option<FarEnd> {
        Some(self.0.in_force())
    }

    fn shown(&mut self, tick: u64) -> Option<Measurement> {
        self.0.shown(tick)
    }

    fn arm(&mut self, _device: &mut Shared) -> Result<(), Trouble> {
        Ok(())
    }

    fn exempt(&self, clause: Clause) -> Option<&'static str> {
        match clause {
            Clause::TimeOuts | Clause::Rearm => Some("in process there is no wire to be cut"),
            Clause::SafeOnDrop => Some("the rig goes with the device: nothing is left that could move"),
            _ => None,
        }
    }
}

/// The emulated rig behind fault injection: wires are cut by it.
struct Injected {
    far_side: FarSide,
    journals: JournalReader,
    /// Beside the cut.
    faults: Vec<Fault>,
}

impl Injected {
    fn new(faults: Vec<Fault>) -> Self {
        Injected { far_side: FarSide(Shared::new()), journals: JournalReader::default(), faults }
    }
}

impl Subject for Injected {
    type Device = Faulty<Shared>;

    fn open(&mut self, cut: Option<Cut>) -> Result<Faulty<Shared>, Trouble> {
        let mut faults = self.faults.clone();
        if let Some(Cut { wire, from_tick, until_tick }) = cut {
            let kind = match wire {
                Wire::Amplifier => FaultKind::PortGone { timeout_ticks: 100 },
                Wire::Bus => FaultKind::BusOff { timeout_ticks: 50 },
            };
            faults.push(Fault { kind, from_tick, ticks: Some(until_tick - from_tick), probability: 1.0 });
        }
        let journal = self.journals.journal("faults");
        let mut device = Faulty::new(self.far_side.renew(), &faults, 4, journal)?;
        device.begin_run(0);
        Ok(device)
    }

    fn far_end(&mut self) -> Option<FarEnd> {
        Some(self.far_side.in_force())
    }

    fn shown(&mut self, tick: u64) -> Option<Measurement> {
        self.far_side.shown(tick)
    }

    /// Frames are late and lost on this wire.
    fn age_ticks(&self) -> u64 {
        if self.faults.is_empty() { 0 } else { 5 }
    }

    fn arm(&mut self, device: &mut Faulty<Shared>) -> Result<(), Trouble> {
        device.end_run()?;
        self.far_side.renew();
        device.begin_run(0);
        device.arm();
        Ok(())
    }

    fn exempt(&self, clause: Clause) -> Option<&'static str> {
        (clause == Clause::SafeOnDrop).then_some("a wrapper leaves this to the device inside, which here goes with it")
    }
}

/// Which clauses were not tested.
fn exempt(checked: Result<Vec<(Clause, &'static str)>, Violation>) -> Vec<Clause> {
    checked.unwrap_or_else(|violation| panic!("{violation}")).into_iter().map(|(clause, _)| clause).collect()
}

#[test]
fn the_emulated_rig_keeps_the_contract() {
    let checked = contract::check(&mut InProcess(FarSide(Shared::new())));
    assert_eq!(exempt(checked), [Clause::TimeOuts, Clause::SafeOnDrop, Clause::Rearm]);
}

#[test]
fn fault_injection_without_faults_keeps_the_contract() {
    assert_eq!(exempt(contract::check(&mut Injected::new(vec![]))), [Clause::SafeOnDrop]);
}

#[test]
fn frames_that_are_lost_late_repeated_swapped_and_refused_keep_the_contract() {
    let of = |kind| Fault { kind, from_tick: 1, ticks: None, probability: 0.2 };
    let on = |input| {
        let route = rt_core::fault::Route::Input(input);
        [
            of(FaultKind::Lost { route }),
            of(FaultKind::Late { route, ticks: 3, unnoticed: false }),
            of(FaultKind::Repeated { input, unnoticed: false }),
            of(FaultKind::Swapped { input, unnoticed: false }),
            of(FaultKind::CrcError { input }),
        ]
    };
    let faults = [Input::Angle, Input::Pressure1, Input::Pressure2].into_iter().flat_map(on).collect();
    assert_eq!(exempt(contract::check(&mut Injected::new(faults))), [Clause::SafeOnDrop]);
}

/// The suite can fail: each of these breaks what one clause asks.
#[test]
fn devices_that_break_the_contract_are_found() {
    let input = Input::Angle;
    let of = |kind| vec![Fault { kind, from_tick: 10, ticks: None, probability: 1.0 }];
    let route = rt_core::fault::Route::Input(input);
    let stale = |kind| contract::freshness(&mut Injected::new(of(kind))).unwrap_err();
    for kind in [
        FaultKind::Stuck { input },
        FaultKind::Drift { input, per_s: 0.5 },
        FaultKind::Late { route, ticks: 3, unnoticed: true },
        FaultKind::Repeated { input, unnoticed: true },
        FaultKind::Late { route, ticks: 9, unnoticed: false },
        FaultKind::Nan { input },
    ] {
        assert_eq!(stale(kind).clause, Clause::Freshness, "{kind}");
    }
    let swapped = of(FaultKind::Swapped { input, unnoticed: true });
    assert!(contract::ordering(&mut Injected::new(swapped)).is_err());
    let lost = of(FaultKind::Lost { route: rt_core::fault::Route::Voltage { timeout_ticks: 1000 } });
    assert!(contract::last_command(&mut Injected::new(lost)).is_err());
    let valve = FaultKind::ValveStuck { valve: rt_core::fault::Valve::Brake, open: Some(true) };
    assert!(contract::last_command(&mut Injected::new(of(valve))).is_err());
    assert!(contract::safe_on_drop(&mut InProcess(FarSide(Shared::new()))).is_err(), "it is exempt for a reason");
    // Without a wire to cut, nothing grows old and nothing is disarmed.
    assert!(contract::time_outs(&mut InProcess(FarSide(Shared::new()))).is_err());
    assert!(contract::rearm(&mut InProcess(FarSide(Shared::new()))).is_err());
}
