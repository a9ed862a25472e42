//! The serial link against emulated amplifiers at a pty, in every protocol: order, age, watchdog, silence, unplugging, dead ports.

#![allow(clippy::unwrap_used, reason = "a test")]

mod serial_pty;

use drivers::amplifier::{PROTOCOLS, Telemetry};
use drivers::journal::{JournalReader, Occurrence, Severity};
use drivers::serial::SerialLink;
use serial_pty::{Amplifier, Mood, settings, until};
use std::cell::RefCell;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

/// A link to an amplifier, and what it notes.
struct Bench {
    link: SerialLink,
    journal: JournalReader,
    notes: Vec<Occurrence>,
}

impl Bench {
    fn open(name: &str, amplifier: &Amplifier) -> Bench {
        Bench::with(name, amplifier, 100.0)
    }

    fn with(name: &str, amplifier: &Amplifier, timeout_ms: f64) -> Bench {
        let mut journal = JournalReader::default();
        let mut settings = settings(name, &amplifier.port);
        settings.timeout_ms = timeout_ms;
        let link = SerialLink::open(&settings, || {}, journal.journal("serial")).unwrap();
        Bench { link, journal, notes: vec![] }
    }

    fn armed(name: &str, amplifier: &Amplifier) -> Bench {
        let mut bench = Bench::open(name, amplifier);
        bench.arm();
        bench
    }

    /// A machine that stalls may lose the connection in between; then the operator arms again.
    fn arm(&mut self) {
        until("the link armed", || {
            self.link.arm();
            self.link.poll().armed
        });
    }

    /// Commands as a loop does, until it is so.
    fn command_until(&mut self, voltage_v: f64, what: &str, mut so: impl FnMut(&mut SerialLink) -> bool) {
        until(what, || {
            self.link.command(voltage_v);
            so(&mut self.link)
        });
    }

    fn noted(&mut self, severity: Severity, words: &str) -> usize {
        self.notes.extend(self.journal.read());
        self.notes.iter().filter(|note| note.severity == severity && note.text.contains(words)).count()
    }
}

fn is(a: f64, b: f64) -> bool {
    (a - b).abs() < 2e-3
}

fn non_zero(commands: &[f64]) -> Vec<f64> {
    commands.iter().copied().filter(|&voltage_v| voltage_v != 0.0).collect()
}

#[test]
fn commands_arrive_in_order_and_the_newest_arrives() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::armed(kind.name, &amplifier);
        let mut last_v = 0.0;
        for k in 1..=300 {
            // At times several at once: those before the newest may be passed over.
            for part in 0..[1, 1, 5][k % 3] {
                last_v = -0.04 * k as f64 - 0.005 * part as f64;
                bench.link.command(last_v);
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        bench.command_until(last_v, "the newest command", |_| amplifier.last().is_some_and(|v| is(v, last_v)));
        let commands = non_zero(&amplifier.commands());
        assert!(commands.len() > 50, "{}: {} commands arrived", kind.name, commands.len());
        assert!(commands.is_sorted_by(|a, b| a >= b), "{}: {commands:?}", kind.name);
    }
}

#[test]
fn nothing_but_0_v_before_the_operator_arms_and_after_he_disarms() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::open(kind.name, &amplifier);
        assert!(bench.link.poll().connected && !bench.link.poll().armed);
        bench.command_until(5.0, "some commands", |_| amplifier.commands().len() > 20);
        assert_eq!(non_zero(&amplifier.commands()), [], "{}", kind.name);
        bench.arm();
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
        bench.link.disarm();
        bench.command_until(5.0, "0 V", |link| amplifier.last() == Some(0.0) && !link.poll().armed);
        let before = amplifier.commands().len();
        bench.command_until(5.0, "some commands", |_| amplifier.commands().len() > before + 20);
        assert_eq!(non_zero(&amplifier.commands()[before..]), [], "{}", kind.name);
    }
}

#[test]
fn telemetry_is_what_the_amplifier_measures_and_ages_when_it_falls_silent() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::with(kind.name, &amplifier, 60_000.0);
        amplifier.state().telemetry = Telemetry { supply_v: 23.5, motor_current_a: -1.5, ..Telemetry::UNTOLD };
        bench.command_until(0.0, "the supply's voltage and the current", |link| {
            let told = link.poll().telemetry;
            (told.supply_v - 23.5).abs() < 0.2 && (told.motor_current_a + 1.5).abs() < 0.05
        });
        amplifier.state().mood = Mood::Mute;
        let after_ns = rt_core::system::time::monotonic_ns();
        // Requests that are not answered don't pile up: far fewer bytes than a request with each command.
        let before = amplifier.received();
        bench.command_until(0.0, "the telemetry to age by 300 ms", |link| {
            let report = link.poll();
            // What was on its way may still have come.
            assert!(report.telemetry_ns < after_ns + 100_000_000, "{}", kind.name);
            assert!(report.connected);
            rt_core::system::time::monotonic_ns() > after_ns + 300_000_000
        });
        let traffic = (kind.client)(&settings(kind.name, &amplifier.port)).unwrap().traffic();
        let now = amplifier.received();
        let (bytes, commands) = (now.0 - before.0, now.1 - before.1);
        let others = bytes.saturating_sub(commands * traffic.command.out);
        assert!(commands > 20 && others <= 20 * traffic.request.out, "{}: {commands} commands, {others} B", kind.name);
    }
}

#[test]
fn an_amplifier_that_falls_silent_is_disarmed_until_the_operator_arms_again() {
    // An adapter that sends back what it is told speaks in sound frames, and is no amplifier.
    for (kind, silent) in PROTOCOLS.iter().flat_map(|kind| [(kind, Mood::Mute), (kind, Mood::Echoes)]) {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::armed(kind.name, &amplifier);
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
        let connection = bench.link.poll().connection;
        amplifier.state().mood = silent;
        bench.command_until(5.0, "the connection lost", |link| !link.poll().connected);
        assert!(!bench.link.poll().armed);
        until("the note", || bench.noted(Severity::Error, "no answer for") == 1);
        // It hears us, though it does not answer.
        bench.command_until(5.0, "0 V", |_| amplifier.last() == Some(0.0));
        let before = amplifier.commands().len();
        // This word is for a connection that there is not.
        bench.link.arm();
        bench.command_until(5.0, "0 V again", |_| amplifier.commands().len() > before + 3);
        amplifier.state().mood = Mood::Answers;
        bench.command_until(5.0, "the connection", |link| link.poll().connected);
        assert!(bench.link.poll().connection > connection);
        until("the note", || bench.noted(Severity::Info, "answers again") == 1);
        let some = amplifier.commands().len() + 20;
        bench.command_until(5.0, "some commands", |_| amplifier.commands().len() > some);
        assert_eq!(non_zero(&amplifier.commands()[before..]), [], "{}", kind.name);
        bench.arm();
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
    }
}

#[test]
fn unplugged_and_plugged_in_again_it_gets_0_v_until_the_operator_arms() {
    for kind in PROTOCOLS {
        let folder = tempfile::tempdir().unwrap();
        let name = folder.path().join("amplifier");
        let amplifier = Amplifier::start(kind.name, Some(&name), Mood::Answers);
        let mut bench = Bench::armed(kind.name, &amplifier);
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
        drop(amplifier);
        bench.command_until(5.0, "the connection lost", |link| !link.poll().connected);
        assert!(!bench.link.poll().armed);
        until("the note", || bench.noted(Severity::Error, "the port is gone") == 1);
        bench.link.arm();
        let amplifier = Amplifier::start(kind.name, Some(&name), Mood::Answers);
        bench.command_until(5.0, "the connection", |link| link.poll().connected);
        bench.command_until(5.0, "some commands", |_| amplifier.commands().len() > 20);
        assert_eq!(non_zero(&amplifier.commands()), [], "{}", kind.name);
        assert!(!bench.link.poll().armed);
        bench.arm();
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
    }
}

#[test]
fn a_loop_that_stalls_gets_0_v_and_goes_on_where_it_is() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::armed(kind.name, &amplifier);
        bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
        until("0 V", || amplifier.last() == Some(0.0));
        until("the note", || bench.noted(Severity::Warning, "no command for") >= 1);
        let before = amplifier.commands().len();
        until("0 V again and again", || amplifier.commands().len() > before + 5);
        assert_eq!(non_zero(&amplifier.commands()[before..]), [], "{}", kind.name);
        // Signs of life go both ways meanwhile.
        assert!(bench.link.poll().connected && bench.link.poll().armed, "{}", kind.name);
        bench.command_until(-3.0, "-3 V", |_| amplifier.last().is_some_and(|v| is(v, -3.0)));
    }
}

#[test]
fn a_fault_is_told_and_noted_once() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::open(kind.name, &amplifier);
        let fault = Some(kind.example_fault);
        amplifier.state().telemetry.fault = fault;
        bench.command_until(0.0, "the fault", |link| link.poll().fault == fault);
        let before = amplifier.commands().len();
        bench.command_until(0.0, "some ticks", |_| amplifier.commands().len() > before + 50);
        assert_eq!(bench.noted(Severity::Error, kind.example_fault.name), 1, "{}", kind.name);
        amplifier.state().telemetry.fault = None;
        bench.command_until(0.0, "the fault gone", |link| link.poll().fault.is_none());
        until("the note", || bench.noted(Severity::Info, "fault is over") == 1);
    }
}

#[test]
fn noise_is_counted_and_the_link_stays() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Noisy);
        let mut bench = Bench::armed(kind.name, &amplifier);
        let sound = bench.link.poll().garbled.sound;
        bench.command_until(1.0, "frames and noise", |link| {
            let garbled = link.poll().garbled;
            garbled.sound > sound + 10 && garbled.skipped_bytes + garbled.refused > 10
        });
        assert!(bench.link.poll().connected);
    }
}

/// Times that this thread has slept or waited.
fn waits() -> i64 {
    // SAFETY: all zero bits are a valid rusage; the pointer is valid for the write of one.
    unsafe {
        let mut usage: libc::rusage = std::mem::zeroed();
        assert_eq!(libc::getrusage(libc::RUSAGE_THREAD, &raw mut usage), 0);
        usage.ru_nvcsw
    }
}

#[test]
fn a_dead_port_holds_no_tick_up_and_no_old_command_follows_a_new_one() {
    for kind in PROTOCOLS {
        let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
        let mut bench = Bench::with(kind.name, &amplifier, 60_000.0);
        bench.arm();
        bench.command_until(0.001, "the first", |_| amplifier.last().is_some_and(|v| v > 0.0));
        amplifier.state().mood = Mood::Stuck;
        // More than the kernel's buffers hold, by far.
        let (mut k, mut waited) = (1, 0);
        let voltage_v = |k: i32| 0.001 * f64::from(k);
        while k < 8000 {
            k += 1;
            let before = waits();
            bench.link.command(voltage_v(k));
            bench.link.poll();
            waited += waits() - before;
            std::thread::sleep(Duration::from_micros(200));
        }
        assert_eq!(waited, 0, "{}: the loop's side never waits", kind.name);
        let (given_v, before) = (voltage_v(k), amplifier.commands().len());
        amplifier.state().mood = Mood::Answers;
        let newest_v = given_v + 0.5;
        bench.command_until(newest_v, "the newest", |_| amplifier.last().is_some_and(|v| is(v, newest_v)));
        let some = amplifier.commands().len() + 50;
        bench.command_until(newest_v, "some more", |_| amplifier.commands().len() > some);
        let after = non_zero(&amplifier.commands()[before..]);
        assert!(after.is_sorted(), "{}: {after:?}", kind.name);
        // Most of what was given meanwhile had expired and was thrown away; the rest lay in the kernel's buffers.
        let old = after.iter().filter(|&&v| v < newest_v - 0.1).count();
        assert!(old < 4000, "{}: {old} old commands", kind.name);
    }
}

struct Flag(Arc<AtomicBool>);

impl Drop for Flag {
    fn drop(&mut self) {
        self.0.store(true, Ordering::SeqCst);
    }
}

thread_local! {
    /// Dropped when its thread ends.
    static ENDS: RefCell<Option<Flag>> = const { RefCell::new(None) };
}

#[test]
fn dropped_it_says_0_v_last_and_its_thread_has_ended() {
    for kind in PROTOCOLS {
        for mood in [Mood::Answers, Mood::Stuck] {
            let amplifier = Amplifier::start(kind.name, None, Mood::Answers);
            let ended = Arc::new(AtomicBool::new(false));
            let flag = ended.clone();
            let mut settings = settings(kind.name, &amplifier.port);
            settings.timeout_ms = 60_000.0;
            let mut journal = JournalReader::default();
            let prepare = move || {
                assert_eq!(std::thread::current().name(), Some("serial"));
                ENDS.set(Some(Flag(flag)));
            };
            let link = SerialLink::open(&settings, prepare, journal.journal("serial")).unwrap();
            assert!(!ended.load(Ordering::SeqCst));
            let mut bench = Bench { link, journal, notes: vec![] };
            bench.arm();
            bench.command_until(5.0, "5 V", |_| amplifier.last().is_some_and(|v| is(v, 5.0)));
            amplifier.state().mood = mood;
            if mood == Mood::Stuck {
                for _ in 0..2000 {
                    bench.link.command(5.0);
                    std::thread::sleep(Duration::from_micros(700));
                }
            }
            bench.link.command(5.0);
            drop(bench);
            assert!(ended.load(Ordering::SeqCst), "{}, {mood:?}", kind.name);
            let sent = amplifier.state().bytes;
            amplifier.state().mood = Mood::Answers;
            if mood == Mood::Answers {
                until("0 V at the end", || amplifier.last() == Some(0.0));
            } else {
                until("what was stuck", || amplifier.state().bytes > sent);
            }
            // Nothing follows.
            std::thread::sleep(Duration::from_millis(50));
            assert!(mood == Mood::Stuck || amplifier.last() == Some(0.0), "{}", kind.name);
        }
    }
}

#[test]
fn the_hardware_that_answered_is_known() {
    let amplifier = Amplifier::start("vesc", None, Mood::Answers);
    let bench = Bench::open("vesc", &amplifier);
    assert_eq!(bench.link.firmware().to_string(), "REC_BENCH firmware 6.06");
}
