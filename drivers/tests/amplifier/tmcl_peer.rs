//! PyTrinamic, which nobody here wrote, drives our emulated TMCL module over a pty.

use super::{peers, settings, state};
use drivers::amplifier::{Drive, DriveState, Outbox, protocol};
use rustix::event::{PollFd, PollFlags, Timespec, poll};
use rustix::fs::{Mode, OFlags};
use rustix::pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt};
use rustix::termios::{OptionalActions, tcgetattr, tcsetattr};
use std::os::fd::OwnedFd;
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};

/// Master end, slave end (held open: a pty without a slave hangs up), path of the slave.
fn raw_pty() -> (OwnedFd, OwnedFd, String) {
    let master = openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).unwrap();
    grantpt(&master).unwrap();
    unlockpt(&master).unwrap();
    let path = ptsname(&master, vec![]).unwrap().into_string().unwrap();
    let slave = rustix::fs::open(&*path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty()).unwrap();
    let mut attributes = tcgetattr(&slave).unwrap();
    attributes.make_raw();
    tcsetattr(&slave, OptionalActions::Now, &attributes).unwrap();
    (master, slave, path)
}

/// Answers until told to stop; every voltage that was commanded.
fn serve(drive: &mut dyn Drive, state: &DriveState, master: &OwnedFd, stop: &AtomicBool) -> Vec<f64> {
    let (mut commanded, mut out, mut bytes) = (vec![], Outbox::new(), [0; 256]);
    let patience = Timespec { tv_sec: 0, tv_nsec: 20_000_000 };
    while !stop.load(Ordering::Acquire) {
        if poll(&mut [PollFd::new(master, PollFlags::IN)], Some(&patience)).unwrap() == 0 {
            continue;
        }
        let length = rustix::io::read(master, &mut bytes).unwrap();
        commanded.extend(drive.hear(&bytes[..length], 0, state, &mut out));
        while !out.is_empty() {
            let written = rustix::io::write(master, out.bytes()).unwrap();
            out.written(written);
        }
    }
    commanded
}

#[test]
fn pytrinamic_drives_the_emulated_module() {
    let Some(python) = peers::python(&["pytrinamic==0.2.26"]) else { return };
    let kind = protocol("tmcl").unwrap();
    let mut drive = (kind.drive)(&settings(kind)).unwrap();
    let mut state = state();
    state.telemetry.fault = Some(kind.example_fault);
    let (master, _slave, path) = raw_pty();
    let stop = AtomicBool::new(false);
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/amplifier/tmcl_peer.py");
    let (output, commanded) = std::thread::scope(|scope| {
        let served = scope.spawn(|| serve(&mut *drive, &state, &master, &stop));
        let output = Command::new(&python).arg(script).arg(&path).output();
        stop.store(true, Ordering::Release);
        (output.unwrap(), served.join().unwrap())
    });
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let said: toml::Table = String::from_utf8_lossy(&output.stdout).parse().unwrap();

    let number = |key: &str| said[key].as_integer().unwrap();
    assert_eq!(number("version"), 0x000c_0309);
    assert_eq!(said["version_text"].as_str(), Some("0012V309"));
    let trips = said["round_trips"].as_array().unwrap();
    assert_eq!(trips.len(), 207);
    for (trip, voltage_v) in trips.iter().zip(&commanded) {
        assert_eq!(trip[0], trip[1]);
        let meant_v = trip[0].as_integer().unwrap() as f64 / 32_767.0 * 12.0;
        assert!((meant_v - voltage_v).abs() < 1e-9, "{meant_v} V came as {voltage_v} V");
    }
    // -4.56 A, 2345 1/min, duty 0.25, 12.3 V.
    let telemetry = ["current", "velocity", "pwm", "supply", "errors"].map(number);
    assert_eq!(telemetry, [-4560, 2345, 8192, 123, i64::from(kind.example_fault.code)]);
    let refused = |what: &str| said["refused"].get(what).and_then(toml::Value::as_integer);
    assert_eq!(refused("too much"), Some(4));
    assert_eq!(refused("read only"), Some(3));
    assert_eq!(refused("no such parameter"), Some(3));
    assert_eq!(refused("no such axis"), Some(3));
    assert_eq!(refused("no such instruction"), Some(2));
    assert_eq!((number("before_stop"), number("after_stop")), (-8192, 0));
    let [.., before, stopped, after] = commanded[..] else { panic!() };
    assert!(before < -2.9 && stopped == 0.0 && after > 2.9, "{before} {stopped} {after}");
    assert!(drive.garbled().sound > 420, "{:?}", drive.garbled());
    assert_eq!((drive.garbled().refused, drive.garbled().skipped_bytes), (0, 0));
}
