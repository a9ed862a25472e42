//! What the bench says over CAN, the nodes understand, and the other way round: the maps of both ends against each other.
#![allow(clippy::unwrap_used, reason = "a test")]

use drivers::can::{Frame, FrameId, TimedFrame};
use drivers::dbc::Database;
use drivers::nodes::{Answer, CommandMap, SensorMap};
use drivers::wired::{Around, CanSettings, InputMap, MOST_FRAMES, OutputMap, Preparation};
use proptest::prelude::*;
use rt_core::{Command, Fixture, Input, Measurement, PERIOD_NS, Tick};

const DBC: &str = include_str!("../../bench/rigs/rec.dbc");

/// Calibrated so that each gain and offset shows.
const SETTINGS: &str = r#"
interface = "vcan0"
dbc = "rec.dbc"
sensors.angle_deg = { signal = "ENCODER.AngleDeg", counter = "ENCODER.Counter", fault = "ENCODER.Fault", present = "ENCODER.Present", gain = -1.25, offset = 3.0 }
sensors.pressure1_bar = { signal = "PRESSURES.Pressure1Bar", counter = "PRESSURES.Counter", fault = "PRESSURES.Fault1", gain = 2.0, offset = 0.5 }
sensors.pressure2_bar = { signal = "PRESSURES.Pressure2Bar", counter = "PRESSURES.Counter", fault = "PRESSURES.Fault2" }
sensors.torque_nm = { signal = "CLAMP.TorqueNm", counter = "CLAMP.Counter", present = "CLAMP.Present" }
sensors.volume_ml = { signal = "CYLINDER.VolumeMl", counter = "CYLINDER.Counter", present = "CYLINDER.Present" }
[command]
brake_open = "VALVES.BrakeOpen"
bypass_open = "VALVES.BypassOpen"
counter = "VALVES.Counter"
running = "VALVES.Running"
[fixture]
kind = "FIXTURE_POSE.Kind"
angle_deg = "FIXTURE_POSE.AngleDeg"
pressure1_bar = "FIXTURE_FILL.Pressure1Bar"
pressure2_bar = "FIXTURE_FILL.Pressure2Bar"
flow_ml_s = "FIXTURE_FLOW.FlowMlS"
segment = "FIXTURE_RUN.Segment"
run = "FIXTURE_RUN.Run"
vertical = "FIXTURE_RUN.Vertical"
fill_bar = "FIXTURE_RUN.FillBar"
"#;

fn settings() -> (CanSettings, Database) {
    (toml::from_str(SETTINGS).unwrap(), Database::parse(DBC, "rec.dbc").unwrap())
}

fn no_frames() -> [Frame; MOST_FRAMES] {
    [Frame::new(FrameId::Standard(0), &[]).unwrap(); MOST_FRAMES]
}

/// Numbers that a float32 holds exactly.
fn exact(range: std::ops::Range<i32>) -> impl Strategy<Value = f64> {
    range.prop_map(|n| f64::from(n) / 64.0)
}

fn fixture() -> impl Strategy<Value = Fixture> {
    let angle = || exact(-2560..2560);
    let bar = || exact(1..640);
    prop_oneof![
        Just(Fixture::Free),
        angle().prop_map(|angle_deg| Fixture::Clamped { angle_deg }),
        angle().prop_map(|angle_deg| Fixture::Driven { angle_deg }),
        (angle(), bar(), bar()).prop_map(|(angle_deg, pressure1_bar, pressure2_bar)| Fixture::Filled {
            angle_deg,
            pressure1_bar,
            pressure2_bar
        }),
        (angle(), exact(0..640)).prop_map(|(angle_deg, flow_ml_s)| Fixture::Released { angle_deg, flow_ml_s }),
        (bar(), bar()).prop_map(|(pressure1_bar, pressure2_bar)| Fixture::PumpBench { pressure1_bar, pressure2_bar }),
    ]
}

prop_compose! {
    fn command()(fixture in fixture(), brake_open: bool, bypass_open: bool, segment in 0u32..65536) -> Command {
        Command { voltage_v: 0.0, brake_open, bypass_open, fixture, segment }
    }
}

proptest! {
    /// Whatever is commanded one tick after the other, the nodes know all of it at each SYNC, though the fixture goes over the bus
    /// only when it changes.
    #[test]
    fn at_each_sync_the_nodes_know_the_whole_command(
        commands in proptest::collection::vec((command(), 1usize..150), 1..8),
        run: u8, vertical: bool, fill_bar in exact(1..640), first in 0u64..70_000,
    ) {
        let (settings, database) = settings();
        let mut bench = OutputMap::new(&settings, &database).unwrap();
        let mut nodes = CommandMap::new(&settings, &database).unwrap();
        let start = commands[0].0;
        let preparation = Preparation { run, vertical, fill_bar, start };
        let mut counter = first;
        for (command, ticks) in commands {
            for _ in 0..ticks {
                let around = Around { counter, running: counter % 2 == 0, preparation };
                let mut frames = no_frames();
                let count = bench.frames(&command, &around, &mut frames).unwrap();
                let syncs: Vec<_> = frames[..count].iter().filter_map(|frame| nodes.take(frame)).collect();
                prop_assert_eq!(syncs.len(), 1, "one SYNC a tick");
                prop_assert!(nodes.take(&frames[count - 1]).is_some(), "and it is the last frame");
                let said = syncs[0];
                prop_assert_eq!(said.preparation, Preparation { start: command, ..preparation });
                prop_assert_eq!((said.running, said.counter.unwrap().value), (around.running, counter % 65536));
                counter += 1;
            }
        }
    }

    /// A measurement that the nodes send is the measurement that the bench reads, calibrated, with its age.
    #[test]
    fn what_the_nodes_measure_the_bench_reads(
        values in proptest::collection::vec((-900i32..900, 40_000i32..500_000, 40_000i32..500_000), 1..40),
        faulty in 0u32..4, clamped: bool, first in 0u64..200_000,
    ) {
        let (settings, database) = settings();
        let mut bench = InputMap::new(&settings, &database).unwrap();
        let mut nodes = SensorMap::new(&settings, &database).unwrap();
        let faulty = faulty << 1;
        for (tick, (angle, p1, p2)) in (first..).zip(values) {
            let measurement = Measurement {
                angle_deg: f64::from(angle) / 10.0,
                pressure1_bar: f64::from(p1) * 1e-5 + 0.5,
                pressure2_bar: f64::from(p2) * 1e-5,
                torque_nm: if clamped { f64::from(angle) / 64.0 } else { f64::NAN },
                volume_ml: f64::NAN,
                faulty,
                ..Measurement::NONE
            };
            let answer = Answer {
                measurement, counter: tick % 65536, brake_is_open: true, bypass_is_open: false, timed_out: false,
            };
            nodes.answers(&answer, 0, |frame| bench.take(&TimedFrame { frame, received_ns: 5 }, Some(tick)));
            let read = bench.measurement(Tick::at(tick + 1), 1_000_000);
            prop_assert!((read.angle_deg - measurement.angle_deg).abs() <= 1.25 * 0.5e-4 + 1e-9);
            prop_assert!((read.pressure1_bar - measurement.pressure1_bar).abs() <= 2.0 * 1e-6 + 1e-9);
            prop_assert!((read.pressure2_bar - measurement.pressure2_bar).abs() <= 1e-6 + 1e-9);
            prop_assert_eq!(read.torque_nm.is_nan(), !clamped);
            prop_assert!(!clamped || read.torque_nm == measurement.torque_nm);
            prop_assert!(read.volume_ml.is_nan());
            prop_assert_eq!(read.faulty, faulty);
            prop_assert_eq!(read.age_ns, [PERIOD_NS as u32; 5]);
        }
        prop_assert_eq!(bench.silent().count(), 0);
    }
}

/// What a signal of one of these frames says, by its name in the database and not by any map.
fn said(database: &Database, frames: &[Frame], name: &str) -> f64 {
    let (message, signal) = database.signal(name).unwrap();
    let frame = frames.iter().find(|frame| frame.id == message.id).unwrap();
    signal.codec.decode(frame.data()).unwrap()
}

/// Both ends read the rig file in one place: what each key means is held against the database here.
#[test]
fn each_key_of_a_command_is_the_signal_that_it_names() {
    let (settings, database) = settings();
    let fixtures = [
        Fixture::Filled { angle_deg: -7.5, pressure1_bar: 2.25, pressure2_bar: 3.5 },
        Fixture::Released { angle_deg: 4.25, flow_ml_s: 1.75 },
    ];
    for (kind, fixture) in [3.0, 4.0].into_iter().zip(fixtures) {
        let start = Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture, segment: 11 };
        let preparation = Preparation { run: 13, vertical: true, fill_bar: 1.5, start };
        let mut frames = no_frames();
        let around = Around { counter: 17, running: false, preparation };
        let count = OutputMap::new(&settings, &database).unwrap().frames(&start, &around, &mut frames).unwrap();
        let of_kind = if kind == 3.0 { [-7.5, 2.25, 3.5, 0.0] } else { [4.25, 0.0, 0.0, 1.75] };
        let [angle_deg, pressure1_bar, pressure2_bar, flow_ml_s] = of_kind;
        for (name, expected) in [
            ("VALVES.BrakeOpen", 1.0),
            ("VALVES.BypassOpen", 0.0),
            ("VALVES.Counter", 17.0),
            ("VALVES.Running", 0.0),
            ("FIXTURE_POSE.Kind", kind),
            ("FIXTURE_POSE.AngleDeg", angle_deg),
            ("FIXTURE_FILL.Pressure1Bar", pressure1_bar),
            ("FIXTURE_FILL.Pressure2Bar", pressure2_bar),
            ("FIXTURE_FLOW.FlowMlS", flow_ml_s),
            ("FIXTURE_RUN.Segment", 11.0),
            ("FIXTURE_RUN.Run", 13.0),
            ("FIXTURE_RUN.Vertical", 1.0),
            ("FIXTURE_RUN.FillBar", 1.5),
        ] {
            assert_eq!(said(&database, &frames[..count], name), expected, "{name}");
        }
    }
}

#[test]
fn each_key_of_a_sensor_is_the_signal_that_it_names() {
    let (settings, database) = settings();
    let measurement = Measurement {
        angle_deg: 3.0 - 1.25 * 8.0,
        pressure1_bar: 2.0 * 1.5 + 0.5,
        pressure2_bar: 2.75,
        torque_nm: 5.5,
        volume_ml: f64::NAN,
        faulty: Input::Pressure2.bit(),
        ..Measurement::NONE
    };
    let answer = Answer { measurement, counter: 19, brake_is_open: true, bypass_is_open: false, timed_out: false };
    let mut frames = vec![];
    SensorMap::new(&settings, &database).unwrap().answers(&answer, 0, |frame| frames.push(frame));
    for (name, expected) in [
        ("ENCODER.AngleDeg", 8.0),
        ("ENCODER.Present", 1.0),
        ("ENCODER.Fault", 0.0),
        ("ENCODER.Counter", 19.0),
        ("PRESSURES.Pressure1Bar", 1.5),
        ("PRESSURES.Pressure2Bar", 2.75),
        ("PRESSURES.Fault1", 0.0),
        ("PRESSURES.Fault2", 1.0),
        ("PRESSURES.Counter", 19.0),
        ("CLAMP.TorqueNm", 5.5),
        ("CLAMP.Present", 1.0),
        ("CYLINDER.Present", 0.0),
    ] {
        assert!((said(&database, &frames, name) - expected).abs() < 1e-9, "{name}: {frames:?}");
    }
}

fn encoder(database: &Database, angle_deg: f64, counter: f64) -> Frame {
    let (message, angle) = database.signal("ENCODER.AngleDeg").unwrap();
    let mut frame = Frame::new(message.id, &vec![0; message.length]).unwrap();
    angle.codec.encode(angle_deg, frame.data_mut()).unwrap();
    for (name, value) in [("ENCODER.Counter", counter), ("ENCODER.Present", 1.0)] {
        database.signal(name).unwrap().1.codec.encode(value, frame.data_mut()).unwrap();
    }
    frame
}

#[test]
fn an_infinite_value_on_the_wire_is_none_and_called_wrong_until_a_number_comes() {
    let (settings, database) = settings();
    let mut bench = InputMap::new(&settings, &database).unwrap();
    let (message, torque) = database.signal("CLAMP.TorqueNm").unwrap();
    for (torque_nm, counter) in [(f64::INFINITY, 1.0), (f64::NEG_INFINITY, 2.0), (12.5, 3.0)] {
        let mut frame = Frame::new(message.id, &vec![0; message.length]).unwrap();
        torque.codec.encode(torque_nm, frame.data_mut()).unwrap();
        for (name, value) in [("CLAMP.Counter", counter), ("CLAMP.Present", 1.0)] {
            database.signal(name).unwrap().1.codec.encode(value, frame.data_mut()).unwrap();
        }
        bench.take(&TimedFrame { frame, received_ns: 0 }, Some(counter as u64));
        let read = bench.measurement(Tick::at(4), 0);
        if torque_nm.is_infinite() {
            assert!(read.torque_nm.is_nan());
            assert_eq!(read.faulty, Input::Torque.bit());
        } else {
            assert_eq!((read.torque_nm, read.faulty), (torque_nm, 0));
        }
    }
}

#[test]
fn an_older_answer_that_comes_later_is_left_out_and_a_missing_one_grows_old() {
    let (settings, database) = settings();
    let mut bench = InputMap::new(&settings, &database).unwrap();
    let mut take = |angle: f64, counter: f64, commanded| {
        bench.take(&TimedFrame { frame: encoder(&database, angle, counter), received_ns: 0 }, Some(commanded));
        bench.measurement(Tick::at(commanded + 1), 0)
    };
    take(1.0, 65_535.0, 65_535);
    // Over the counter's end.
    let newest = take(2.0, 1.0, 65_537);
    assert_eq!(newest.angle_deg, -1.25 * 2.0 + 3.0);
    let swapped = take(9.0, 0.0, 65_538);
    assert_eq!(swapped.angle_deg, newest.angle_deg, "measured at 65536, and it came after that of 65537");
    assert_eq!(swapped.age_ns[Input::Angle as usize], 2 * PERIOD_NS as u32);
    assert_eq!(bench.outdated(), 1);
    assert_eq!(bench.measurement(Tick::at(65_637), 0).age_ns[Input::Angle as usize], 100 * PERIOD_NS as u32);
}

#[test]
fn before_the_first_command_of_a_run_the_time_of_the_frame_counts() {
    let (settings, database) = settings();
    let mut bench = InputMap::new(&settings, &database).unwrap();
    let origin_ns = 50_000_000;
    // The counter of a preparation, which is no tick of the run.
    let received_ns = origin_ns - 700_000;
    bench.take(&TimedFrame { frame: encoder(&database, 1.0, 32_800.0), received_ns }, None);
    assert_eq!(bench.measurement(Tick::at(0), origin_ns).age_ns[0], 700_000);
    // One that is still on its way when the run has begun.
    bench.take(&TimedFrame { frame: encoder(&database, 1.5, 32_801.0), received_ns: origin_ns - 100_000 }, Some(0));
    assert_eq!(bench.measurement(Tick::at(1), origin_ns).age_ns[0], 1_100_000);
    bench.take(&TimedFrame { frame: encoder(&database, 2.0, 0.0), received_ns: origin_ns }, Some(0));
    let read = bench.measurement(Tick::at(1), origin_ns);
    assert_eq!((read.angle_deg, read.age_ns[0]), (0.5, PERIOD_NS as u32));
    // And it does not come back.
    bench.take(&TimedFrame { frame: encoder(&database, 1.5, 32_802.0), received_ns: origin_ns + 1 }, Some(1));
    assert_eq!(bench.measurement(Tick::at(2), origin_ns).angle_deg, 0.5);
}

#[test]
fn a_signal_that_is_not_there_is_named_with_its_key() {
    let (settings, database) = settings();
    let mut wrong = settings.clone();
    wrong.sensors.torque_nm.as_mut().unwrap().signal = "CLAMP.TorqueNM".to_owned();
    let error = InputMap::new(&wrong, &database).err().unwrap().to_string();
    assert!(error.contains("[can.sensors.torque_nm] signal") && error.contains("TorqueNm"), "{error}");
    let mut wrong = settings.clone();
    wrong.sensors.torque_nm.as_mut().unwrap().counter = Some("ENCODER.Counter".to_owned());
    let error = InputMap::new(&wrong, &database).err().unwrap().to_string();
    assert!(error.contains("[can.sensors.torque_nm] counter") && error.contains("CLAMP"), "{error}");
    let mut wrong = settings.clone();
    wrong.sensors.torque_nm.as_mut().unwrap().gain = 0.0;
    for error in [InputMap::new(&wrong, &database).err(), SensorMap::new(&wrong, &database).err()] {
        let error = error.unwrap().to_string();
        assert!(error.contains("[can.sensors.torque_nm] gain"), "{error}");
    }
    let mut wrong = settings;
    wrong.fixture.as_mut().unwrap().run = "FIXTURE_RUN.Runs".to_owned();
    let error = OutputMap::new(&wrong, &database).err().unwrap().to_string();
    assert!(error.contains("[can.fixture] run"), "{error}");
}

/// Nodes time out without them, and the safe state must be in the last set of all, whatever cycle the database has for their messages.
#[test]
fn valves_and_running_are_sent_every_tick_whichever_messages_they_are_in() {
    let apart = DBC.replace(
        "BO_ 128 VALVES: 3 Bench",
        "BO_ 100 BRAKE: 1 Bench\n SG_ BrakeOpen : 0|1@1+ (1,0) [0|1] \"\" Valves\n\nBO_ 101 STATE: 1 Bench\n SG_ BypassOpen : 0|1@1+ (1,0) [0|1] \"\" \
         Valves\n SG_ Running : 1|1@1+ (1,0) [0|1] \"\" Valves\n\nBO_ 128 VALVES: 3 Bench",
    );
    let apart = apart + "\nBA_ \"GenMsgCycleTime\" BO_ 100 100;\nBA_ \"GenMsgCycleTime\" BO_ 101 50;\n";
    let settings = SETTINGS
        .replace("VALVES.BrakeOpen", "BRAKE.BrakeOpen")
        .replace("VALVES.BypassOpen", "STATE.BypassOpen")
        .replace("VALVES.Running", "STATE.Running");
    let settings: CanSettings = toml::from_str(&settings).unwrap();
    let database = Database::parse(&apart, "apart.dbc").unwrap();
    let mut map = OutputMap::new(&settings, &database).unwrap();
    let command = Command { voltage_v: 0.0, brake_open: true, bypass_open: false, fixture: Fixture::Free, segment: 0 };
    let preparation = Preparation { run: 1, vertical: false, fill_bar: 1.5, start: command };
    for counter in 0..40 {
        let mut frames = no_frames();
        let around = Around { counter, running: true, preparation };
        let count = map.frames(&command, &around, &mut frames).unwrap();
        let frames = &frames[..count];
        for (name, value) in [("BRAKE.BrakeOpen", 1.0), ("STATE.BypassOpen", 0.0), ("STATE.Running", 1.0)] {
            assert_eq!(said(&database, frames, name), value, "{name} at tick {counter}");
        }
        assert_eq!(frames.last().unwrap().id, database.message("VALVES").unwrap().id);
        let fixture = database.message("FIXTURE_POSE").unwrap().id;
        assert_eq!(frames.iter().any(|frame| frame.id == fixture), counter < 2, "now and then, tick {counter}");
    }
}

#[test]
fn an_echo_wider_than_the_counter_begins_anew_where_that_does() {
    let narrow = DBC
        .replace("SG_ Counter : 8|16@1+ (1,0) [0|65535] \"\" Valves", "SG_ Counter : 8|8@1+ (1,0) [0|255] \"\" Valves");
    let (settings, database) = (settings().0, Database::parse(&narrow, "narrow.dbc").unwrap());
    let mut bench = InputMap::new(&settings, &database).unwrap();
    for tick in 0..700_u64 {
        let frame = encoder(&database, 1.0, (tick % 256) as f64);
        bench.take(&TimedFrame { frame, received_ns: 0 }, Some(tick));
        assert_eq!(
            bench.measurement(Tick::at(tick + 1), 0).age_ns[Input::Angle as usize],
            PERIOD_NS as u32,
            "tick {tick}"
        );
    }
}
