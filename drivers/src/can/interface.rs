//! Which bus: an interface of the system, or a Unix socket in place of one.

use super::CanError;
use std::fmt;
use std::path::PathBuf;
use std::str::FromStr;

/// `ARPHRD_CAN` (linux/if_arp.h).
const TYPE_CAN: &str = "280";
/// `IFF_UP` (linux/if.h).
const UP: u32 = 1;
/// Longest name of a network interface: `IFNAMSIZ` - 1.
const LONGEST_NAME: usize = 15;

/// A CAN bus.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Interface {
    /// An interface of the system (`can0`, `vcan0`): classic CAN over SocketCAN.
    SocketCan(String),
    /// A Unix socket (`SOCK_SEQPACKET`) in place of a bus, a `struct can_frame` a packet: for machines without CAN. One end binds it
    /// (the emulated rig), the other connects.
    Unix(PathBuf),
}

impl FromStr for Interface {
    type Err = CanError;

    fn from_str(name: &str) -> Result<Interface, CanError> {
        let wrong = || CanError::Name { name: name.to_owned() };
        if let Some(path) = name.strip_prefix("unix:") {
            return if path.is_empty() { Err(wrong()) } else { Ok(Interface::Unix(path.into())) };
        }
        let sound = (1..=LONGEST_NAME).contains(&name.len())
            && !matches!(name, "." | "..")
            && !name.contains(|c: char| c == '/' || c == ':' || c.is_whitespace() || c.is_control());
        if sound { Ok(Interface::SocketCan(name.to_owned())) } else { Err(wrong()) }
    }
}

impl fmt::Display for Interface {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Interface::SocketCan(name) => f.write_str(name),
            Interface::Unix(path) => write!(f, "unix:{}", path.display()),
        }
    }
}

/// Whether an interface is there, of the right kind, and up.
pub(super) fn check(name: &str) -> Result<(), CanError> {
    let Some(kind) = of(name, "type") else {
        return Err(CanError::NoSuchInterface { name: name.to_owned(), present: present() });
    };
    if kind != TYPE_CAN {
        return Err(CanError::NotCan { name: name.to_owned(), found: kind, present: present() });
    }
    let flags = of(name, "flags").and_then(|text| u32::from_str_radix(text.trim_start_matches("0x"), 16).ok());
    // Flags that can't be read are no reason to refuse: the socket will tell.
    if flags.is_some_and(|flags| flags & UP == 0) {
        return Err(CanError::Down { name: name.to_owned() });
    }
    Ok(())
}

fn of(name: &str, file: &str) -> Option<String> {
    std::fs::read_to_string(format!("/sys/class/net/{name}/{file}")).ok().map(|text| text.trim().to_owned())
}

/// The CAN interfaces of this machine.
fn present() -> String {
    let all = std::fs::read_dir("/sys/class/net").into_iter().flatten().flatten();
    let mut names: Vec<String> = all.filter_map(|entry| entry.file_name().into_string().ok()).collect();
    names.retain(|name| of(name, "type").as_deref() == Some(TYPE_CAN));
    names.sort();
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_interface_is_named_as_the_system_names_it_or_by_the_path_of_a_socket() {
        for name in ["can0", "vcan12", "unix:/run/a b/rec.sock", "unix:rec.sock", "abcdefghijklmno"] {
            assert_eq!(name.parse::<Interface>().expect("sound").to_string(), name);
        }
        assert_eq!("unix:x".parse::<Interface>().expect("sound"), Interface::Unix("x".into()));
        for name in ["", "unix:", "..", "can/0", "can 0", "udp:1", "can0\n", "abcdefghijklmnop"] {
            let error = name.parse::<Interface>().expect_err(name);
            assert!(matches!(&error, CanError::Name { .. }) && error.to_string().contains("`can0`"), "{error}");
        }
    }

    #[test]
    fn what_is_missing_is_told_with_what_there_is() {
        let error = check("nosuch0").expect_err("no such interface").to_string();
        assert!(error.contains("no network interface nosuch0") && error.contains("type vcan"), "{error}");
        let error = check("lo").expect_err("not CAN").to_string();
        assert!(error.contains("lo is no CAN interface (link type 772"), "{error}");
        let down = |name: &str| CanError::Down { name: name.into() }.to_string();
        assert!(down("can0").contains("bitrate") && !down("vcan0").contains("bitrate"));
    }
}
