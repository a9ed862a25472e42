//! CAN interfaces: there, up, with a bit rate, and with a controller that still takes part in the bus.

use super::{Root, Surroundings, Verdict, kernel};
use serde::Deserialize;

/// `ARPHRD_CAN` (linux/if_arp.h) in /sys/class/net/*/type.
const TYPE_CAN: i64 = 280;

/// One link as `ip -details -json link show` gives it; only what is judged here.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Link {
    ifname: String,
    flags: Vec<String>,
    linkinfo: LinkInfo,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct LinkInfo {
    info_kind: String,
    info_data: Controller,
}

/// A virtual interface has none of these.
#[derive(Debug, Default, Deserialize)]
#[serde(default)]
struct Controller {
    state: Option<String>,
    berr_counter: Option<ErrorCounters>,
    bittiming: Option<BitTiming>,
    data_bittiming: Option<BitTiming>,
    restart_ms: Option<u64>,
}

#[derive(Debug, Deserialize)]
struct ErrorCounters {
    tx: u64,
    rx: u64,
}

#[derive(Debug, Deserialize)]
struct BitTiming {
    bitrate: u64,
}

/// Those that were asked for, otherwise all there are.
pub(super) fn interfaces(surroundings: &Surroundings) -> Verdict {
    let Surroundings { root, asked, ip_links, .. } = surroundings;
    let present: Vec<String> = root
        .names("/sys/class/net")
        .into_iter()
        .filter(|name| root.number(format!("/sys/class/net/{name}/type")) == Some(TYPE_CAN))
        .collect();
    if asked.can.is_empty() && present.is_empty() {
        let (found, remedy) = missing(root, "can0");
        return Verdict::absent(
            format!("no interface{found}"),
            format!("nothing to do without CAN; otherwise {remedy}"),
        );
    }
    let links = ip_links.as_deref().map(serde_json::from_str::<Vec<serde_json::Value>>);
    let links = match links {
        None => Err("there is no `ip` (package iproute2), which tells bit rate and state".to_owned()),
        Some(Err(e)) => Err(format!("the output of `ip -details -json link show` is not understood: {e}")),
        Some(Ok(links)) => Ok(links),
    };
    let wanted = if asked.can.is_empty() { &present } else { &asked.can };
    let judged = wanted.iter().map(|name| {
        if !present.contains(name) && root.number(format!("/sys/class/net/{name}/type")).is_some() {
            return Verdict::problem(
                format!("{name} is a network interface, and none of CAN"),
                "name one of CAN, can0 as a rule",
            );
        }
        if !present.contains(name) {
            let (found, remedy) = missing(root, name);
            return Verdict::problem(format!("{name} is no CAN interface{found}"), remedy);
        }
        let link = links.as_ref().map(|links| {
            // Other kinds of links have other shapes: only this one is read.
            let mine = links.iter().find(|link| link.get("ifname").and_then(|n| n.as_str()) == Some(name));
            mine.and_then(|link| Link::deserialize(link).ok()).unwrap_or_default()
        });
        match link {
            Ok(link) if link.ifname == *name => judge(&link),
            Ok(_) => unknown(root, name, "`ip` does not describe it"),
            Err(why) => unknown(root, name, why),
        }
    });
    Verdict::over(judged.collect())
}

/// Why an interface is not there, as far as the kernel tells, and what to do.
fn missing(root: &Root, name: &str) -> (&'static str, String) {
    let configured = kernel::configuration(root)
        .map(|text| text.lines().any(|line| matches!(line, "CONFIG_CAN=y" | "CONFIG_CAN=m")));
    let connect = format!(
        "connect the adapter, then `ip link set {name} up type can bitrate 500000 restart-ms 100`; a virtual one: \
         `modprobe vcan; ip link add dev {name} type vcan; ip link set {name} up`"
    );
    match configured {
        Some(false) => (
            ": this kernel was built without CAN",
            "boot a kernel that has it (Debian: linux-image-amd64 instead of linux-image-cloud-amd64)".to_owned(),
        ),
        Some(true) | None => ("", connect),
    }
}

fn unknown(root: &Root, name: &str, why: &str) -> Verdict {
    let state = root.text(format!("/sys/class/net/{name}/operstate")).unwrap_or_else(|| "unknown".to_owned());
    Verdict::advice(
        format!("{name} {state}, bit rate and state unknown: {why}"),
        "install iproute2 (`apt-get install iproute2`) and ask again",
    )
}

fn judge(link: &Link) -> Verdict {
    let Link { ifname: name, flags, linkinfo: LinkInfo { info_kind, info_data: controller } } = link;
    let up = flags.iter().any(|flag| flag == "UP");
    if info_kind == "vcan" || info_kind == "vxcan" {
        return match up {
            true => Verdict::ok(format!("{name} up, virtual")),
            false => Verdict::problem(format!("{name} is down (virtual)"), format!("`ip link set {name} up`")),
        };
    }
    let bit_s = |timing: &Option<BitTiming>| timing.as_ref().map(|timing| timing.bitrate).filter(|&rate| rate > 0);
    let set_up = format!(
        "`ip link set {name} down; ip link set {name} up type can bitrate 500000 restart-ms 100` (with the bus's bit rate)"
    );
    if !up {
        return Verdict::problem(format!("{name} is down"), set_up);
    }
    let rate = match (bit_s(&controller.bittiming), bit_s(&controller.data_bittiming)) {
        (Some(rate), Some(data)) => format!("{rate} bit/s, data {data} bit/s"),
        (Some(rate), None) => format!("{rate} bit/s"),
        // Adapters with a fixed rate name none here.
        (None, _) => "bit rate not told".to_owned(),
    };
    let counters = match &controller.berr_counter {
        Some(ErrorCounters { tx, rx }) => format!(", errors sent {tx} received {rx}"),
        None => String::new(),
    };
    let state = controller.state.as_deref().unwrap_or("state not told");
    let found = format!("{name} {rate}, {state}{counters}");
    let wiring = "check wiring, 120 ohm at both ends, the supply of the nodes, and that all have this bit rate";
    match state {
        "ERROR-ACTIVE" if controller.restart_ms == Some(0) => Verdict::advice(
            format!("{found}, stays off the bus after a bus-off (restart-ms 0)"),
            format!("`ip link set {name} down; ip link set {name} up type can restart-ms 100`"),
        ),
        "ERROR-ACTIVE" => Verdict::ok(found),
        "ERROR-WARNING" | "ERROR-PASSIVE" => Verdict::advice(found, wiring),
        "BUS-OFF" => Verdict::problem(found, format!("{wiring}; then {set_up}")),
        "STOPPED" | "SLEEPING" => Verdict::problem(found, set_up),
        _ => Verdict::advice(found, format!("see `ip -details link show {name}`")),
    }
}
