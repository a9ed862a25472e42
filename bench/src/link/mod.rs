//! Samples and commands of a run across machines, over zenoh. One end stands on the rig's machine ([`serve`]), the other one anywhere
//! ([`connect`]); there the run has an instance's name of its own, and every program that knows shared memory works as it is.
//!
//! | key | pattern | carries |
//! |---|---|---|
//! | `rec-bench/<instance>/sample` | put | samples of some 10 ms: [`recordings::carry`]; a run's last one for some seconds again and again |
//! | `rec-bench/<instance>/state` | put, five times a second | [`State`]: the sign of life |
//! | `rec-bench/<instance>/setup?run=N` | query | what run N is, as [`rt_core::announce`] has it |
//! | `rec-bench/<instance>/command` | query | [`message::Asked`], answered by [`message::Said`] |
//!
//! Nothing on the rig's side waits for the network: samples that find no room are dropped, and the far end sees the gap by their
//! numbers.

pub mod connect;
mod line;
pub mod message;
pub mod passage;
pub mod serve;

use crate::failure::{Failure, Kind};
use serde::{Deserialize, Serialize};
use std::fmt::Display;
use std::net::TcpListener;
use zenoh::{Config, Session, Wait};

/// Port where none is named.
pub const PORT: u16 = 7447;
/// Version of the messages in JSON.
pub const VERSION: u32 = 1;
/// What the operating system may hold back of what was sent, bytes: about a third of a second of samples. More would make a slow network
/// show the past instead of gaps.
const SOCKET_BYTES: u32 = 65_536;
/// A connection whose other end has been silent for so long is closed, ms.
const LEASE_MS: u32 = 3_000;

/// What the rig's end says of itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct State {
    /// [`VERSION`].
    pub version: u32,
    /// Whether it takes commands.
    pub control: bool,
    /// Samples that were handed to the network since it began.
    pub sent: u64,
    /// Samples that did not reach the rig's end itself.
    pub missed: u64,
}

/// The key of a part of an instance.
pub(crate) fn key(instance: &str, part: &str) -> String {
    format!("rec-bench/{instance}/{part}")
}

/// An address as people write it: `HOST`, `HOST:PORT` or `tcp/HOST:PORT`.
///
/// # Errors
/// It is none (2).
pub fn endpoint(address: &str) -> Result<String, Failure> {
    let wrong = |got: &str| {
        let message =
            format!("{address:?}: expected HOST, HOST:PORT or [IPV6]:PORT, got {got}; such as 192.168.1.7:{PORT}");
        Failure::new(Kind::Input, message)
    };
    let bare = address.strip_prefix("tcp/").unwrap_or(address);
    if bare.is_empty() || bare.contains(['/', '#', '?', ' ', ';']) {
        return Err(wrong("something else"));
    }
    // The colons of a bare IPv6 address are no port's.
    let (host, port) = match bare.rsplit_once(':') {
        _ if bare.ends_with(']') => (bare, PORT),
        Some((host, _)) if host.contains(':') && !host.ends_with(']') => {
            return Err(wrong("an IPv6 address without brackets"));
        }
        Some((host, port)) => (host, port.parse::<u16>().map_err(|_| wrong(&format!("the port {port:?}")))?),
        None => (bare, PORT),
    };
    if host.is_empty() { Err(wrong("no host")) } else { Ok(format!("tcp/{host}:{port}")) }
}

/// A session that speaks to nobody but these: no search in the network, no forwarding.
fn session(listen: &[String], connect: &[String]) -> Result<Session, Failure> {
    let list = |addresses: &[String]| serde_json::to_string(addresses).map_err(|e| Failure::of(Kind::Internal, &e));
    let settings = [
        ("mode", "\"peer\"".to_owned()),
        ("listen/endpoints", list(listen)?),
        ("connect/endpoints", list(connect)?),
        // An end that is not there yet is waited for in the background.
        ("connect/timeout_ms", "-1".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("connect/retry", r#"{"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 2}"#.to_owned()),
        ("scouting/multicast/enabled", "false".to_owned()),
        ("scouting/gossip/enabled", "false".to_owned()),
        ("open/return_conditions/connect_scouted", "false".to_owned()),
        ("open/return_conditions/declares", "false".to_owned()),
        ("transport/link/tx/lease", LEASE_MS.to_string()),
        ("transport/link/tcp", format!(r#"{{"so_sndbuf": {SOCKET_BYTES}, "so_rcvbuf": {SOCKET_BYTES}}}"#)),
    ];
    let mut config = Config::default();
    for (key, value) in settings {
        config.insert_json5(key, &value).map_err(|e| broken(&format!("zenoh's setting {key}"), &e))?;
    }
    zenoh::open(config).wait().map_err(|e| broken("opening", &e))
}

/// Whether the address is this machine's and free, in the system's own words, which zenoh's wrap.
fn free(endpoint: &str) -> Result<(), Failure> {
    TcpListener::bind(endpoint.trim_start_matches("tcp/")).map(drop).map_err(|error| {
        let message = format!(
            "{endpoint}: expected an address of this machine and a port that is free, got \"{error}\"; choose another --listen"
        );
        Failure::new(Kind::Device, message)
    })
}

/// What zenoh itself refuses.
fn broken(what: &str, error: &dyn Display) -> Failure {
    Failure::new(Kind::Device, format!("link: {what} failed: {error}; end the command and start it again"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_as_people_write_them() {
        for (written, meant) in [
            ("rig", "tcp/rig:7447"),
            ("10.0.0.1", "tcp/10.0.0.1:7447"),
            ("tcp/10.0.0.1:9", "tcp/10.0.0.1:9"),
            ("[::1]", "tcp/[::1]:7447"),
            ("[::1]:80", "tcp/[::1]:80"),
        ] {
            assert_eq!(endpoint(written).expect(written), meant);
        }
        for wrong in ["", ":7447", "rig:port", "rig:70000", "::1", "udp/10.0.0.1:7", "a b"] {
            let failure = endpoint(wrong).expect_err(wrong);
            assert_eq!(failure.exit_code(), 2);
            assert!(failure.message.contains("expected HOST"), "{failure}");
        }
    }
}
