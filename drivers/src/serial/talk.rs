//! What is said to the amplifier when, and what is believed of it: commands, requests, silence, arming. No port and no clock: bytes
//! and times are arguments.
//!
//! Invariant: a voltage other than 0 is said only while armed and out of a command that is younger than [`EXPIRES_NS`].

use super::AmplifierReport;
use super::hello::REPEAT;
use super::shared::Order;
use crate::amplifier::{AmplifierSettings, Firmware, Garbled, Outbox, Protocol, Refusal, Told};
use crate::journal::{Journal, Severity, When};
use crate::telemetry::{Arrived, TelemetryLog};
use std::io;

pub(super) const MS: u64 = 1_000_000;
/// A command is obeyed for so long; the loop gives one every millisecond.
const EXPIRES_NS: u64 = 20 * MS;
/// Without commands 0 V is repeated so often.
const KEEP_ALIVE_NS: u64 = 20 * MS;
/// What could not be said or told now is tried again after so long.
const RETRY_NS: u64 = 2 * MS;
/// An answer to a request is waited for so long at most.
const GIVE_UP_NS: u64 = 50 * MS;
/// The thread looks at its clock at least so often; of a longer gap it slept through, so much counts as silence.
const LOOK_NS: u64 = 20 * MS;
/// Voltages are refused for so long before the amplifier counts as one that does not take them: a frame that was spoilt on its way is refused as well.
const REFUSED_NS: u64 = 10 * MS;
/// What is wrong with frames goes into the journal so often.
const COMPLAIN_NS: u64 = 1000 * MS;

/// The talk with the amplifier.
pub(super) struct Talk {
    settings: AmplifierSettings,
    protocol: Box<dyn Protocol>,
    journal: Journal,
    pub(super) report: AmplifierReport,
    /// The loop has not been given the report as it is now.
    pub(super) untold: bool,
    order: Option<Order>,
    /// A command is to be said as soon as there is room.
    due: bool,
    /// Voltage that was said last.
    sent_v: f64,
    times: Times,
    /// Commands since the last request.
    since_request: u32,
    /// Time that was seen to pass since the amplifier was asked without an answer.
    silent_ns: u64,
    /// Something was asked, and nothing heard since.
    asked: bool,
    /// Counts of earlier connections.
    garbled_before: Garbled,
    refusal: Option<Refusal>,
    told_refused: u64,
}

/// When things happened last, `CLOCK_MONOTONIC`, ns; `None` = they are not going on.
struct Times {
    looked_ns: u64,
    sent_ns: u64,
    hello_ns: u64,
    /// The request that is waited for.
    requested_ns: Option<u64>,
    /// The last request.
    asked_ns: u64,
    complained_ns: Option<u64>,
    lost_ns: u64,
    /// The first voltage that was refused since one was taken.
    refused_ns: Option<u64>,
}

impl Talk {
    /// With an amplifier that has just answered.
    pub(super) fn new(settings: AmplifierSettings, protocol: Box<dyn Protocol>, journal: Journal, now: u64) -> Talk {
        Talk {
            report: AmplifierReport {
                telemetry: Default::default(),
                telemetry_ns: 0,
                heard_ns: now,
                connected: true,
                armed: false,
                fault: None,
                refused: None,
                connection: 1,
                garbled: protocol.garbled(),
            },
            untold: true,
            order: None,
            due: true,
            sent_v: 0.0,
            times: Times {
                looked_ns: now,
                sent_ns: now,
                hello_ns: now,
                requested_ns: None,
                asked_ns: now,
                complained_ns: None,
                lost_ns: now,
                refused_ns: None,
            },
            since_request: settings.telemetry_every_ticks,
            silent_ns: 0,
            asked: false,
            garbled_before: Garbled::default(),
            refusal: None,
            told_refused: 0,
            settings,
            protocol,
            journal,
        }
    }

    /// The newest order of the loop.
    pub(super) fn obey(&mut self, order: Order, now: u64) {
        let armed = self.report.connected && order.armed_for == self.report.connection;
        if armed != self.report.armed {
            self.report.armed = armed;
            self.untold = true;
            self.note(now, Severity::Info, format_args!("{}", if armed { "armed" } else { "disarmed" }));
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

    /// Bytes of the amplifier; every report in them goes to the log.
    pub(super) fn hear(&mut self, bytes: &[u8], now: u64, log: &mut TelemetryLog) {
        if bytes.is_empty() {
            return;
        }
        let Talk { protocol, report, journal, times, refusal, untold, .. } = self;
        let (mut hello, mut answered) = (None, false);
        protocol.hear(bytes, &mut |told| {
            (answered, *untold) = (true, true);
            match told {
                Told::Hello(firmware) => hello = Some(firmware),
                Told::Telemetry(telemetry) => {
                    times.requested_ns = None;
                    (report.telemetry, report.telemetry_ns) = (telemetry, now);
                    log.note(Arrived { received_ns: now, telemetry });
                    if telemetry.fault != report.fault {
                        report.fault = telemetry.fault;
                        let when = When::MonotonicNs(now);
                        match telemetry.fault {
                            Some(fault) => {
                                journal.note(when, Severity::Error, format_args!("the amplifier reports {fault}"));
                            }
                            None => journal.note(when, Severity::Info, format_args!("the amplifier's fault is over")),
                        }
                    }
                }
                Told::Acknowledged => (times.refused_ns, report.refused) = (None, None),
                Told::Refused(refused) => {
                    if refused.of_voltage {
                        let since_ns = *times.refused_ns.get_or_insert(now);
                        report.refused = report.refused.or((now - since_ns >= REFUSED_NS).then_some(refused));
                    } else {
                        times.requested_ns = None;
                    }
                    if refusal.replace(refused) != Some(refused) {
                        let text = format_args!("the amplifier refused: {refused}");
                        journal.note(When::MonotonicNs(now), Severity::Warning, text);
                    }
                }
            }
        });
        let (sum, before) = (self.protocol.garbled(), self.garbled_before);
        // A sound frame that tells nothing may be the line's echo of the bench's own.
        if answered {
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
        (self.report.refused, self.times.refused_ns) = (None, None);
        self.untold = true;
        self.due = true;
        self.since_request = self.settings.telemetry_every_ticks;
        let gone_ms = (now - self.times.lost_ns) / MS;
        let port = self.settings.port.display();
        let text = format_args!("{firmware} answers again at {port} after {gone_ms} ms; 0 V until it is armed");
        self.journal.note(When::MonotonicNs(now), Severity::Info, text);
    }

    /// Nobody answers any more. What was not written yet must not be.
    fn lose(&mut self, now: u64, why: std::fmt::Arguments<'_>) {
        if self.report.connected {
            let port = self.settings.port.display();
            let text = format_args!("{port}: {why}; disarmed, 0 V until it answers and is armed again");
            self.journal.note(When::MonotonicNs(now), Severity::Error, text);
            self.times.lost_ns = now;
        }
        (self.report.connected, self.report.armed, self.untold) = (false, false, true);
        (self.asked, self.silent_ns, self.times.requested_ns) = (false, 0, None);
        self.due = true;
        let last = self.protocol.garbled();
        self.garbled_before.sound += last.sound;
        self.garbled_before.refused += last.refused;
        self.garbled_before.skipped_bytes += last.skipped_bytes;
        self.protocol.reset();
    }

    /// The port is gone; what was not written yet went with it.
    pub(super) fn port_gone(&mut self, e: &io::Error, now: u64) {
        if !self.report.connected {
            let text = format_args!("{}: the port is gone ({e})", self.settings.port.display());
            self.journal.note(When::MonotonicNs(now), Severity::Error, text);
        }
        self.lose(now, format_args!("the port is gone ({e})"));
    }

    /// There is a port again: hello first.
    pub(super) fn port_opened(&mut self) {
        self.times.hello_ns = 0;
        self.due = true;
    }

    /// What the time asks for. `true` = the amplifier was lost by it: what was not written yet must not be.
    pub(super) fn look(&mut self, now: u64, port_open: bool) -> bool {
        // A gap that this thread (or the machine) slept through is not the amplifier's silence.
        let seen_ns = (now - self.times.looked_ns).min(LOOK_NS);
        self.times.looked_ns = now;
        if !port_open {
            return false;
        }
        let timeout_ns = self.timeout_ns();
        let mut lost = false;
        if self.report.connected {
            if self.asked {
                self.silent_ns += seen_ns;
            }
            lost = self.silent_ns > timeout_ns;
            if lost {
                let ms = self.silent_ns / MS;
                self.lose(now, format_args!("no answer for {ms} ms, expected one within {} ms", timeout_ns / MS));
            }
        }
        self.due |= self.idle(now) || self.expired(now);
        self.complain(now);
        lost
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

    /// When there is something to do at the latest, where the port is there and takes bytes.
    pub(super) fn deadline_ns(&self, now: u64) -> u64 {
        if self.due {
            return now + RETRY_NS;
        }
        let sign_of_life_ns = self.times.sent_ns + self.keep_alive_ns();
        match self.order.filter(|_| self.sent_v != 0.0) {
            Some(order) => sign_of_life_ns.min(order.given_ns + EXPIRES_NS + 1),
            None => sign_of_life_ns,
        }
    }

    /// When to look at the latest, whatever the port does.
    pub(super) fn look_again_ns(&self, now: u64) -> u64 {
        now + if self.untold { RETRY_NS } else { LOOK_NS }
    }

    /// Damaged frames, at most once a second.
    fn complain(&mut self, now: u64) {
        let refused = self.report.garbled.refused;
        let lately = self.times.complained_ns.is_some_and(|at| now - at < COMPLAIN_NS);
        if refused > self.told_refused && !lately {
            let text =
                format_args!("{} damaged frames from the amplifier, {refused} in all", refused - self.told_refused);
            self.journal.note(When::MonotonicNs(now), Severity::Warning, text);
            (self.told_refused, self.times.complained_ns) = (refused, Some(now));
        }
    }

    /// Something is to be said.
    pub(super) fn is_due(&self) -> bool {
        self.due
    }

    /// What is due, as one piece: hello or command, and a request.
    pub(super) fn say(&mut self, now: u64, out: &mut Outbox) {
        self.due = false;
        let idle = self.idle(now);
        if !self.report.connected && now.saturating_sub(self.times.hello_ns) >= REPEAT.as_nanos() as u64 {
            self.times.hello_ns = now;
            self.protocol.hello(out);
        }
        if self.report.armed && self.expired(now) {
            let age_ms = self.order.map_or(0, |order| (now - order.given_ns) / MS);
            let text = format_args!("no command for {age_ms} ms, expected one every tick; 0 V until the next");
            self.journal.note(When::MonotonicNs(now), Severity::Warning, text);
        }
        let voltage_v = self.voltage_v(now);
        self.protocol.command(voltage_v, out);
        (self.sent_v, self.times.sent_ns) = (voltage_v, now);
        if idle {
            self.protocol.keep_alive(out);
        }
        if self.report.connected {
            self.request(now, idle, out);
        }
    }

    /// Asks for telemetry with this command, if it is its turn; at most one answer is waited for.
    fn request(&mut self, now: u64, idle: bool, out: &mut Outbox) {
        self.since_request += 1;
        let give_up_ns = (self.timeout_ns() / 2).min(GIVE_UP_NS);
        let outstanding = self.times.requested_ns.is_some_and(|at| now - at < give_up_ns);
        let turn = self.since_request >= self.settings.telemetry_every_ticks;
        let late = now.saturating_sub(self.times.asked_ns) >= self.timeout_ns() / 3;
        if !outstanding && (turn || idle || late) {
            self.protocol.request(out);
            (self.times.requested_ns, self.times.asked_ns) = (Some(now), now);
            (self.since_request, self.asked) = (0, true);
        }
    }

    /// 0 V.
    pub(super) fn last_words(&mut self, out: &mut Outbox) {
        self.protocol.command(0.0, out);
    }

    pub(super) fn note(&mut self, now: u64, severity: Severity, text: std::fmt::Arguments<'_>) {
        self.journal.note(When::MonotonicNs(now), severity, text);
    }
}
