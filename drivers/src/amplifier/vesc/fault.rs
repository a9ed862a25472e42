//! Names of faults.

use crate::amplifier::Fault;

/// `mc_fault_code` of firmware 6.06, in order: the index is the code; 0 is no fault.
pub const FAULTS: &[&str] = &[
    "no fault",
    "over voltage",
    "under voltage",
    "gate driver",
    "absolute over current",
    "over temperature of the output stage",
    "over temperature of the motor",
    "gate driver over voltage",
    "gate driver under voltage",
    "MCU under voltage",
    "booting from watchdog reset",
    "encoder SPI",
    "sin/cos encoder below minimum amplitude",
    "sin/cos encoder above maximum amplitude",
    "flash corruption",
    "high offset of current sensor 1",
    "high offset of current sensor 2",
    "high offset of current sensor 3",
    "unbalanced currents",
    "brake input",
    "resolver loss of tracking",
    "resolver degradation of signal",
    "resolver loss of signal",
    "flash corruption of the app configuration",
    "flash corruption of the motor configuration",
    "encoder without magnet",
    "encoder magnet too strong",
    "phase filter",
    "encoder fault",
    "low-voltage output",
    "encoder slip",
    "overspeed",
    "underspeed",
    "absolute overspeed",
];

/// A code as a fault; `None` for 0.
pub fn fault(code: u8) -> Option<Fault> {
    let name = FAULTS.get(usize::from(code)).copied().unwrap_or("fault unknown to this program");
    (code != 0).then_some(Fault { code: code.into(), name })
}
