//! The loop's end of the link.

use super::shared::{Order, Shared};
use super::{LinkError, thread};
use crate::amplifier::{AmplifierError, AmplifierSettings, Fault, Firmware, Garbled, Refusal, Telemetry, protocol};
use crate::exchange::{Giver, Taker, exchange};
use crate::journal::Journal;
use crate::telemetry::{TelemetryReader, telemetry_log};
use rt_core::system::time::monotonic_ns;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, RecvTimeoutError, sync_channel};
use std::thread::JoinHandle;
use std::time::Duration;

/// Commands and reports that one side may be ahead of the other: at 1 kHz more than the age at which a command expires.
const AHEAD: usize = 64;
/// Longest that a drop waits for the thread, which takes at most `line::LAST_WORDS` for its last words.
const LONGEST_DROP: Duration = Duration::from_millis(200);

/// What is known about the amplifier.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AmplifierReport {
    /// Newest that it told; all NaN before the first.
    pub telemetry: Telemetry,
    /// When that was received: `CLOCK_MONOTONIC`, ns. 0 before the first.
    pub telemetry_ns: u64,
    /// When something was heard last that only an amplifier says (an echo of the bench's own frames is nothing of the kind): `CLOCK_MONOTONIC`, ns.
    pub heard_ns: u64,
    /// It answers.
    pub connected: bool,
    /// Commands are obeyed. If not, it is sent 0 V, whatever is commanded.
    pub armed: bool,
    /// The fault that it told last.
    pub fault: Option<Fault>,
    /// Why it does not take the commanded voltage, and has not for 10 ms: the pump does something else.
    pub refused: Option<Refusal>,
    /// Counts connections, from 1: a new one is armed anew.
    pub connection: u32,
    /// How sound was what came, since the link was opened.
    pub garbled: Garbled,
}

/// The link to the pump amplifier: a handle for the loop. The port itself is a thread's.
///
/// Nothing here waits or allocates but [`SerialLink::open`] and the drop, so that a slow or dead port never delays a tick.
pub struct SerialLink {
    orders: Giver<Order>,
    reports: Taker<AmplifierReport>,
    newest: AmplifierReport,
    /// The connection that the operator has armed; 0 = none.
    armed_for: u32,
    firmware: Firmware,
    /// `None`: taken.
    telemetry: Option<TelemetryReader>,
    shared: Arc<Shared>,
    /// Closed by the thread when it ends.
    ended: Receiver<()>,
    thread: Option<JoinHandle<()>>,
}

impl SerialLink {
    /// Opens the port, says hello, and waits at most 2 s for the answer (where none comes, somewhat longer to find out why).
    ///
    /// `prepare` is called first in the link's thread: priority and processors. The link is not armed: it sends 0 V whatever is
    /// commanded until [`SerialLink::arm`].
    ///
    /// # Errors
    /// What is wrong with settings, port or amplifier: see [`LinkError`].
    pub fn open(
        settings: &AmplifierSettings,
        prepare: impl FnOnce() + Send + 'static,
        journal: Journal,
    ) -> Result<SerialLink, LinkError> {
        let protocol = (protocol(&settings.protocol)?.client)(settings)?;
        let system = |doing| move |source| LinkError::System { doing, source };
        check(settings)?;
        let shared = Arc::new(Shared::new().map_err(system("eventfd for the serial thread"))?);
        let ((orders, orders_there), (reports_there, reports)) = (exchange(AHEAD), exchange(AHEAD));
        let (opened, opening) = sync_channel(1);
        let (ending, ended) = sync_channel(0);
        let (log, telemetry) = telemetry_log();
        let ends = thread::Ends { orders: orders_there, reports: reports_there, log, shared: shared.clone() };
        let settings = settings.clone();
        let thread = std::thread::Builder::new()
            .name("serial".into())
            .spawn(move || {
                let _ending = ending;
                prepare();
                thread::run(settings, protocol, ends, journal, &opened);
            })
            .map_err(system("starting the serial thread"))?;
        let gone = || system("the serial thread")(std::io::Error::other("it ended before it had opened the port"));
        let (firmware, newest) = opening.recv().unwrap_or_else(|_| Err(gone()))?;
        let (armed_for, telemetry, thread) = (0, Some(telemetry), Some(thread));
        Ok(SerialLink { orders, reports, newest, armed_for, firmware, telemetry, shared, ended, thread })
    }

    /// Who answered when the link was opened.
    pub fn firmware(&self) -> &Firmware {
        &self.firmware
    }

    /// Where every report of the amplifier is read, for whoever records them; `None` where somebody has it already. [`SerialLink::poll`]
    /// tells the newest only.
    pub fn take_telemetry(&mut self) -> Option<TelemetryReader> {
        self.telemetry.take()
    }

    /// Commands a voltage (V), each tick. A command is in force for 20 ms; then the pump gets 0 V until the next one.
    pub fn command(&mut self, voltage_v: f64) {
        // Where the thread has not run for so long that there is no room, the commands that it finds are too old to be obeyed.
        self.orders.give(Order { voltage_v, given_ns: monotonic_ns(), armed_for: self.armed_for });
        self.shared.wake();
    }

    /// What is known about the amplifier now.
    pub fn poll(&mut self) -> AmplifierReport {
        if let Some(report) = self.reports.newest() {
            self.newest = report;
        }
        // After a pause the queue may be full of old ones. What decides about the pump is up to date all the same.
        self.shared.renew(&mut self.newest);
        self.newest
    }

    /// The operator's word that the pump may turn: commands are obeyed from now on, until the connection is lost. It holds for the
    /// connection that there is: without one it does nothing. Begins with 0 V.
    pub fn arm(&mut self) {
        let report = self.poll();
        if report.connected && self.armed_for != report.connection {
            self.armed_for = report.connection;
            self.command(0.0);
        }
    }

    /// Takes the word back: 0 V, whatever is commanded, until [`SerialLink::arm`].
    pub fn disarm(&mut self) {
        self.armed_for = 0;
        self.command(0.0);
    }
}

/// What the link itself needs of the settings.
fn check(settings: &AmplifierSettings) -> Result<(), AmplifierError> {
    let refused = |key, value, expected| Err(AmplifierError::OutOfRange { key, value, expected });
    match settings {
        s if !(10.0..=60_000.0).contains(&s.timeout_ms) => refused("timeout_ms", s.timeout_ms, "10 to 60,000 ms"),
        s if s.telemetry_every_ticks == 0 => refused("telemetry_every_ticks", 0.0, "1 or more"),
        _ => Ok(()),
    }
}

impl Drop for SerialLink {
    /// Sends 0 V and closes the port, within 200 ms even where the port takes nothing.
    fn drop(&mut self) {
        self.shared.stop.store(true, Ordering::Release);
        self.shared.wake();
        let ended = self.ended.recv_timeout(LONGEST_DROP) != Err(RecvTimeoutError::Timeout);
        // A thread that hangs in the kernel (a driver that waits for its device) is left behind: it ends when the call returns.
        if let Some(thread) = self.thread.take().filter(|_| ended) {
            // It has ended; a panic of its own was told by the panic hook.
            let _ = thread.join();
        }
    }
}
