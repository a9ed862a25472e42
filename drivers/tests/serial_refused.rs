//! What the serial link says where there is no amplifier, or another one: expected, got, remedy.

#![allow(clippy::unwrap_used, reason = "a test")]

mod serial_pty;

use drivers::amplifier::{AmplifierSettings, PROTOCOLS};
use drivers::journal::JournalReader;
use drivers::serial::{LinkError, Pty, SerialLink};
use serial_pty::{Amplifier, Mood, settings};
use std::fs::{self, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::path::Path;

fn refusal(settings: &AmplifierSettings) -> LinkError {
    let mut journal = JournalReader::default();
    let opened = SerialLink::open(settings, || {}, journal.journal("serial"));
    let error = opened.err().expect("refused");
    // One line, and it names the port.
    let text = error.to_string();
    assert!(!text.contains('\n') && text.contains(&*settings.port.to_string_lossy()), "{text}");
    error
}

/// Every word is in the message.
fn says(error: &LinkError, words: &[&str]) {
    let text = error.to_string();
    for word in words {
        assert!(text.contains(word), "expected {word:?} in: {text}");
    }
}

#[test]
fn an_amplifier_of_another_protocol_is_recognised() {
    for expected in PROTOCOLS {
        for spoken in PROTOCOLS.iter().filter(|spoken| spoken.name != expected.name) {
            let amplifier = Amplifier::start(spoken.name, None, Mood::Answers);
            let error = refusal(&settings(expected.name, &amplifier.port));
            says(&error, &[expected.title, spoken.title, &format!("protocol = {:?}", spoken.name)]);
            assert!(error.is_configuration());
            assert_eq!(amplifier.commands(), [], "nothing but questions was sent");
        }
    }
}

#[test]
fn a_silent_amplifier() {
    for kind in PROTOCOLS {
        for mood in [Mood::Mute, Mood::Stuck] {
            let amplifier = Amplifier::start(kind.name, None, mood);
            let error = refusal(&settings(kind.name, &amplifier.port));
            says(&error, &[kind.title, "460800 baud", "got nothing in 2000 ms", "powered"]);
            assert!(!error.is_configuration());
            assert_eq!(amplifier.commands(), [], "nothing but questions was sent");
        }
    }
}

#[test]
fn noise_and_echo() {
    for kind in PROTOCOLS {
        let babbling = Amplifier::start(kind.name, None, Mood::Babbles);
        let error = refusal(&settings(kind.name, &babbling.port));
        says(&error, &[kind.title, "460800 baud", "00 5a 02 ff 13 37 81", "wrong baud rate", "another protocol"]);
        let echoing = Amplifier::start(kind.name, None, Mood::Echoes);
        let error = refusal(&settings(kind.name, &echoing.port));
        says(&error, &["TX and RX are connected to each other"]);
    }
}

#[test]
fn no_such_port() {
    let error = refusal(&settings("vesc", Path::new("/dev/serial/by-id/usb-no-such-adapter")));
    says(&error, &["there is no such file", "there are ", "correct [amplifier] port"]);
    assert!(matches!(error, LinkError::NoSuchPort { .. }));
}

#[test]
fn a_file_that_is_no_port() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("port");
    fs::write(&file, "not a port").unwrap();
    for (path, kind) in [(&*file, "a file"), (folder.path(), "a folder"), (Path::new("/dev/null"), "another kind")] {
        let error = refusal(&settings("vesc", path));
        says(&error, &["expected a serial port (a tty)", kind]);
        assert!(error.is_configuration());
    }
    assert_eq!(fs::read_to_string(&file).unwrap(), "not a port");
}

#[test]
fn a_port_that_somebody_else_has_open_and_has_left() {
    let amplifier = Amplifier::start("vesc", None, Mood::Answers);
    let settings = settings("vesc", &amplifier.port);
    let mut journal = JournalReader::default();
    let first = SerialLink::open(&settings, || {}, journal.journal("serial")).unwrap();
    says(&refusal(&settings), &["another program has it open", "fuser"]);
    drop(first);
    SerialLink::open(&settings, || {}, journal.journal("serial")).unwrap();
}

#[test]
fn a_port_of_another_user() {
    let pty = Pty::open(None).unwrap();
    fs::set_permissions(pty.slave(), Permissions::from_mode(0o000)).unwrap();
    let settings = settings("vesc", pty.slave());
    let checked = std::thread::spawn(move || {
        const NOBODY: libc::c_long = 65_534;
        // Root may open anything, so this thread stops being root. The link's thread inherits that; the others stay what they are:
        // the system call by number concerns the calling thread only.
        // SAFETY: no memory is touched.
        let changed = unsafe { libc::syscall(libc::SYS_setresuid, NOBODY, NOBODY, NOBODY) };
        assert!(changed == 0 || !rustix::process::getuid().is_root(), "root can't become nobody");
        says(&refusal(&settings), &["permission denied", "usermod -aG dialout"]);
    });
    checked.join().unwrap();
}

#[test]
fn settings_that_make_no_sense() {
    let amplifier = Amplifier::start("vesc", None, Mood::Answers);
    let good = settings("vesc", &amplifier.port);
    says(&refusal(&AmplifierSettings { baud: 0, ..good.clone() }), &["a port at 0 baud", "set [amplifier] baud"]);
    let refused = |settings: AmplifierSettings, words: &[&str]| {
        let mut journal = JournalReader::default();
        let error = SerialLink::open(&settings, || {}, journal.journal("serial")).err().expect("refused");
        says(&error, words);
        assert!(error.is_configuration());
    };
    refused(AmplifierSettings { protocol: "rs232".into(), ..good.clone() }, &["rs232", "vesc", "tmcl"]);
    for timeout_ms in [0.0, f64::NAN, f64::INFINITY, -1.0] {
        refused(AmplifierSettings { timeout_ms, ..good.clone() }, &["timeout_ms", "10 to 60,000 ms"]);
    }
    refused(AmplifierSettings { telemetry_every_ticks: 0, ..good.clone() }, &["telemetry_every_ticks", "1 or more"]);
    assert_eq!(amplifier.received(), (0, 0), "nothing was sent");
}
