//! The emulated rig over a pty and a bus: what is said by hand is answered as in process, to the last bit of the wire.

use super::bench::{Bench, settings};
use super::rig::{FREE, in_process, preparation};
use super::vcan::vcan;
use drivers::amplifier::{Fault, Told};
use drivers::can::Interface;
use drivers::nodes::Trouble;
use drivers::wired::Preparation;
use rt_core::{Command, Device, Measurement, Tick};
use tempfile::TempDir;

const PROTOCOLS: [&str; 2] = ["vesc", "tmcl"];

fn socket() -> (TempDir, Interface) {
    let folder = tempfile::tempdir().unwrap();
    let interface = Interface::Unix(folder.path().join("can"));
    (folder, interface)
}

/// Within half a step of the wire.
fn assert_shown(answers: &super::bench::Answers, counter: u64, expected: &Measurement) {
    for (path, value, step) in [
        ("ENCODER.AngleDeg", expected.angle_deg, 1e-4),
        ("PRESSURES.Pressure1Bar", expected.pressure1_bar, 2e-6),
        ("PRESSURES.Pressure2Bar", expected.pressure2_bar, 2e-6),
    ] {
        let got = answers.one(path);
        assert!((got - value).abs() < 0.51 * step, "{path} at {counter}: {got}, in process {value}");
    }
    for message in ["ENCODER", "PRESSURES", "CLAMP", "CYLINDER"] {
        assert_eq!(answers.one(&format!("{message}.Counter")), counter as f64);
    }
    assert_eq!([answers.one("ENCODER.Present"), answers.one("CLAMP.Present")], [1.0, 0.0]);
    assert_eq!([answers.one("ENCODER.Fault"), answers.one("PRESSURES.Fault1")], [0.0, 0.0]);
}

/// A run with a constant voltage; neither wire may time out meanwhile, however slow this machine is.
fn runs_as_in_process(protocol: &str, interface: Interface) {
    let mut settings = settings(protocol, interface);
    settings.node_timeout_ms = 60_000.0;
    settings.amplifier_timeout_ms = 60_000.0;
    let mut bench = Bench::open(&settings);
    bench.say(|client, out| client.hello(out));
    bench.wait(|told| matches!(told, Told::Hello(_)).then_some(()));

    let preparation = Preparation { fill_bar: 2.75, ..preparation(0, FREE) };
    let mut rig = in_process(&preparation);
    let expected = rig.read(Tick::at(0)).unwrap();
    assert_shown(&bench.prepare(2.75), 40_000, &expected);
    bench.say(|client, out| client.command(6.0, out));
    // One answer of TMCL tells one quantity. Its duty has steps of 1 / 32767.
    let telemetry = bench.telemetry(|telemetry| telemetry.duty > 0.2 && telemetry.supply_v > 0.0);
    assert!((telemetry.duty - 0.25).abs() < 1e-4 && (telemetry.supply_v - 24.0).abs() < 0.1, "{telemetry:?}");
    // What the wire made of 6 V: the amplifier's steps are finer than the sensors'.
    let command = Command { voltage_v: 6.0, ..FREE };
    rig.write(Tick::at(0), &command).unwrap();
    assert_shown(&bench.ask(0, true), 0, &expected);
    for tick in (1..60).chain([75, 76, 180]) {
        let expected = rig.read(Tick::at(tick)).unwrap();
        rig.write(Tick::at(tick), &command).unwrap();
        let answers = bench.ask(tick, true);
        let shown = answers.one("PRESSURES.Pressure1Bar");
        assert!((shown - expected.pressure1_bar).abs() < 1e-4, "tick {tick}: {shown}, {expected:?}");
        assert_eq!(answers.one("ENCODER.Counter"), tick as f64);
    }
    // The pump has moved oil into chamber 1.
    bench.telemetry(|telemetry| telemetry.speed_rpm > 10.0);
    let statistics = bench.emulator.statistics();
    assert_eq!((statistics.preparations, statistics.node_timeouts, statistics.repeated), (1, 0, 0));
    assert_eq!((statistics.tick, statistics.commands, statistics.passed_over), (180, 1, 15 + 103));
}

#[test]
fn sensors_answer_with_the_echoed_counter_what_the_rig_shows_in_process() {
    for protocol in PROTOCOLS {
        let (_folder, interface) = socket();
        runs_as_in_process(protocol, interface);
    }
}

#[test]
fn the_same_over_a_can_interface() {
    let Some(name) = vcan() else { return };
    for protocol in PROTOCOLS {
        runs_as_in_process(protocol, Interface::SocketCan(name.clone()));
    }
}

#[test]
fn without_commands_valves_and_amplifier_go_safe_by_themselves() {
    for protocol in PROTOCOLS {
        let (_folder, interface) = socket();
        let mut bench = Bench::open(&settings(protocol, interface));
        bench.prepare(2.8);
        bench.say(|client, out| client.command(6.0, out));
        bench.ask(0, true);
        bench.ask(1, true);
        // Heartbeats come unasked.
        let timed_out = bench.until(|heard| heard.all("VALVES_STATUS.TimedOut").last() == Some(&1.0));
        let last = |path: &str| timed_out.all(path).last().copied();
        assert_eq!((last("VALVES_STATUS.BrakeIsOpen"), last("VALVES_STATUS.BypassIsOpen")), (Some(0.0), Some(1.0)));
        assert_eq!(last("VALVES_STATUS.Counter"), Some(1.0));
        // Who asks is there, so nobody asks.
        while bench.emulator.statistics().amplifier_timeouts == 0 {
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        bench.telemetry(|telemetry| telemetry.duty == 0.0);
        // They obey again.
        bench.sync(2, true, true);
        let back = bench.until(|heard| heard.all("VALVES_STATUS.TimedOut").last() == Some(&0.0));
        assert_eq!(back.all("VALVES_STATUS.BrakeIsOpen").last(), Some(&1.0));
        let commands = bench.emulator.statistics().commands;
        bench.say(|client, out| client.command(-6.0, out));
        while bench.emulator.statistics().commands == commands {
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        let said: Vec<String> = bench.journal.read().iter().map(|entry| entry.text.to_string()).collect();
        assert!(said.iter().any(|line| line.contains("safe state")), "{said:?}");
    }
}

#[test]
fn pages_of_a_nodes_health_take_turns() {
    let (_folder, interface) = socket();
    let bench = Bench::open(&settings("vesc", interface));
    bench.sync(0, false, true);
    let heard = bench.until(|heard| heard.all("NODE_HEALTH.Page").len() >= 6);
    let pages = heard.all("NODE_HEALTH.Page");
    assert!(pages.windows(2).all(|pair| pair[1] == (pair[0] + 1.0) % 3.0), "{pages:?}");
    assert!(heard.all("NODE_HEALTH.SupplyV").iter().all(|&supply_v| supply_v == 24.0));
    assert_eq!(heard.all("NODE_HEALTH.SupplyV").len(), 2);
}

#[test]
fn troubles_show_on_the_wires() {
    let (_folder, interface) = socket();
    let mut settings = settings("vesc", interface);
    settings.amplifier_timeout_ms = 60_000.0;
    settings.node_timeout_ms = 60_000.0;
    let mut bench = Bench::open(&settings);
    bench.prepare(2.8);

    let fault = Fault { code: 1, name: "FAULT_CODE_OVER_VOLTAGE" };
    bench.say(|client, out| client.command(6.0, out));
    bench.telemetry(|telemetry| telemetry.duty > 0.2);
    bench.emulator.inject(Trouble::AmplifierFault(Some(fault)));
    let telemetry = bench.telemetry(|telemetry| telemetry.fault.is_some());
    assert_eq!((telemetry.fault.unwrap().code, telemetry.duty), (1, 0.0));
    bench.emulator.inject(Trouble::AmplifierFault(None));
    bench.telemetry(|telemetry| telemetry.fault.is_none() && telemetry.duty > 0.2);

    // What was asked while the nodes were silent is never answered.
    bench.emulator.inject(Trouble::NodesSilent(true));
    let syncs = bench.emulator.statistics().syncs;
    bench.sync(40_007, false, true);
    while bench.emulator.statistics().syncs == syncs {
        std::thread::sleep(std::time::Duration::from_millis(1));
    }
    bench.emulator.inject(Trouble::NodesSilent(false));
    let heard = bench.ask(40_008, false);
    assert_eq!(heard.all("ENCODER.Counter"), [40_008.0]);

    bench.emulator.inject(Trouble::EncoderTwice(true));
    bench.sync(40_009, false, true);
    let twice =
        bench.until(|heard| heard.all("ENCODER.Counter").iter().filter(|&&counter| counter == 40_009.0).count() == 2);
    let angles = twice.all("ENCODER.AngleDeg");
    assert!((angles[angles.len() - 1] - angles[angles.len() - 2] - 90.0).abs() < 1e-3, "{angles:?}");
}

#[test]
fn at_another_baud_rate_nothing_is_understood() {
    for protocol in PROTOCOLS {
        let (_folder, interface) = socket();
        let mut bench = Bench::open(&settings(protocol, interface));
        bench.set_baud(115_200);
        bench.say(|client, out| client.hello(out));
        // The first that is answered is the first that is said at the amplifier's rate.
        let mut said = vec![];
        while said.is_empty() {
            said = bench.journal.read();
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        assert!(said[0].text.contains("115200") && said[0].text.contains("460800"), "{said:?}");
        bench.set_baud(460_800);
        bench.say(|client, out| client.hello(out));
        bench.wait(|told| matches!(told, Told::Hello(_)).then_some(()));
        assert_eq!(bench.heard(), []);
    }
}

#[test]
fn what_is_not_in_the_database_is_named() {
    let (_folder, interface) = socket();
    let mut wrong = settings("vesc", interface);
    wrong.can.command.brake_open = "VALVES.BrakeOpne".to_owned();
    let error = super::bench::start(&wrong).unwrap_err().to_string();
    assert!(error.contains("[can.command] brake_open") && error.contains("BrakeOpen"), "{error}");
    wrong.can.command.brake_open = "VALVES.BrakeOpen".to_owned();
    wrong.can.sensors.angle_deg.as_mut().unwrap().counter = Some("CLAMP.Counter".to_owned());
    let error = super::bench::start(&wrong).unwrap_err().to_string();
    assert!(error.contains("[can.sensors.angle_deg] counter") && error.contains("ENCODER"), "{error}");
    wrong.can.sensors.angle_deg.as_mut().unwrap().counter = None;
    wrong.node_timeout_ms = f64::NAN;
    assert!(super::bench::start(&wrong).unwrap_err().to_string().contains("node_timeout_ms"));
}
