//! Serial ports: adapters hold back what they received until a timer ends.

use super::{Root, Surroundings, Verdict};
use rustix::fs::{Access, access};
use std::path::Path;

const ADAPTERS: &str = "/sys/bus/usb-serial/devices";
const WANTED_MS: i64 = 1;

/// The latency timer of FTDI adapters (16 ms as delivered) must be 1 ms: at 1 kHz an answer would be 16 ticks old.
pub(super) fn latency_timers(surroundings: &Surroundings) -> Verdict {
    let Surroundings { root, asked, .. } = surroundings;
    if !asked.serial.is_empty() {
        return Verdict::over(asked.serial.iter().map(|path| asked_for(root, path)).collect());
    }
    let timers = root.names(ADAPTERS).into_iter().filter_map(|name| Some((timer_ms(root, &name)?, name)));
    let verdicts: Vec<Verdict> = timers
        .map(|(ms, name)| match too_slow(ms, &name) {
            None => Verdict::ok(format!("{name} {ms} ms")),
            Some((found, remedy)) => Verdict::advice(found, remedy),
        })
        .collect();
    if verdicts.is_empty() {
        return Verdict::absent(
            "no adapter with a latency timer",
            "nothing to do without one; name the port of the rig with --serial to have it checked",
        );
    }
    Verdict::over(verdicts)
}

/// A port that the user named.
fn asked_for(root: &Root, path: &Path) -> Verdict {
    let shown = path.display();
    // Names below /dev/serial/by-id are links.
    let Ok(device) = root.at(path).canonicalize() else {
        return Verdict::problem(
            format!("{shown} does not exist"),
            "connect and power the adapter; `ls -l /dev/serial/by-id` shows those that are there",
        );
    };
    if access(&device, Access::READ_OK | Access::WRITE_OK).is_err() {
        return Verdict::problem(
            format!("{shown} may not be read and written"),
            "join the group that owns it (`usermod -aG dialout USER`) and log in again",
        );
    }
    let name = device.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    match timer_ms(root, &name) {
        None => Verdict::ok(format!("{shown} has no latency timer")),
        Some(ms) => match too_slow(ms, &name) {
            None => Verdict::ok(format!("{shown} {ms} ms")),
            Some((found, remedy)) => Verdict::problem(found, remedy),
        },
    }
}

fn timer_ms(root: &Root, name: &str) -> Option<i64> {
    root.number(format!("{ADAPTERS}/{name}/latency_timer"))
}

fn too_slow(ms: i64, name: &str) -> Option<(String, String)> {
    let remedy = || {
        format!(
            "`echo {WANTED_MS} > {ADAPTERS}/{name}/latency_timer`; for good: `ACTION==\"add\", SUBSYSTEM==\"usb-serial\", \
             DRIVER==\"ftdi_sio\", ATTR{{latency_timer}}=\"{WANTED_MS}\"` in /etc/udev/rules.d/99-ftdi.rules"
        )
    };
    (ms > WANTED_MS).then(|| (format!("{name} holds data back for {ms} ms"), remedy()))
}
