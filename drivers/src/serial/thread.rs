//! The thread that owns the port: commands out, telemetry in, watchdog, reconnection.
//!
//! It sleeps in one place and is woken by the loop's commands, by bytes, by room for bytes and by its deadlines. Invariants:
//! a voltage other than 0 is written only while armed and out of a command that is younger than [`EXPIRES_NS`]; nothing is encoded
//! while older bytes still wait for room, so that what is written next is the newest command and never a queue of old ones.

use super::hello::{self, REPEAT};
use super::{AmplifierReport, LinkError, port};
use crate::amplifier::{AmplifierSettings, Firmware, Garbled, Outbox, Protocol, Refusal, Told};
use crate::exchange::{Giver, Taker};
use crate::journal::{Journal, Severity, When};
use rt_core::system::time::monotonic_ns;
use rustix::event::{EventfdFlags, eventfd};
use std::future::{Future, poll_fn};
use std::io;
use std::os::fd::OwnedFd;
use std::pin::Pin;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::SyncSender;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::unix::AsyncFd;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::time::{Instant, Sleep, sleep};
use tokio_serial::{ClearBuffer, SerialPort, SerialStream};

const MS: u64 = 1_000_000;
/// A command is obeyed for so long; the loop gives one every millisecond.
const EXPIRES_NS: u64 = 20 * MS;
/// Without commands 0 V is repeated so often.
const KEEP_ALIVE_NS: u64 = 20 * MS;
/// Bytes that find no room for so long are thrown away.
const BLOCKED_NS: u64 = 20 * MS;
/// A command that waits for the driver's queue to empty is tried again after so long.
const RETRY_NS: u64 = 2 * MS;
/// An answer to a request is waited for so long at most.
const GIVE_UP_NS: u64 = 50 * MS;
/// A port that is gone is opened again so often.
const REOPEN_NS: u64 = 200 * MS;
/// The thread looks at its clock at least so often; of a longer gap it slept through, so much counts as silence.
const LOOK_NS: u64 = 20 * MS;
/// What is wrong with frames goes into the journal so often.
const COMPLAIN_NS: u64 = 1000 * MS;
/// Longest that the last 0 V may take.
pub(super) const LAST_WORDS: Duration = Duration::from_millis(120);
/// Between two looks whether they have left.
const POLL: Duration = Duration::from_millis(2);

/// What the loop gives.
#[derive(Clone, Copy)]
pub(super) struct Order {
    pub(super) voltage_v: f64,
    /// `CLOCK_MONOTONIC`, ns.
    pub(super) given_ns: u64,
    /// The connection that the operator has armed; 0 = none.
    pub(super) armed_for: u32,
}

/// What both sides hold.
pub(super) struct Shared {
    /// An eventfd: orders were given, or the thread is to end.
    wake: OwnedFd,
    pub(super) stop: AtomicBool,
    /// What of the report must not wait in a queue that nobody reads: connection * 4 + connected * 2 + armed.
    state: AtomicU64,
    heard_ns: AtomicU64,
}

impl Shared {
    pub(super) fn new() -> io::Result<Shared> {
        let wake = eventfd(0, EventfdFlags::NONBLOCK | EventfdFlags::CLOEXEC)?;
        Ok(Shared { wake, stop: AtomicBool::new(false), state: AtomicU64::new(0), heard_ns: AtomicU64::new(0) })
    }

    fn tell(&self, report: &AmplifierReport) {
        let state = u64::from(report.connection) << 2 | u64::from(report.connected) << 1 | u64::from(report.armed);
        self.state.store(state, Ordering::Release);
        self.heard_ns.store(report.heard_ns, Ordering::Release);
    }

    /// Brings a report up to date.
    pub(super) fn renew(&self, report: &mut AmplifierReport) {
        let state = self.state.load(Ordering::Acquire);
        (report.connected, report.armed) = (state & 2 != 0, state & 1 != 0);
        report.connection = (state >> 2) as u32;
        report.heard_ns = self.heard_ns.load(Ordering::Acquire);
    }

    /// One short system call. It can't fail but where the thread has not looked for 2^64 times; then it is awake.
    pub(super) fn wake(&self) {
        let _ = rustix::io::write(&self.wake, &1u64.to_ne_bytes());
    }
}

/// The thread's ends of what it shares with the loop.
pub(super) struct Ends {
    pub(super) orders: Taker<Order>,
    pub(super) reports: Giver<AmplifierReport>,
    pub(super) journal: Journal,
    pub(super) shared: Arc<Shared>,
}

/// Opens the port, says how that went, and serves it until it is told to stop.
pub(super) fn run(
    settings: AmplifierSettings,
    mut protocol: Box<dyn Protocol>,
    ends: Ends,
    opened: &SyncSender<Result<(Firmware, AmplifierReport), LinkError>>,
) {
    let system = |doing| move |source| LinkError::System { doing, source };
    let served = tokio::runtime::Builder::new_current_thread().enable_io().enable_time().build();
    let served = served.map_err(system("the serial thread's runtime")).and_then(|runtime| {
        runtime.block_on(async {
            let shared = ends.shared.clone();
            let watched = system("watching the serial thread's eventfd");
            let wake = shared.wake.try_clone().map_err(&watched)?;
            // SAFETY: an OwnedFd stays open, and its number the same, for as long as it is owned.
            let wake = unsafe { AsyncFd::register(wake) }.map_err(|e| watched(e.into()))?;
            let (stream, firmware) = hello::connect(&settings, &mut *protocol).await?;
            let mut talk = Talk::new(settings, protocol, stream, ends);
            // Nobody waits for it any more only if the opener's thread has ended: then `stop` comes, too.
            talk.tell();
            let _ = opened.send(Ok((firmware, talk.report)));
            talk.serve(&wake).await;
            talk.last_words().await;
            Ok(())
        })
    });
    if let Err(e) = served {
        let _ = opened.send(Err(e));
    }
}

/// The talk with the amplifier.
struct Talk {
    settings: AmplifierSettings,
    protocol: Box<dyn Protocol>,
    ends: Ends,
    /// `None` while it is gone.
    stream: Option<SerialStream>,
    report: AmplifierReport,
    /// The loop has not been given the report as it is now.
    untold: bool,
    order: Option<Order>,
    /// Bytes that wait for room.
    out: Outbox,
    /// A command is to be written as soon as there is room.
    due: bool,
    /// Voltage that was written last.
    sent_v: f64,
    times: Times,
    /// Commands since the last request.
    since_request: u32,
    /// Time that was seen to pass since the amplifier was asked without an answer.
    silent_ns: u64,
    /// Something was asked, and nothing heard since.
    asked: bool,
    /// Bytes that may wait in the driver's queue before another command is written.
    longest_queue: u32,
    /// Counts of earlier connections.
    garbled_before: Garbled,
    refusal: Option<Refusal>,
    told_refused: u64,
    /// That the port is there and can't be opened is in the journal.
    told_refusal: bool,
}

/// When things happened last, `CLOCK_MONOTONIC`, ns; `None` = they are not going on.
struct Times {
    looked_ns: u64,
    sent_ns: u64,
    hello_ns: u64,
    opened_ns: u64,
    /// The request that is waited for.
    requested_ns: Option<u64>,
    /// The last request.
    asked_ns: u64,
    blocked_ns: Option<u64>,
    complained_ns: Option<u64>,
    lost_ns: u64,
}

/// What a sleep ended with; several at once.
#[derive(Default)]
struct Round {
    heard: usize,
    wrote: usize,
    woken: bool,
    time: bool,
    broken: Option<io::Error>,
}

impl Talk {
    fn new(settings: AmplifierSettings, protocol: Box<dyn Protocol>, stream: SerialStream, ends: Ends) -> Talk {
        let now = monotonic_ns();
        let traffic = protocol.traffic();
        let one = (traffic.command.out + traffic.request.out) as u32;
        Talk {
            report: AmplifierReport {
                telemetry: Default::default(),
                telemetry_ns: 0,
                heard_ns: now,
                connected: true,
                armed: false,
                fault: None,
                connection: 1,
                garbled: protocol.garbled(),
            },
            // What the port sends in 2 ms at 10 bits a byte, and at least two commands.
            longest_queue: (settings.baud / 5000).max(2 * one),
            stream: Some(stream),
            untold: true,
            order: None,
            out: Outbox::new(),
            due: true,
            sent_v: 0.0,
            times: Times {
                looked_ns: now,
                sent_ns: now,
                hello_ns: now,
                opened_ns: now,
                requested_ns: None,
                asked_ns: now,
                blocked_ns: None,
                complained_ns: None,
                lost_ns: now,
            },
            since_request: settings.telemetry_every_ticks,
            silent_ns: 0,
            asked: false,
            garbled_before: Garbled::default(),
            refusal: None,
            told_refused: 0,
            told_refusal: false,
            settings,
            protocol,
            ends,
        }
    }

    async fn serve(&mut self, wake: &AsyncFd<OwnedFd>) {
        let mut bytes = [0; 1024];
        let mut alarm = std::pin::pin!(sleep(Duration::ZERO));
        let mut alarm_ns = 0;
        while !self.ends.shared.stop.load(Ordering::Acquire) {
            let round = poll_fn(|cx| self.poll(cx, wake, &mut bytes, alarm.as_mut())).await;
            let now = monotonic_ns();
            if let Some(e) = round.broken {
                self.port_gone(&e, now);
            } else {
                self.hear(&bytes[..round.heard], now);
                self.wrote(round.wrote, now);
            }
            if round.woken
                && let Some(order) = self.ends.orders.newest()
            {
                self.obey(order, now);
            }
            self.look(now);
            self.write(now);
            self.tell();
            // A timer that is too early is cheaper than one that is set anew with each command.
            let deadline_ns = self.deadline_ns(now);
            if round.time || deadline_ns < alarm_ns {
                alarm_ns = deadline_ns;
                alarm.as_mut().reset(Instant::now() + Duration::from_nanos(deadline_ns.saturating_sub(now)));
            }
        }
    }

    /// Everything that may have happened is looked at in each round, so that no flood of one keeps another waiting.
    fn poll(
        &mut self,
        cx: &mut Context<'_>,
        wake: &AsyncFd<OwnedFd>,
        bytes: &mut [u8],
        alarm: Pin<&mut Sleep>,
    ) -> Poll<Round> {
        let mut round = Round { time: alarm.poll(cx).is_ready(), ..Round::default() };
        while let Poll::Ready(Ok(mut ready)) = wake.poll_read_ready(cx) {
            // Read or not, it is 0 now: the next write makes it ready anew.
            let mut count = [0; 8];
            round.woken |= rustix::io::read(wake.get_ref(), &mut count[..]).is_ok();
            ready.clear_ready();
        }
        if let Some(stream) = &mut self.stream {
            let mut buffer = ReadBuf::new(bytes);
            match Pin::new(&mut *stream).poll_read(cx, &mut buffer) {
                Poll::Ready(Ok(())) if buffer.filled().is_empty() => {
                    round.broken = Some(io::Error::new(io::ErrorKind::UnexpectedEof, "hung up"));
                }
                Poll::Ready(Ok(())) => round.heard = buffer.filled().len(),
                Poll::Ready(Err(e)) => round.broken = Some(e),
                Poll::Pending => {}
            }
            if !self.out.is_empty() && round.broken.is_none() {
                match Pin::new(stream).poll_write(cx, self.out.bytes()) {
                    Poll::Ready(Ok(wrote)) => round.wrote = wrote,
                    Poll::Ready(Err(e)) => round.broken = Some(e),
                    Poll::Pending => {}
                }
            }
        }
        let nothing = !round.time && !round.woken && round.heard == 0 && round.wrote == 0 && round.broken.is_none();
        if nothing { Poll::Pending } else { Poll::Ready(round) }
    }

    /// The newest order of the loop.
    fn obey(&mut self, order: Order, now: u64) {
        let armed = self.report.connected && order.armed_for == self.report.connection;
        if armed != self.report.armed {
            self.report.armed = armed;
            self.untold = true;
            self.note(now, Severity::Info, if armed { "armed" } else { "disarmed" });
        }
        self.order = Some(order);
        // While nobody answers, keep-alives are enough.
        self.due |= self.report.connected;
    }

    /// Voltage (V) that is to be in force.
    fn voltage_v(&self, now: u64) -> f64 {
        match self.order {
            Some(order) if self.report.armed && now.saturating_sub(order.given_ns) <= EXPIRES_NS => order.voltage_v,
            _ => 0.0,
        }
    }

    fn hear(&mut self, bytes: &[u8], now: u64) {
        if bytes.is_empty() {
            return;
        }
        let Talk { protocol, report, ends, times, refusal, untold, .. } = self;
        let mut hello = None;
        let sound_before = protocol.garbled().sound;
        protocol.hear(bytes, &mut |told| {
            *untold = true;
            match told {
                Told::Hello(firmware) => hello = Some(firmware),
                Told::Telemetry(telemetry) => {
                    times.requested_ns = None;
                    (report.telemetry, report.telemetry_ns) = (telemetry, now);
                    if telemetry.fault != report.fault {
                        report.fault = telemetry.fault;
                        let when = When::MonotonicNs(now);
                        match telemetry.fault {
                            Some(fault) => {
                                ends.journal.note(when, Severity::Error, format_args!("the amplifier reports {fault}"));
                            }
                            None => {
                                ends.journal.note(when, Severity::Info, format_args!("the amplifier's fault is over"))
                            }
                        }
                    }
                }
                Told::Acknowledged => {}
                Told::Refused(refused) => {
                    times.requested_ns = None;
                    if refusal.replace(refused) != Some(refused) {
                        let Refusal { status, meaning, command } = refused;
                        let text = format_args!("the amplifier refused command {command}: {meaning} (status {status})");
                        ends.journal.note(When::MonotonicNs(now), Severity::Warning, text);
                    }
                }
            }
        });
        let (sum, before) = (self.protocol.garbled(), self.garbled_before);
        if sum.sound > sound_before {
            self.report.heard_ns = now;
            (self.asked, self.silent_ns, self.untold) = (false, 0, true);
        }
        self.report.garbled = Garbled {
            sound: before.sound + sum.sound,
            refused: before.refused + sum.refused,
            skipped_bytes: before.skipped_bytes + sum.skipped_bytes,
        };
        if let Some(firmware) = hello.filter(|_| !self.report.connected) {
            self.connect(&firmware, now);
        }
    }

    /// The amplifier answers again.
    fn connect(&mut self, firmware: &Firmware, now: u64) {
        self.report.connected = true;
        self.report.connection += 1;
        self.untold = true;
        self.due = true;
        self.since_request = self.settings.telemetry_every_ticks;
        let gone_ms = (now - self.times.lost_ns) / MS;
        let port = self.settings.port.display();
        let text = format_args!("{firmware} answers again at {port} after {gone_ms} ms; 0 V until it is armed");
        self.ends.journal.note(When::MonotonicNs(now), Severity::Info, text);
    }

    /// Nobody answers any more.
    fn lose(&mut self, now: u64, why: std::fmt::Arguments<'_>) {
        if self.report.connected {
            let port = self.settings.port.display();
            let text = format_args!("{port}: {why}; disarmed, 0 V until it answers and is armed again");
            self.ends.journal.note(When::MonotonicNs(now), Severity::Error, text);
            self.times.lost_ns = now;
        }
        (self.report.connected, self.report.armed, self.untold) = (false, false, true);
        (self.asked, self.silent_ns, self.times.requested_ns) = (false, 0, None);
        self.due = true;
        self.forget_output();
        let last = self.protocol.garbled();
        self.garbled_before.sound += last.sound;
        self.garbled_before.refused += last.refused;
        self.garbled_before.skipped_bytes += last.skipped_bytes;
        self.protocol.reset();
    }

    fn port_gone(&mut self, e: &io::Error, now: u64) {
        if !self.report.connected {
            let text = format_args!("{}: the port is gone ({e})", self.settings.port.display());
            self.ends.journal.note(When::MonotonicNs(now), Severity::Error, text);
        }
        self.lose(now, format_args!("the port is gone ({e})"));
        (self.stream, self.told_refusal) = (None, false);
        self.times.opened_ns = now;
    }

    /// The port took bytes.
    fn wrote(&mut self, bytes: usize, now: u64) {
        self.out.written(bytes);
        if self.out.is_empty() {
            self.times.blocked_ns = None;
        } else if bytes > 0 || self.times.blocked_ns.is_none() {
            self.times.blocked_ns = Some(now);
        }
    }

    /// What has not left yet must not leave later.
    fn forget_output(&mut self) {
        self.out.clear();
        self.times.blocked_ns = None;
        if let Some(stream) = &self.stream {
            // A port that refuses is about to be found broken.
            let _ = stream.clear(ClearBuffer::Output);
        }
    }

    /// What the time asks for.
    fn look(&mut self, now: u64) {
        // A gap that this thread (or the machine) slept through is not the amplifier's silence.
        let seen_ns = (now - self.times.looked_ns).min(LOOK_NS);
        self.times.looked_ns = now;
        if self.stream.is_none() {
            return self.reopen(now);
        }
        let timeout_ns = self.timeout_ns();
        if self.report.connected {
            if self.asked {
                self.silent_ns += seen_ns;
            }
            if self.silent_ns > timeout_ns {
                let ms = self.silent_ns / MS;
                self.lose(now, format_args!("no sound frame for {ms} ms, expected one within {} ms", timeout_ns / MS));
            }
        }
        self.due |= self.idle(now) || self.expired(now);
        if self.times.blocked_ns.is_some_and(|since| now.saturating_sub(since) > BLOCKED_NS) {
            // A command among them would be old when it leaves. The other side finds the next frame's beginning by itself.
            self.forget_output();
        }
        self.complain(now);
    }

    /// A voltage is in force whose command is too old.
    fn expired(&self, now: u64) -> bool {
        self.sent_v != 0.0 && self.order.is_none_or(|order| now.saturating_sub(order.given_ns) > EXPIRES_NS)
    }

    /// It is time for a sign of life.
    fn idle(&self, now: u64) -> bool {
        now.saturating_sub(self.times.sent_ns) >= self.keep_alive_ns()
    }

    fn timeout_ns(&self) -> u64 {
        (self.settings.timeout_ms * MS as f64) as u64
    }

    /// Three requests, or what the amplifier itself wants, whichever is more often.
    fn keep_alive_ns(&self) -> u64 {
        KEEP_ALIVE_NS.min(self.timeout_ns() / 3)
    }

    /// When there is something to do at the latest.
    fn deadline_ns(&self, now: u64) -> u64 {
        let times = &self.times;
        let mut deadline_ns = now + LOOK_NS;
        let mut by = |ns: u64| deadline_ns = deadline_ns.min(ns);
        if self.untold {
            by(now + RETRY_NS);
        }
        if self.stream.is_none() {
            by(times.opened_ns + REOPEN_NS);
        } else if let Some(since) = times.blocked_ns {
            by(since + BLOCKED_NS + 1);
        } else if self.due {
            by(now + RETRY_NS);
        } else {
            by(times.sent_ns + self.keep_alive_ns());
            if let Some(order) = self.order.filter(|_| self.sent_v != 0.0) {
                by(order.given_ns + EXPIRES_NS + 1);
            }
        }
        // Whatever the sums say, this thread does not spin.
        deadline_ns.max(now + MS)
    }

    /// Hands the report over; where the loop does not take it, later.
    fn tell(&mut self) {
        if self.untold {
            self.ends.shared.tell(&self.report);
            self.untold = !self.ends.reports.give(self.report);
        }
    }

    /// Damaged frames, at most once a second.
    fn complain(&mut self, now: u64) {
        let refused = self.report.garbled.refused;
        let lately = self.times.complained_ns.is_some_and(|at| now - at < COMPLAIN_NS);
        if refused > self.told_refused && !lately {
            let text =
                format_args!("{} damaged frames from the amplifier, {refused} in all", refused - self.told_refused);
            self.ends.journal.note(When::MonotonicNs(now), Severity::Warning, text);
            (self.told_refused, self.times.complained_ns) = (refused, Some(now));
        }
    }

    fn reopen(&mut self, now: u64) {
        if now.saturating_sub(self.times.opened_ns) < REOPEN_NS {
            return;
        }
        self.times.opened_ns = now;
        match port::open(&self.settings.port, self.settings.baud) {
            Ok(stream) => {
                self.stream = Some(stream);
                self.times.hello_ns = 0;
                self.due = true;
            }
            Err(LinkError::NoSuchPort { .. }) => {}
            // udev may still be at work, so it is tried again all the same.
            Err(e) if !self.told_refusal => {
                self.ends.journal.note(When::MonotonicNs(now), Severity::Warning, format_args!("{e}"));
                self.told_refusal = true;
            }
            Err(_) => {}
        }
    }

    /// Writes what is due, as one piece: hello or command, and a request.
    fn write(&mut self, now: u64) {
        let Some(stream) = &mut self.stream else { return };
        if !self.due || !self.out.is_empty() {
            return;
        }
        // A pty does not say how much waits, and always says 0.
        if stream.bytes_to_write().is_ok_and(|waiting| waiting > self.longest_queue) {
            return;
        }
        self.due = false;
        let idle = self.idle(now);
        if !self.report.connected && now.saturating_sub(self.times.hello_ns) >= REPEAT.as_nanos() as u64 {
            self.times.hello_ns = now;
            self.protocol.hello(&mut self.out);
        }
        if self.report.armed && self.expired(now) {
            let age_ms = self.order.map_or(0, |order| (now - order.given_ns) / MS);
            let text = format_args!("no command for {age_ms} ms, expected one every tick; 0 V until the next");
            self.ends.journal.note(When::MonotonicNs(now), Severity::Warning, text);
        }
        let voltage_v = self.voltage_v(now);
        self.protocol.command(voltage_v, &mut self.out);
        (self.sent_v, self.times.sent_ns) = (voltage_v, now);
        if idle {
            self.protocol.keep_alive(&mut self.out);
        }
        if self.report.connected {
            self.request(now, idle);
        }
        let Some(stream) = &mut self.stream else { return };
        // Without asking first whether there is room: nearly always there is.
        match stream.try_write(self.out.bytes()) {
            Ok(wrote) => self.wrote(wrote, now),
            Err(e) if e.kind() == io::ErrorKind::WouldBlock => self.wrote(0, now),
            Err(e) => self.port_gone(&e, now),
        }
    }

    /// Asks for telemetry with this command, if it is its turn; at most one answer is waited for.
    fn request(&mut self, now: u64, idle: bool) {
        self.since_request += 1;
        let give_up_ns = (self.timeout_ns() / 2).min(GIVE_UP_NS);
        let outstanding = self.times.requested_ns.is_some_and(|at| now - at < give_up_ns);
        let turn = self.since_request >= self.settings.telemetry_every_ticks;
        let late = now.saturating_sub(self.times.asked_ns) >= self.timeout_ns() / 3;
        if !outstanding && (turn || idle || late) {
            self.protocol.request(&mut self.out);
            (self.times.requested_ns, self.times.asked_ns) = (Some(now), now);
            (self.since_request, self.asked) = (0, true);
        }
    }

    /// 0 V, waiting a little for it to leave.
    async fn last_words(&mut self) {
        let end = Instant::now() + LAST_WORDS;
        if self.times.blocked_ns.is_some() {
            self.forget_output();
        }
        self.protocol.command(0.0, &mut self.out);
        let Some(stream) = &mut self.stream else { return };
        while !self.out.is_empty() && Instant::now() < end {
            match stream.try_write(self.out.bytes()) {
                Ok(wrote) => self.out.written(wrote),
                Err(e) if e.kind() == io::ErrorKind::WouldBlock => sleep(POLL).await,
                Err(_) => return,
            }
        }
        // Not tcdrain(3): it waits for ever where the port is stuck.
        while stream.bytes_to_write().is_ok_and(|waiting| waiting > 0) && Instant::now() < end {
            sleep(POLL).await;
        }
        if Instant::now() >= end {
            // Or closing it waits for what does not leave, 30 s as a rule.
            let _ = stream.clear(ClearBuffer::Output);
        }
    }

    fn note(&mut self, now: u64, severity: Severity, text: &str) {
        self.ends.journal.note(When::MonotonicNs(now), severity, format_args!("{text}"));
    }
}
