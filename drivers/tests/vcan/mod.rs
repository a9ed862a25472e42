//! Where a test gets a CAN bus from: this machine's, where there is one.

use std::io::Write;

/// The interface that tests use.
const INTERFACE: &str = "vcan0";
/// `ARPHRD_CAN` (linux/if_arp.h).
const TYPE_CAN: &str = "280";
/// `IFF_UP` (linux/if.h).
const UP: u32 = 1;

/// The name of a virtual CAN interface that is up. Where there is none this says so on stderr, past the capture of the test's
/// output, and names the command that runs the tests in the emulated machine; with `REC_BENCH_CAN=required` it fails instead.
pub fn vcan() -> Option<String> {
    let of = |file| std::fs::read_to_string(format!("/sys/class/net/{INTERFACE}/{file}")).unwrap_or_default();
    let flags = u32::from_str_radix(of("flags").trim().trim_start_matches("0x"), 16).unwrap_or(0);
    if of("type").trim() == TYPE_CAN && flags & UP != 0 {
        return Some(INTERFACE.to_owned());
    }
    let test = std::thread::current().name().unwrap_or("a test").to_owned();
    let missing = format!(
        "{test}: SKIPPED over CAN: no {INTERFACE} that is up. In the emulated machine: `drivers/tests/can-tests`; here: \
         `modprobe vcan; ip link add dev {INTERFACE} type vcan; ip link set {INTERFACE} up`"
    );
    assert_ne!(std::env::var("REC_BENCH_CAN").as_deref(), Ok("required"), "{missing}");
    // Not `eprintln!`: the harness would keep it to itself.
    let _ = writeln!(std::io::stderr(), "{missing}");
    None
}
