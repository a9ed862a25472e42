//! The contract of devices, over real wires: the wired rig against the emulated one at the other end of a pty and a bus, with both
//! protocols. The bus is a socket, and CAN where this machine has it.
#![allow(clippy::unwrap_used, reason = "a test")]

mod vcan;

use drivers::can::Interface;
use drivers::contract::{self, Clause, Cut, FarEnd, Subject, Trouble, Wire};
use drivers::dbc::Database;
use drivers::emulated::Settings as Emulated;
use drivers::faults::Faulty;
use drivers::journal::JournalReader;
use drivers::nodes::{self, Emulator, EmulatorSettings, PlantFactory};
use drivers::wired::{Preparation, Settings, WiredError, WiredRig};
use drivers::{EmulatedError, EmulatedRig};
use model::Parameters;
use model::effects::EffectSet;
use rt_core::system::time::{monotonic_ns, sleep_until_ns};
use rt_core::{Command, Device, Fixture, Input, Measurement, SafeState, Switches, Tick};
use std::sync::atomic::Ordering;
use std::sync::{Mutex, MutexGuard};
use std::time::Duration;
use tempfile::TempDir;

const PROTOCOLS: [&str; 2] = ["vesc", "tmcl"];
const START: Command =
    Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
/// From the begin of a run to its tick 0.
const LEAD_NS: u64 = 2_000_000;

fn factory() -> PlantFactory {
    Box::new(|preparation: &Preparation| -> Result<EmulatedRig, EmulatedError> {
        let Preparation { run, vertical, fill_bar, start } = *preparation;
        let settings = Emulated { start, fill_bar, vertical, seed: u64::from(run), ..Emulated::default() };
        EmulatedRig::new(&Parameters::example(), EffectSet::none(), settings)
    })
}

/// How the rig is put on the wires.
#[derive(Clone, Copy)]
struct TimeOuts {
    amplifier_ms: f64,
    node_ms: f64,
}

/// Longer than those of a rig: a machine with other work holds a pty up for 100 ms. Shorter than the contract's cut.
const USUAL: TimeOuts = TimeOuts { amplifier_ms: 200.0, node_ms: 150.0 };
/// The far end does nothing by itself: what is safe is the driver's doing.
const NEVER: TimeOuts = TimeOuts { amplifier_ms: 60_000.0, node_ms: 60_000.0 };

struct Wired {
    _alone: MutexGuard<'static, ()>,
    settings: Settings,
    database: Database,
    emulator: Emulator,
    journals: JournalReader,
    run: u8,
    origin_ns: u64,
    cut: Option<Cut>,
    _folder: TempDir,
}

/// Real time: one rig of this process at a time.
static ALONE: Mutex<()> = Mutex::new(());

impl Wired {
    fn new(protocol: &str, can: Option<&str>, time_outs: TimeOuts) -> Wired {
        let alone = ALONE.lock().unwrap_or_else(|poisoned| poisoned.into_inner());
        let folder = tempfile::tempdir().unwrap();
        let interface = match can {
            Some(name) => Interface::SocketCan(name.to_owned()),
            None => Interface::Unix(folder.path().join("can")),
        };
        let text: toml::Table = toml::from_str(include_str!("../../bench/rigs/wired.toml")).unwrap();
        let wires = text.into_iter().filter(|(key, _)| ["amplifier", "can"].contains(&key.as_str())).collect();
        let mut settings: Settings = toml::Value::Table(wires).try_into().unwrap();
        settings.amplifier.protocol = protocol.to_owned();
        settings.can.interface = interface.to_string();
        settings.amplifier.timeout_ms = USUAL.amplifier_ms;
        let mut journals = JournalReader::default();
        let database = Database::parse(include_str!("../../bench/rigs/rec.dbc"), "rec.dbc").unwrap();
        let at_the_rig = EmulatorSettings {
            amplifier_timeout_ms: time_outs.amplifier_ms,
            node_timeout_ms: time_outs.node_ms,
            ..EmulatorSettings::new(settings.amplifier.clone(), settings.can.clone(), interface)
        };
        let journal = journals.journal("rig");
        let emulator = Emulator::start(&at_the_rig, &database, factory(), || {}, journal).unwrap();
        settings.amplifier.port = emulator.port().to_owned();
        Wired {
            _alone: alone,
            settings,
            database,
            emulator,
            journals,
            run: 0,
            origin_ns: 0,
            cut: None,
            _folder: folder,
        }
    }

    fn mend(&mut self) {
        self.emulator.inject(nodes::Trouble::AmplifierSilent(false));
        self.emulator.inject(nodes::Trouble::NodesSilent(false));
    }

    /// What every device on these wires needs before a run.
    fn prepare(&mut self, rig: &mut WiredRig) -> Result<u64, Trouble> {
        self.run = self.run.wrapping_add(1);
        rig.prepare(Preparation { run: self.run, vertical: false, fill_bar: 2.8, start: START }, &Switches::new())?;
        self.origin_ns = monotonic_ns() + LEAD_NS;
        Ok(self.origin_ns)
    }

    fn rig(&mut self, cut: Option<Cut>) -> Result<WiredRig, Trouble> {
        self.cut = cut;
        self.mend();
        let safe_state = SafeState::default();
        Ok(WiredRig::open(&self.settings, &self.database, safe_state, || {}, &mut self.journals)?)
    }

    fn wait(&mut self, index: u64) -> Tick {
        let now = Tick::at(index);
        sleep_until_ns(self.origin_ns + now.scheduled_ns);
        if let Some(Cut { wire, from_tick, until_tick }) = self.cut {
            let cut = (from_tick..until_tick).contains(&index);
            self.emulator.inject(match wire {
                Wire::Amplifier => nodes::Trouble::AmplifierSilent(cut),
                Wire::Bus => nodes::Trouble::NodesSilent(cut),
            });
            if index >= until_tick {
                self.cut = None;
            }
        }
        now
    }

    fn far_end(&self) -> FarEnd {
        self.emulator.seen(|&nodes::Seen { voltage_v, brake_open, bypass_open, .. }| FarEnd {
            voltage_v,
            brake_open,
            bypass_open,
        })
    }

    fn shown(&self, tick: u64) -> Option<Measurement> {
        self.emulator.seen(|nodes::Seen { shown, .. }| {
            shown.binary_search_by_key(&tick, |&(tick, _)| tick).ok().map(|place| shown[place].1)
        })
    }
}

/// Half a step of the database's signals.
fn resolution(input: Input) -> f64 {
    match input {
        Input::Angle => 0.51e-4,
        Input::Pressure1 | Input::Pressure2 => 1.1e-6,
        Input::Torque | Input::Volume => 1e-4,
    }
}

/// A duty of TMCL has steps of 1 / 32767.
const VOLTAGE_STEP_V: f64 = 24.0 / 32_767.0;
/// As a rule it is one tick; a machine with other work may stall the wires for longer.
const AGE_TICKS: u64 = 20;

impl Subject for Wired {
    type Device = WiredRig;

    fn open(&mut self, cut: Option<Cut>) -> Result<WiredRig, Trouble> {
        let mut rig = self.rig(cut)?;
        let origin_ns = self.prepare(&mut rig)?;
        rig.begin_run(origin_ns);
        Ok(rig)
    }

    fn wait(&mut self, index: u64) -> Tick {
        Wired::wait(self, index)
    }

    fn far_end(&mut self) -> Option<FarEnd> {
        Some(Wired::far_end(self))
    }

    fn shown(&mut self, tick: u64) -> Option<Measurement> {
        Wired::shown(self, tick)
    }

    fn resolution(&self, input: Input) -> f64 {
        resolution(input)
    }

    fn age_ticks(&self) -> u64 {
        AGE_TICKS
    }

    fn voltage_resolution_v(&self) -> f64 {
        VOLTAGE_STEP_V
    }

    fn arm(&mut self, rig: &mut WiredRig) -> Result<(), Trouble> {
        self.cut = None;
        self.mend();
        let origin_ns = self.prepare(rig)?;
        rig.begin_run(origin_ns);
        Ok(())
    }
}

/// The same behind fault injection without faults.
struct WiredWithoutFaults(Wired);

impl Subject for WiredWithoutFaults {
    type Device = Faulty<WiredRig>;

    fn open(&mut self, cut: Option<Cut>) -> Result<Faulty<WiredRig>, Trouble> {
        let rig = self.0.rig(cut)?;
        let mut device = Faulty::new(rig, &[], 1, self.0.journals.journal("faults"))?;
        let origin_ns = self.0.prepare(device.device_mut())?;
        device.begin_run(origin_ns);
        Ok(device)
    }

    fn wait(&mut self, index: u64) -> Tick {
        self.0.wait(index)
    }

    fn far_end(&mut self) -> Option<FarEnd> {
        Some(self.0.far_end())
    }

    fn shown(&mut self, tick: u64) -> Option<Measurement> {
        self.0.shown(tick)
    }

    fn resolution(&self, input: Input) -> f64 {
        resolution(input)
    }

    fn age_ticks(&self) -> u64 {
        AGE_TICKS
    }

    fn voltage_resolution_v(&self) -> f64 {
        VOLTAGE_STEP_V
    }

    fn arm(&mut self, device: &mut Faulty<WiredRig>) -> Result<(), Trouble> {
        self.0.cut = None;
        self.0.mend();
        let origin_ns = self.0.prepare(device.device_mut())?;
        device.begin_run(origin_ns);
        Ok(())
    }
}

/// Every clause; and what is safe on drop once more with a far end that does nothing by itself.
fn keeps_the_contract(protocol: &str, can: Option<&str>) {
    let mut subject = Wired::new(protocol, can, USUAL);
    let exempt: Vec<(Clause, &str)> = contract::check(&mut subject)
        .unwrap_or_else(|violation| panic!("{protocol}: {violation}\n{}", told(&mut subject)));
    assert_eq!(exempt, []);
    drop(subject);
    let mut subject = Wired::new(protocol, can, NEVER);
    contract::safe_on_drop(&mut subject)
        .unwrap_or_else(|violation| panic!("{protocol}, without time-outs: {violation}"));
}

/// What the drivers and the rig said, for a test that fails.
fn told(subject: &mut Wired) -> String {
    std::thread::sleep(Duration::from_millis(20));
    subject.journals.read().iter().map(|entry| format!("{:?} {}: {}\n", entry.when, entry.source, entry.text)).collect()
}

#[test]
fn the_wired_rig_keeps_the_contract() {
    for protocol in PROTOCOLS {
        keeps_the_contract(protocol, None);
    }
}

#[test]
fn the_wired_rig_keeps_the_contract_over_can() {
    let Some(name) = vcan::vcan() else { return };
    for protocol in PROTOCOLS {
        keeps_the_contract(protocol, Some(&name));
    }
}

#[test]
fn fault_injection_without_faults_around_the_wired_rig_keeps_it_too() {
    let mut subject = WiredWithoutFaults(Wired::new("vesc", None, USUAL));
    let exempt =
        contract::check(&mut subject).unwrap_or_else(|violation| panic!("{violation}\n{}", told(&mut subject.0)));
    assert_eq!(exempt, []);
}

#[test]
fn a_stop_keeps_the_rig_from_being_prepared_and_ends_a_preparation_that_waits() {
    let mut wired = Wired::new("vesc", None, USUAL);
    let mut rig = wired.rig(None).unwrap();
    let preparation = Preparation { run: 1, vertical: false, fill_bar: 2.8, start: START };
    for emergency in [false, true] {
        let switches = Switches::new();
        let thrown = if emergency { &switches.emergency_stop } else { &switches.stop };
        thrown.store(true, Ordering::Relaxed);
        assert!(matches!(rig.prepare(preparation, &switches), Err(WiredError::Stopped)), "before anything is sent");

        // Where nodes are silent the preparation would end by its patience, with another error.
        thrown.store(false, Ordering::Relaxed);
        wired.emulator.inject(nodes::Trouble::NodesSilent(true));
        std::thread::scope(|scope| {
            scope.spawn(|| {
                std::thread::sleep(Duration::from_millis(100));
                thrown.store(true, Ordering::Relaxed);
            });
            assert!(matches!(rig.prepare(preparation, &switches), Err(WiredError::Stopped)), "while it waits");
        });
        wired.emulator.inject(nodes::Trouble::NodesSilent(false));
    }
    wired.prepare(&mut rig).unwrap(); // it can be armed again
}

#[test]
fn two_nodes_with_one_identifier_are_told() {
    let mut wired = Wired::new("vesc", None, USUAL);
    let mut rig = wired.rig(None).unwrap();
    wired.prepare(&mut rig).unwrap();
    wired.emulator.inject(nodes::Trouble::EncoderTwice(true));
    let error = wired.prepare(&mut rig).unwrap_err().to_string();
    assert!(error.contains("two nodes") && error.contains("frame 181"), "{error}");
    wired.emulator.inject(nodes::Trouble::EncoderTwice(false));
    let origin_ns = wired.prepare(&mut rig).unwrap();
    rig.begin_run(origin_ns);
    wired.emulator.inject(nodes::Trouble::EncoderTwice(true));
    let refused = (0..2000).find_map(|index| {
        let now = wired.wait(index);
        rig.read(now).and_then(|_| rig.write(now, &START)).err()
    });
    assert!(refused.unwrap().to_string().contains("two nodes"));
}

#[test]
fn a_rig_whose_start_can_t_be_commanded_is_let_go_in_the_safe_state() {
    let open = FarEnd { voltage_v: 0.0, brake_open: true, bypass_open: false };
    let safe = FarEnd { voltage_v: 0.0, brake_open: false, bypass_open: true };
    // More than the float of the signal holds.
    let most = 1e39;
    let beyond = Command { fixture: Fixture::Clamped { angle_deg: most }, ..START };
    for (start, fill_bar) in [(beyond, 2.8), (START, most)] {
        let mut wired = Wired::new("vesc", None, NEVER);
        let mut rig = wired.rig(None).unwrap();
        wired.prepare(&mut rig).unwrap();
        assert_eq!(wired.far_end(), open);
        let error = rig
            .prepare(Preparation { run: 2, vertical: false, fill_bar, start }, &Switches::new())
            .unwrap_err()
            .to_string();
        assert!(error.contains("can't be commanded"), "{error}");
        drop(rig);
        for _ in 0..10_000 {
            if wired.far_end() == safe {
                break;
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        assert_eq!(wired.far_end(), safe, "{start:?}, {fill_bar} bar");
    }
}

#[test]
fn with_an_amplifier_that_takes_no_voltage_no_run_begins() {
    let mut wired = Wired::new("tmcl", None, USUAL);
    wired.settings.amplifier.tmcl.command_parameter = Some(200);
    let mut rig = wired.rig(None).unwrap();
    let error = wired.prepare(&mut rig).unwrap_err().to_string();
    assert!(error.contains("does not take a voltage") && error.contains("command_parameter"), "{error}");
    // Who begins one all the same is told at once.
    rig.begin_run(monotonic_ns());
    let error = rig.read(Tick::at(0)).unwrap_err().to_string();
    assert!(error.contains("takes the commanded voltage") && error.contains("to command 5"), "{error}");
}

/// "Safe state: written" must be true of the rig and not of a queue on the way to it.
#[test]
fn what_is_written_to_an_amplifier_that_is_gone_was_not() {
    let mut wired = Wired::new("vesc", None, USUAL);
    let mut rig = wired.rig(None).unwrap();
    let origin_ns = wired.prepare(&mut rig).unwrap();
    rig.begin_run(origin_ns);
    rig.write(Tick::at(0), &START).unwrap();
    wired.emulator.inject(nodes::Trouble::AmplifierSilent(true));
    let refused = (1..5000).find_map(|index| rig.write(wired.wait(index), &START).err());
    assert!(refused.unwrap().to_string().contains("an amplifier that answers"));
}
