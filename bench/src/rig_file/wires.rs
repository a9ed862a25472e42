//! `[amplifier]`, `[can]` and `[budget]`: everything that can be said about the wires without touching them.

use super::document::{Document, label};
use super::problems::{Problems, meant};
use super::signals::Mapping;
use drivers::amplifier::{AmplifierError, PROTOCOLS, protocol};
use drivers::budget::{Load, can_load, serial_load};
use drivers::can::Interface;
use drivers::dbc::Database;
use drivers::wired::{InputMap, OutputMap, Settings};
use rt_core::{Limits, PERIOD_NS};

/// Rates that serial ports of Linux know by name (termios), from the lowest that carries a command a tick.
const BAUD_RATES: [u32; 18] = [
    9_600, 19_200, 38_400, 57_600, 115_200, 230_400, 460_800, 500_000, 576_000, 921_600, 1_000_000, 1_152_000,
    1_500_000, 2_000_000, 2_500_000, 3_000_000, 3_500_000, 4_000_000,
];

/// Answers of the amplifier that may be lost in a row before it counts as gone.
const LOST_ANSWERS: f64 = 1.0;

const TICK_MS: f64 = PERIOD_NS as f64 * 1e-6;

/// What is checked with everything else of the file.
pub(super) struct Wires<'a> {
    pub(super) settings: &'a Settings,
    pub(super) limits: &'a Limits,
    /// Largest voltage of the rig, V, where the file says it.
    pub(super) u_max_v: Option<f64>,
    /// Largest share of each wire.
    pub(super) most_share: f64,
    pub(super) document: &'a Document,
    pub(super) problems: &'a mut Problems,
}

impl Wires<'_> {
    pub(super) fn check(mut self) {
        let protocol_known = self.amplifier();
        if !self.settings.can.interface.is_empty()
            && let Err(error) = self.settings.can.interface.parse::<Interface>()
        {
            self.problem("can.interface", error.to_string());
        }
        if protocol_known && !self.document.refused("amplifier") && BAUD_RATES.contains(&self.settings.amplifier.baud) {
            self.serial_budget();
        }
        if self.settings.can.dbc.as_os_str().is_empty() {
            return;
        }
        match Database::read(&self.settings.can.dbc) {
            Ok(database) => self.bus(&database),
            Err(error) => self.problem("can.dbc", error.to_string()),
        }
    }

    fn problem(&mut self, path: &str, what: impl AsRef<str>) {
        self.problems.add(self.document.line(path), format!("{}: {}", label(path), what.as_ref()));
    }

    /// Whether the protocol is one that the bench speaks.
    fn amplifier(&mut self) -> bool {
        let amplifier = &self.settings.amplifier;
        let full_scale_v = amplifier.full_scale_v;
        if let Some(u_max_v) = self.u_max_v
            && full_scale_v < u_max_v
        {
            let what = format!(
                "expected at least [rig] u_max_v = {u_max_v}, got {full_scale_v}: commands above {full_scale_v} V would be clipped; lower u_max_v, \
                 or correct the supply's voltage here"
            );
            self.problem("amplifier.full_scale_v", what);
        }
        if !BAUD_RATES.contains(&amplifier.baud) && !self.document.refused("amplifier.baud") {
            let rates = BAUD_RATES.map(|rate| rate.to_string()).join(", ");
            self.problem(
                "amplifier.baud",
                format!("expected a rate that serial ports have, got {}; there is {rates}", amplifier.baud),
            );
        }
        let period_ms = f64::from(amplifier.telemetry_every_ticks) * TICK_MS;
        let heartbeat_max_ms = self.limits.heartbeat_max_ms;
        if period_ms >= heartbeat_max_ms {
            let what = format!(
                "expected less than [limits] heartbeat_max_ms = {heartbeat_max_ms}, got {period_ms} ms: an amplifier in order would trip; ask more \
                 often, or raise the limit"
            );
            self.problem("amplifier.telemetry_every_ticks", what);
        }
        let least_ms = (1.0 + LOST_ANSWERS) * period_ms;
        if amplifier.timeout_ms < least_ms {
            let what = format!(
                "expected at least {least_ms} ms, twice the {period_ms} ms between two requests for telemetry, got {}: one lost answer would \
                 disarm the pump",
                amplifier.timeout_ms
            );
            self.problem("amplifier.timeout_ms", what);
        }
        if amplifier.protocol.is_empty() {
            return false;
        }
        let Ok(kind) = protocol(&amplifier.protocol) else {
            let names = PROTOCOLS.iter().map(|kind| kind.name);
            let nearest = meant(&amplifier.protocol, names);
            let known: Vec<String> = PROTOCOLS.iter().map(|kind| format!("{:?} ({})", kind.name, kind.title)).collect();
            let what = format!("expected one of {}, got {:?}{nearest}", known.join(", "), amplifier.protocol);
            self.problem("amplifier.protocol", what);
            return false;
        };
        if !self.document.refused("amplifier")
            && let Err(error) = (kind.client)(amplifier)
        {
            let (path, what) = match &error {
                AmplifierError::OutOfRange { key, value, expected } => {
                    (format!("amplifier.{key}"), format!("expected {expected}, got {value}"))
                }
                AmplifierError::UnknownModule { name, known } => {
                    ("amplifier.tmcl.module".to_owned(), format!("expected one of {known}, got {name:?}"))
                }
                AmplifierError::UnknownProtocol { .. } => ("amplifier.protocol".to_owned(), error.to_string()),
            };
            self.problem(&path, what);
        }
        true
    }

    fn serial_budget(&mut self) {
        // What is wrong with the settings was said.
        let Ok(loads) = serial_load(&self.settings.amplifier) else { return };
        for load in loads {
            let remedy = "raise [amplifier] baud, or ask for telemetry less often";
            self.judge(&load, "amplifier.baud", remedy);
        }
    }

    fn bus(&mut self, database: &Database) {
        let can = &self.settings.can;
        let Wires { limits, document, .. } = self;
        Mapping { settings: can, database, limits, document, problems: self.problems }.check();
        // The driver's own look at the mapping, in case it refuses what the checks above let pass.
        if !self.document.refused("can") && self.problems.is_empty() {
            let refusals = [InputMap::new(can, database).err(), OutputMap::new(can, database).err()];
            for error in refusals.into_iter().flatten() {
                self.problems.add(self.document.line("can"), error.to_string());
            }
        }
        let remedy = "raise the bit rate, let nodes send less often, or pack signals into fewer messages";
        self.judge(&can_load(database, can), "can.bitrate", remedy);
    }

    fn judge(&mut self, load: &Load, path: &str, remedy: &str) {
        let Err(sum) = load.judge(self.most_share) else { return };
        let lines: String =
            load.entries.iter().map(|entry| format!("\n       {:8.1} bits  {}", entry.bits, entry.what)).collect();
        self.problems.add(self.document.line(path), format!("[budget] {sum}; {remedy}; of these{lines}"));
    }
}
