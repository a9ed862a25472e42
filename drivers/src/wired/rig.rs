//! The wired rig as a device of the loop.

use super::input_map::InputMap;
use super::output_map::{Around, MOST_FRAMES, OutputMap};
use super::settings::Settings;
use super::signals;
use super::twins::{self, Twins};
use super::{Preparation, WiredError};
use crate::can::{BusState, CanLink, Frame, FrameId, Interface};
use crate::dbc::Database;
use crate::journal::JournalReader;
use crate::serial::{AmplifierReport, SerialLink};
use rt_core::system::time::monotonic_ns;
use rt_core::{Command, Demand, Device, DeviceError, Fixture, Measurement, Operator, SafeState, Switches, Tick};
use std::fmt::Write;
use std::time::Duration;

const AMPLIFIER: &str = "amplifier";
const BUS: &str = "can";
const TAKES_NO_VOLTAGE: &str =
    "see [amplifier.tmcl] command_parameter and full_scale_units, and what state the module is in";
/// Every sensor must have answered within this time before a run may begin.
const PATIENCE: Duration = Duration::from_secs(3);
/// Answers to what was sent so long ago or longer are of this preparation, not left from the one before.
const SETTLED: Duration = Duration::from_millis(50);
const PREPARATION_PERIOD: Duration = Duration::from_millis(1);
/// The safe state is repeated so often when the rig is let go.
const FAREWELLS: u32 = 10;

/// A sign of life that is waited for.
struct Heartbeat {
    id: FrameId,
    name: String,
    heard_ns: Option<u64>,
}

/// Pump amplifier on a serial port, valves and sensors on CAN. See the module.
///
/// A run needs [`WiredRig::prepare`] before it and real time. When the loop stops calling, the amplifier's thread commands 0 V after
/// 20 ms, and the nodes time out by themselves. When it is dropped, both are told first.
pub struct WiredRig {
    amplifier: SerialLink,
    bus: CanLink,
    inputs: InputMap,
    outputs: OutputMap,
    heartbeats: Vec<Heartbeat>,
    twins: Twins,
    safe_state: SafeState,
    /// The rig file maps an automatic fixture.
    has_fixture: bool,
    preparation: Option<Preparation>,
    /// Tick 0 of the run on `CLOCK_MONOTONIC`, ns; 0 where there is no real time.
    origin_ns: u64,
    /// Tick of the last command of this run.
    commanded: Option<u64>,
    /// Fixture and segment of the last command that was sent: no clamp opens because the rig is let go.
    acting: (Fixture, u32),
    frames: [Frame; MOST_FRAMES],
}

impl WiredRig {
    /// Opens port and bus, and asks the amplifier who it is. `thread` prepares each I/O thread (priority, processors).
    ///
    /// # Errors
    /// Settings that contradict database or protocol; a port or an interface that can't be opened; an amplifier that does not
    /// answer, or answers something else.
    pub fn open(
        settings: &Settings,
        database: &Database,
        safe_state: SafeState,
        thread: impl Fn() + Clone + Send + 'static,
        journals: &mut JournalReader,
    ) -> Result<WiredRig, WiredError> {
        let inputs = InputMap::new(&settings.can, database)?;
        let outputs = OutputMap::new(&settings.can, database)?;
        let heartbeats: Vec<Heartbeat> = signals::heartbeats(&settings.can, database)?
            .into_iter()
            .map(|(_, message)| Heartbeat { id: message.id, name: message.name.clone(), heard_ns: None })
            .collect();
        let mut wanted = inputs.wanted();
        wanted.extend(heartbeats.iter().map(|heartbeat| heartbeat.id));
        wanted.sort_unstable();
        wanted.dedup();

        let interface: Interface = settings.can.interface.parse()?;
        let bus = CanLink::open(&interface, &wanted, thread.clone(), journals.journal(BUS))?;
        let mut amplifier = SerialLink::open(&settings.amplifier, thread, journals.journal(AMPLIFIER))?;
        journals.keep_telemetry(amplifier.take_telemetry());
        let nothing = Frame::new(FrameId::Standard(0), &[]).expect("no byte is fewer than nine");
        Ok(WiredRig {
            amplifier,
            bus,
            inputs,
            outputs,
            heartbeats,
            twins: Twins::new(&settings.can, database),
            safe_state,
            has_fixture: settings.can.fixture.is_some(),
            preparation: None,
            origin_ns: 0,
            commanded: None,
            acting: (Fixture::Free, 0),
            frames: [nothing; MOST_FRAMES],
        })
    }

    /// Whether an automatic fixture does the operator's part.
    pub fn has_fixture(&self) -> bool {
        self.has_fixture
    }

    /// Prepares the rig for a run and arms the amplifier: to begin a run is the operator's word. Sends the start command at 0 V
    /// until every sensor has answered it and every heartbeat was heard. Waits; not for the loop's thread. As long as the loop does not run
    /// yet nobody else looks at the switches: one that is thrown keeps the rig from being armed, or lets it go again.
    ///
    /// # Errors
    /// Who is silent, after three seconds; a bus that is off or down; an amplifier that is gone or reports a fault; a stop.
    pub fn prepare(&mut self, preparation: Preparation, switches: &Switches) -> Result<(), WiredError> {
        let mut switches = switches;
        let mut stopped = move || switches.demand(Tick::at(0)) != Demand::None;
        if stopped() {
            return Err(WiredError::Stopped);
        }
        let before = self.preparation.replace(preparation);
        self.commanded = None;
        self.inputs.forget();
        self.twins.forget();
        self.heartbeats.iter_mut().for_each(|heartbeat| heartbeat.heard_ns = None);
        self.amplifier.arm();
        let begun_ns = monotonic_ns();
        let mut settled = false;
        // Counters of a preparation are far from those of a run's first ticks.
        let half = self.outputs.modulus() / 2;
        for cycle in 0.. {
            if stopped() {
                self.let_go();
                self.amplifier.disarm();
                return Err(WiredError::Stopped);
            }
            if let Err(error) = self.send(&preparation.start, half + cycle % half, false) {
                // It goes along with every command: the farewell could not be said either.
                self.preparation = before;
                return Err(WiredError::NotReady(format!("the start can't be commanded: {error}")));
            }
            std::thread::sleep(PREPARATION_PERIOD);
            self.receive();
            let elapsed = Duration::from_nanos(monotonic_ns() - begun_ns);
            if !settled && elapsed >= SETTLED {
                settled = true;
                self.inputs.forget();
                self.heartbeats.iter_mut().for_each(|heartbeat| heartbeat.heard_ns = None);
            }
            let Some(missing) = self.missing() else {
                if settled {
                    return Ok(());
                }
                continue;
            };
            if elapsed >= PATIENCE {
                return Err(WiredError::NotReady(missing));
            }
        }
        Ok(())
    }

    /// Commands the safe state until the nodes must have heard it, with 0 V.
    fn let_go(&mut self) {
        let (fixture, segment) = self.acting;
        let safe = self.safe_state.command(fixture, segment);
        let half = self.outputs.modulus() / 2;
        for counter in 0..FAREWELLS {
            // What can't be encoded was refused before.
            let _ = self.send(&safe, half + u64::from(counter), false);
            std::thread::sleep(PREPARATION_PERIOD);
        }
    }

    /// Who must still be heard before a run may begin.
    fn missing(&mut self) -> Option<String> {
        let mut missing = String::new();
        let report = self.amplifier.poll();
        // Writing to a string can't fail.
        if let Some(fault) = report.fault {
            let _ = write!(missing, "the amplifier reports {fault}; ");
        }
        if let Some(refused) = report.refused {
            let _ = write!(missing, "the amplifier does not take a voltage: {refused}; {TAKES_NO_VOLTAGE}; ");
        }
        if !report.connected {
            let _ = write!(missing, "the amplifier does not answer; ");
        } else if !report.armed {
            // It was gone when it was to be armed; the operator's word for this run still holds.
            self.amplifier.arm();
            let _ = write!(missing, "the amplifier is not armed yet; ");
        }
        if let Some(trouble) = trouble(&self.bus.state()) {
            let _ = write!(missing, "{trouble}; ");
        }
        if let Some(id) = self.twins.found() {
            let _ = write!(missing, "{}; ", twins::told(id));
        }
        let others = missing.len();
        for (column, id) in self.inputs.silent() {
            let _ = write!(missing, "no frame {id} with {column}; ");
        }
        for heartbeat in self.heartbeats.iter().filter(|heartbeat| heartbeat.heard_ns.is_none()) {
            let _ = write!(missing, "no heartbeat {} (frame {}); ", heartbeat.name, heartbeat.id);
        }
        if missing.len() > others {
            missing.push_str("is the node powered, on this bus, at this bit rate?");
        }
        (!missing.is_empty()).then_some(missing)
    }

    fn send(&mut self, command: &Command, counter: u64, running: bool) -> Result<(), crate::dbc::OutOfRange> {
        let preparation =
            self.preparation.unwrap_or(Preparation { run: 0, vertical: false, fill_bar: 0.0, start: *command });
        let around = Around { counter, running, preparation };
        let framed = self.outputs.frames(command, &around, &mut self.frames);
        // The pump does not go on as it did where the valves can't be told.
        self.amplifier.command(if running && framed.is_ok() { command.voltage_v } else { 0.0 });
        let count = framed?;
        self.bus.send(&self.frames[..count]);
        self.acting = (command.fixture, command.segment);
        Ok(())
    }

    fn receive(&mut self) {
        let WiredRig { bus, inputs, heartbeats, twins, commanded, .. } = self;
        bus.receive(&mut |received| {
            inputs.take(received, *commanded);
            twins.see(&received.frame);
            for heartbeat in heartbeats.iter_mut().filter(|heartbeat| heartbeat.id == received.frame.id) {
                heartbeat.heard_ns = Some(received.received_ns);
            }
        });
    }

    /// What makes it impossible to go on.
    fn failure(&mut self) -> Option<(&'static str, String)> {
        let report = self.amplifier.poll();
        if let Some(fault) = report.fault {
            let what = format!("expected no fault, got {fault}; remove its cause, then start the run again");
            return Some((AMPLIFIER, what));
        }
        if let Some(refusal) = takes_none(&report) {
            return Some(refusal);
        }
        if !report.armed {
            let what = "expected an armed amplifier, got one that was gone (port lost, or silent): it is told 0 V as soon as it answers, until then its \
                        own time-out decides; see the events, then start the run again to arm it";
            return Some((AMPLIFIER, what.to_owned()));
        }
        trouble(&self.bus.state()).or_else(|| self.twins.found().map(twins::told)).map(|what| (BUS, what))
    }

    /// Why what is commanded now does not reach the rig, as far as is known.
    fn unheard(&mut self) -> Option<(&'static str, String)> {
        let report = self.amplifier.poll();
        if !report.connected {
            let what = "expected an amplifier that answers, got none: what the pump does is up to its own time-out";
            return Some((AMPLIFIER, what.to_owned()));
        }
        takes_none(&report).or_else(|| trouble(&self.bus.state()).map(|what| (BUS, what)))
    }

    fn heartbeat_age_ns(&mut self, now_ns: u64) -> u32 {
        let amplifier_ns = self.amplifier.poll().heard_ns;
        let heard = self.heartbeats.iter().map(|heartbeat| heartbeat.heard_ns.unwrap_or(0)).chain([amplifier_ns]);
        let oldest_ns = heard.min().unwrap_or(now_ns);
        u32::try_from(now_ns.saturating_sub(oldest_ns)).unwrap_or(u32::MAX)
    }
}

/// An amplifier that refuses the commanded voltage.
fn takes_none(report: &AmplifierReport) -> Option<(&'static str, String)> {
    let refused = report.refused?;
    let what = format!(
        "expected an amplifier that takes the commanded voltage, got {refused}: what the pump does is not known; {TAKES_NO_VOLTAGE}"
    );
    Some((AMPLIFIER, what))
}

/// A bus that can't be used.
fn trouble(state: &BusState) -> Option<String> {
    (!state.condition.carries_frames()).then(|| {
        let condition = state.condition;
        format!("expected a bus that carries frames, got one that is {condition}; see the events for its remedy")
    })
}

impl Device for WiredRig {
    fn begin_run(&mut self, origin_ns: u64) {
        self.origin_ns = origin_ns;
        self.commanded = None;
    }

    fn read(&mut self, now: Tick) -> Result<Measurement, DeviceError> {
        let refuse = |device, what| DeviceError { device, tick: now.index, what };
        if self.origin_ns == 0 {
            return Err(refuse(
                BUS,
                "expected real time, got virtual time: wires take their own; add --realtime".to_owned(),
            ));
        }
        self.receive();
        if let Some((device, what)) = self.failure() {
            return Err(refuse(device, what));
        }
        let mut measured = self.inputs.measurement(now, self.origin_ns);
        measured.heartbeat_age_ns = self.heartbeat_age_ns(self.origin_ns + now.scheduled_ns);
        Ok(measured)
    }

    fn write(&mut self, now: Tick, command: &Command) -> Result<(), DeviceError> {
        self.commanded = Some(now.index);
        let refuse = |device, what| DeviceError { device, tick: now.index, what };
        self.send(command, now.index, true).map_err(|error| refuse(BUS, error.to_string()))?;
        self.unheard().map_or(Ok(()), |(device, what)| Err(refuse(device, what)))
    }
}

impl Drop for WiredRig {
    fn drop(&mut self) {
        self.let_go();
    }
}
