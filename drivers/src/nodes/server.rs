//! The thread that owns pty, bus and plant: what comes is handed to them with the time at which it came.

use super::exchange::News;
use super::{CommandMap, EmulatorError, MOST_SHOWN, Order, Plant, Seen, SensorMap, Statistics, Trouble, motor};
use crate::amplifier::{Drive, DriveState, Outbox};
use crate::can::{End, Frame, FrameId, Heard, Interface, Port, TimedFrame, Wanted};
use crate::emulated::Pump;
use crate::journal::{Journal, Severity, When};
use crate::serial::{AsyncPty, Pty};
use rt_core::system::time::monotonic_ns;
use std::io;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;
use tokio::io::AsyncReadExt;
use tokio::sync::{mpsc, watch};
use tokio::time::MissedTickBehavior;

/// Time-outs and heartbeats are looked after at least so often.
const POLL: Duration = Duration::from_millis(5);
/// A bus that is gone is tried again so long after.
const AGAIN_NS: u64 = 500_000_000;

/// Everything that the thread owns, but the ends of its wires.
pub(super) struct Wiring {
    pub commands: CommandMap,
    pub sensors: SensorMap,
    pub drive: Box<dyn Drive>,
    pub plant: Plant,
    pub interface: Interface,
    /// The amplifier's.
    pub baud: u32,
    /// The amplifier's, V.
    pub supply_v: f64,
    pub journal: Journal,
    /// For those who look at the rig itself.
    pub seen: Arc<Mutex<Seen>>,
}

/// Opens the bus and starts the thread.
pub(super) fn spawn(
    wiring: Wiring,
    pty: Pty,
    prepare: impl FnOnce() + Send + 'static,
    orders: mpsc::UnboundedReceiver<Order>,
    shown: watch::Sender<Statistics>,
) -> Result<JoinHandle<()>, EmulatorError> {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_io()
        .enable_time()
        .build()
        .map_err(EmulatorError::Thread)?;
    let wanted = wiring.commands.wanted();
    let (pty, port) = {
        let _inside = runtime.enter();
        let pty = pty.into_async().map_err(EmulatorError::Thread)?;
        (pty, Port::open(&wiring.interface, Wanted::Only(&wanted), End::Binds)?)
    };
    let server = Server {
        wiring,
        wanted,
        pty,
        statistics: Statistics::default(),
        shown,
        voltage_v: 0.0,
        amplifier_timed_out: false,
        heard_amplifier: false,
        wrong_baud: None,
        troubles: Troubles::default(),
        refused: String::new(),
    };
    std::thread::Builder::new()
        .name("emulated-rig".to_owned())
        .spawn(move || {
            prepare();
            runtime.block_on(server.serve(port, orders));
        })
        .map_err(EmulatorError::Thread)
}

/// What is wrong now.
#[derive(Default)]
struct Troubles {
    fault: Option<crate::amplifier::Fault>,
    amplifier_silent: bool,
    nodes_silent: bool,
    encoder_twice: bool,
}

struct Server {
    wiring: Wiring,
    wanted: Vec<FrameId>,
    pty: AsyncPty,
    statistics: Statistics,
    shown: watch::Sender<Statistics>,
    /// In force at the amplifier, V.
    voltage_v: f64,
    amplifier_timed_out: bool,
    heard_amplifier: bool,
    /// What the bench has set instead of the amplifier's.
    wrong_baud: Option<u32>,
    troubles: Troubles,
    /// What was refused last: said once.
    refused: String,
}

impl Server {
    async fn serve(mut self, port: Port, mut orders: mpsc::UnboundedReceiver<Order>) {
        let mut port = Some(port);
        let mut again_ns = 0;
        let mut bytes = [0; 512];
        let mut clock = tokio::time::interval(POLL);
        clock.set_missed_tick_behavior(MissedTickBehavior::Delay);
        loop {
            // Frames before all else: after a stall of this thread a time-out is none while fresh commands lie unread.
            tokio::select! {
                biased;
                heard = hear(port.as_ref()) => match heard {
                    Ok(Heard::Frame(received)) => self.frame(&received, port.as_ref()),
                    Ok(Heard::Error(error)) => say(&mut self.wiring.journal, Severity::Warning, format_args!("CAN: {error:?}")),
                    Err(error) => {
                        port = None;
                        again_ns = monotonic_ns() + AGAIN_NS;
                        say(&mut self.wiring.journal, Severity::Error, format_args!("{}: gone ({error}); tried again", self.wiring.interface));
                    }
                },
                order = orders.recv() => match order {
                    Some(Order::Trouble(trouble, taken)) => {
                        self.suffer(trouble);
                        // Nobody has to wait for it.
                        let _ = taken.send(());
                    }
                    Some(Order::Stop) | None => return,
                },
                read = self.pty.read(&mut bytes) => match read {
                    Ok(count) => self.bytes(&bytes[..count]),
                    // Both ends are held open, so this is no hang-up.
                    Err(error) => {
                        say(&mut self.wiring.journal, Severity::Error, format_args!("the pty can't be read: {error}"));
                        return;
                    }
                },
                _ = clock.tick() => {}
            }
            let now_ns = monotonic_ns();
            self.pass(now_ns, port.as_ref());
            if port.is_none() && now_ns >= again_ns {
                again_ns = now_ns + AGAIN_NS;
                port = Port::open(&self.wiring.interface, Wanted::Only(&self.wanted), End::Binds).ok();
                if port.is_some() {
                    say(&mut self.wiring.journal, Severity::Info, format_args!("{}: back", self.wiring.interface));
                }
            }
        }
    }

    /// A frame of the bench.
    fn frame(&mut self, received: &TimedFrame, port: Option<&Port>) {
        let Some(sync) = self.wiring.commands.take(&received.frame) else { return };
        let answer = self.wiring.plant.sync(&sync, received.received_ns, monotonic_ns());
        {
            let mut seen = self.wiring.seen.lock().unwrap_or_else(PoisonError::into_inner);
            if !sync.running {
                seen.shown.clear();
            } else if seen.shown.back().is_none_or(|&(tick, _)| tick < self.wiring.plant.tick()) {
                if seen.shown.len() == MOST_SHOWN {
                    seen.shown.pop_front();
                }
                seen.shown.push_back((self.wiring.plant.tick(), answer.measurement));
            }
        }
        if self.troubles.nodes_silent {
            return;
        }
        let errors = self.errors();
        let unsent = &mut self.statistics.unsent;
        self.wiring.sensors.answers(&answer, errors, |frame| *unsent += u64::from(!sent(port, &frame)));
        if self.troubles.encoder_twice
            && let Some(frame) = self.wiring.sensors.encoder_twin(&answer, errors)
        {
            *unsent += u64::from(!sent(port, &frame));
        }
    }

    /// Bytes of the bench.
    fn bytes(&mut self, bytes: &[u8]) {
        let set = self.pty.pty().speed_baud().filter(|&baud| baud != self.wiring.baud);
        if set != self.wrong_baud {
            self.wrong_baud = set;
            if let Some(baud) = set {
                let expected = self.wiring.baud;
                say(
                    &mut self.wiring.journal,
                    Severity::Warning,
                    format_args!(
                        "the bench sends at {baud} baud, the amplifier listens at {expected}: nothing is understood"
                    ),
                );
            }
        }
        // What comes at another speed is noise to a UART, and noise is not answered.
        if set.is_some() || self.troubles.amplifier_silent {
            return;
        }
        if !std::mem::replace(&mut self.heard_amplifier, true) {
            say(&mut self.wiring.journal, Severity::Info, format_args!("the amplifier is spoken to"));
        }
        let now_ns = monotonic_ns();
        self.wiring.plant.poll(now_ns);
        // The newest voltage is at the motor already; the plant is told when its tick comes.
        let pump = Pump { voltage_v: self.voltage_v, ..self.wiring.plant.pump() };
        let mut telemetry = motor::telemetry(&pump, self.wiring.supply_v);
        telemetry.fault = self.troubles.fault;
        let mut out = Outbox::new();
        let commanded = self.wiring.drive.hear(bytes, now_ns, &DriveState { telemetry }, &mut out);
        if commanded.is_some() {
            self.statistics.commands += 1;
            self.drive(now_ns);
        }
        if !out.bytes().is_empty() {
            // What finds no room is lost, as on a wire.
            let _ = self.pty.pty().try_write(out.bytes());
        }
    }

    /// Takes the amplifier's voltage to the plant.
    fn drive(&mut self, now_ns: u64) {
        let voltage_v = if self.troubles.fault.is_some() { 0.0 } else { self.wiring.drive.voltage_v(now_ns) };
        self.voltage_v = voltage_v;
        self.wiring.plant.amplifier(voltage_v, now_ns);
    }

    /// What time brings by itself.
    fn pass(&mut self, now_ns: u64, port: Option<&Port>) {
        let timed_out = self.wiring.drive.timed_out(now_ns);
        if timed_out && !self.amplifier_timed_out {
            self.statistics.amplifier_timeouts += 1;
            self.heard_amplifier = false;
            say(
                &mut self.wiring.journal,
                Severity::Warning,
                format_args!("the amplifier heard nothing for too long: 0 V"),
            );
        }
        self.amplifier_timed_out = timed_out;
        let voltage_v = if self.troubles.fault.is_some() { 0.0 } else { self.wiring.drive.voltage_v(now_ns) };
        if voltage_v != self.voltage_v {
            self.drive(now_ns);
        }
        self.wiring.plant.poll(now_ns);
        if !self.troubles.nodes_silent {
            let (answer, errors) = (self.wiring.plant.answer(), self.errors());
            let unsent = &mut self.statistics.unsent;
            self.wiring.sensors.due(now_ns, &answer, errors, |frame| *unsent += u64::from(!sent(port, &frame)));
        }
        self.tell();
        let counted = self.wiring.plant.counted();
        self.statistics = Statistics {
            syncs: counted.syncs,
            repeated: counted.repeated,
            passed_over: counted.passed_over,
            late: counted.late,
            refused: counted.refused,
            node_timeouts: counted.timeouts,
            preparations: counted.preparations,
            tick: self.wiring.plant.tick(),
            ..self.statistics
        };
        self.shown.send_replace(self.statistics);
        let answer = self.wiring.plant.answer();
        let mut seen = self.wiring.seen.lock().unwrap_or_else(PoisonError::into_inner);
        seen.voltage_v = self.voltage_v;
        (seen.brake_open, seen.bypass_open) = (answer.brake_is_open, answer.bypass_is_open);
    }

    /// What the plant has to say, to the journal.
    fn tell(&mut self) {
        let when = When::MonotonicNs(monotonic_ns());
        let Wiring { plant, journal, .. } = &mut self.wiring;
        for news in plant.news() {
            match news {
                News::Prepared(of) => {
                    let plane = if of.vertical { "vertical" } else { "horizontal" };
                    let fill_bar = of.fill_bar;
                    journal.note(
                        when,
                        Severity::Info,
                        format_args!("run {}: prepared, {plane}, {fill_bar:.2} bar, {:?}", of.run, of.start.fixture),
                    );
                }
                News::TimedOut(tick) => journal.note(
                    when,
                    Severity::Warning,
                    format_args!("tick {tick}: no fresh command came in time, the valves go to their safe state"),
                ),
                News::Recovered(tick) => {
                    journal.note(when, Severity::Info, format_args!("tick {tick}: fresh commands come again"));
                }
                News::Refused(what) => {
                    if what != self.refused {
                        journal.note(when, Severity::Warning, format_args!("refused: {what}"));
                        self.refused = what;
                    }
                }
                News::Failed(what) => journal.note(when, Severity::Error, format_args!("the plant failed: {what}")),
            }
        }
    }

    fn suffer(&mut self, trouble: Trouble) {
        match trouble {
            Trouble::AmplifierFault(fault) => self.troubles.fault = fault,
            Trouble::AmplifierSilent(silent) => self.troubles.amplifier_silent = silent,
            Trouble::NodesSilent(silent) => self.troubles.nodes_silent = silent,
            Trouble::ValvesStuck(stuck) => self.wiring.plant.stick_valves(stuck),
            Trouble::EncoderTwice(twice) => self.troubles.encoder_twice = twice,
        }
    }

    fn errors(&self) -> u64 {
        let counted = self.wiring.plant.counted();
        counted.timeouts + counted.refused
    }
}

fn say(journal: &mut Journal, severity: Severity, text: std::fmt::Arguments<'_>) {
    journal.note(When::MonotonicNs(monotonic_ns()), severity, text);
}

/// The next thing on the bus; never, while there is none.
async fn hear(port: Option<&Port>) -> io::Result<Heard> {
    match port {
        Some(port) => port.receive().await,
        None => std::future::pending().await,
    }
}

/// Sends a frame, if there is a bus with room; a node has nowhere to keep it either.
fn sent(port: Option<&Port>, frame: &Frame) -> bool {
    port.is_some_and(|port| port.try_send(frame).is_ok())
}
