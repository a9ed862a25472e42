//! A rig file's signals and the CAN database: each is held against the other.

use super::{Changed, changed, database};
use bench::rig_file::WIRED;

#[test]
fn signals_are_held_against_the_database() {
    let angle = "signal = \"ENCODER.AngleDeg\"";
    for (from, to, words) in [
        (angle, "signal = \"ENCODER.AngelDeg\"", &["did you mean \"AngleDeg\"?"] as &[&str]),
        (angle, "signal = \"ENCODR.AngleDeg\"", &["did you mean \"ENCODER\"?"]),
        (angle, "signal = \"AngleDeg\"", &["MESSAGE.Signal", "got \"AngleDeg\""]),
        (
            "fault = \"PRESSURES.Fault1\"",
            "fault = \"ENCODER.Fault\"",
            &["pressure1_bar] fault: expected a signal of PRESSURES"],
        ),
        (
            "present = \"CLAMP.Present\"",
            "present = \"CYLINDER.Present\"",
            &["torque_nm] present: expected a signal of CLAMP"],
        ),
        (
            "counter = \"CLAMP.Counter\"",
            "counter = \"VALVES.Counter\"",
            &["torque_nm] counter: expected a signal of CLAMP"],
        ),
        (
            "counter = \"CLAMP.Counter\"",
            "counter = \"CLAMP.Present\"",
            &["counter: expected a counter", "at least 4 bits"],
        ),
        (
            "fault = \"PRESSURES.Fault1\"",
            "fault = \"PRESSURES.Pressure2Bar\"",
            &["mapped already", "[can.sensors.pressure2_bar]"],
        ),
        (
            "signal = \"PRESSURES.Pressure2Bar\"",
            "signal = \"PRESSURES.Pressure1Bar\"",
            &["pressure2_bar] signal", "mapped already, by [can.sensors.pressure1_bar]"],
        ),
        ("# latency_ms = 0.0", "latency_ms = 2.0 #", &["latency_ms: is for sensors without a counter"]),
        (
            "bypass_open = \"VALVES.BypassOpen\"",
            "bypass_open = \"VALVES.BrakeOpen\"",
            &["mapped already, by [can.command] brake_open"],
        ),
        ("brake_open = \"VALVES.BrakeOpen\"", "brake_open = \"VALVES.BreakOpen\"", &["did you mean \"BrakeOpen\"?"]),
        (
            "counter = \"VALVES.Counter\"",
            "counter = \"FIXTURE_RUN.Vertical\"",
            &["[can.command] counter: expected a counter"],
        ),
        (
            "kind = \"FIXTURE_POSE.Kind\"",
            "kind = \"VALVES_STATUS.TimedOut\"",
            &["[can.fixture] kind: expected a signal that can hold 0..5"],
        ),
        (
            "message = \"VALVES_STATUS\"",
            "message = \"VALVES_STATS\"",
            &["[[can.heartbeat]] 1, message", "did you mean \"VALVES_STATUS\"?"],
        ),
        (
            "message = \"VALVES_STATUS\"",
            "message = \"VALVES\"",
            &["expected a message that a node sends, got VALVES 080"],
        ),
        ("period_ms = 20.0", "period_ms = 5.0", &["period_ms: expected at least the 10 ms", "got 5"]),
        ("period_ms = 20.0", "period_ms = 100.0", &["period_ms: expected less than [limits] heartbeat_max_ms = 100"]),
    ] {
        let failure = changed(from, to).read().expect_err(to);
        assert_eq!(failure.exit_code(), 2);
        let text = &failure.message;
        assert!(words.iter().all(|word| text.contains(word)), "{to}: expected {words:?} in: {failure}");
    }
    // A message that the bench sends is no sensor's.
    changed(
        "signal = \"CYLINDER.VolumeMl\"\npresent = \"CYLINDER.Present\"\ncounter = \"CYLINDER.Counter\"",
        "signal = \"FIXTURE_FLOW.FlowMlS\"\ngain = 2.0",
    )
    .refused(
        "signal = \"FIXTURE_FLOW.FlowMlS\"",
        &["expected a message that a node sends, got FIXTURE_FLOW 073", "[can.fixture] flow_ml_s"],
    );
    let twice = format!("{WIRED}\n[[can.heartbeat]]\nmessage = \"VALVES_STATUS\"\nperiod_ms = 50.0\n");
    Changed { rig: twice, database: database() }.refused(
        "message = \"VALVES_STATUS\"\nperiod_ms = 50",
        &["[[can.heartbeat]] 2, message: VALVES_STATUS is waited for already"],
    );
    changed("counter = \"VALVES.Counter\"", "# counter")
        .read()
        .expect_err("echoes without a counter")
        .message
        .split("expected [can.command] counter too")
        .nth(5)
        .expect("one for each of the five sensors");
}

#[test]
fn the_database_is_held_against_what_is_asked_of_it() {
    let none = Changed::none;
    let angle = "signal = \"ENCODER.AngleDeg\"";
    let pressure = "signal = \"PRESSURES.Pressure1Bar\"";
    let pressure_range = "(0.000002,0) [0|16.777214] \"bar\"";
    none()
        .database(pressure_range, "(0.0002,0) [0|1677.7214] \"kPa\"")
        .refused(pressure, &["\"kPa\"", "set gain = 0.01"]);
    none()
        .database(pressure_range, "(0.000002,0) [0|16.777214] \"barg\"")
        .refused(pressure, &["set gain = 1 and offset = 1.01325"]);
    none()
        .database(pressure_range, "(0.000002,0) [0|16.777214] \"V\"")
        .refused(pressure, &["is in \"V\", the channel in bar", "calibration"]);
    // Calibrated, the same unit is as it should be.
    none()
        .database(pressure_range, "(0.0002,0) [0|1677.7214] \"kPa\"")
        .rig(pressure, &format!("{pressure}\ngain = 0.01"))
        .read()
        .unwrap();
    none()
        .database(pressure_range, "(0.0000002,0) [0|1.6] \"bar\"")
        .refused(pressure, &["expected a signal that can say 0.5..8 bar", "got 0..1.6"]);
    none().rig(angle, &format!("{angle}\ngain_ = 1")).refused("gain_", &["unknown key", "\"gain\""]);
    none()
        .database("BO_ 128 VALVES: 3 Bench", "BO_ 385 VALVES: 3 Bench")
        .refused("dbc = ", &["two messages have the identifier 181"]);
    none()
        .database("SG_ BrakeOpen : 0|1@1+ (1,0) [0|1]", "SG_ BrakeOpen : 0|1@1- (1,0) [0|0]")
        .refused("brake_open = ", &["[can.command] brake_open: expected a signal that can hold 0..1", "-1..0"]);
    none()
        .database("SG_ BrakeOpen : 0|1@1+ (1,0) [0|1]", "SG_ BrakeOpen : 0|1@1+ (2,0) [0|2]")
        .refused("brake_open = ", &["whole numbers 0..1"]);
    none().database("SG_ AngleDeg : 8|32@1- (1,0) [-60|60]", "SG_ AngleDeg : 8|32@1- (1,0) [-45|45]").refused(
        "angle_deg = \"FIXTURE_POSE",
        &["[can.fixture] angle_deg: expected a signal that can hold -60..60", "-45..45"],
    );
    none()
        .database("[0|20] \"bar\" Fixture\n\nBO_ 115", "[0|20] \"kPa\" Fixture\n\nBO_ 115")
        .refused("fill_bar = ", &["[can.fixture] fill_bar: expected a signal in bar", "no gain"]);
    let multiplexed = none()
        .database("SG_ Running : 2|1@1+", "SG_ Page M : 3|1@1+ (1,0) [0|1] \"\" Valves\n SG_ Running m0 : 2|1@1+")
        .read()
        .expect_err("a command that is not always there");
    assert!(
        multiplexed.message.contains("[can.command] running: expected a message whose signals are all in every frame"),
        "{multiplexed}"
    );
    none().database("SG_ Counter : 31|16@0+ (1,0) [0|65535]", "SG_ Counter : 31|4@0+ (1,0) [0|15]").refused(
        "counter = \"ENCODER",
        &[
            "[can.sensors.angle_deg] counter: expected a counter that begins anew",
            "age_max_ms = 20",
            "ENCODER.Counter",
            "16 ms",
        ],
    );
    none().database("BO_ 387 1;", "BO_ 387 50;").refused("signal = \"CLAMP.TorqueNm\"", &["CLAMP comes every 50 ms"]);
    none().database("BO_ 385 ENCODER: 6", "BO_ 385 ENCODER: 64").refused(angle, &["classic frame"]);
    none().database("BO_ 385 1;", "BO_ 385 50;").refused(angle, &["ENCODER comes every 50 ms", "age_max_ms = 20"]);
    changed("bitrate = 1_000_000", "bitrate = 500_000").refused(
        "bitrate",
        &[
            "[budget] CAN can0:",
            "of 500.0 bits a tick = 14",
            "more than 80.0 %",
            "PRESSURES 182, 8 bytes, 135 bits every 1 ms",
        ],
    );
    none()
        .database("BO_ 1793 100;", "BO_ 1793 0.5;")
        .database("\"GenMsgCycleTime\" INT 0 65535", "\"GenMsgCycleTime\" FLOAT 0 65535")
        .refused("bitrate", &["[budget] CAN can0", "NODE_HEALTH 701, 3 bytes, 85 bits every 0.5 ms"]);
    changed("baud = 460_800 ", "baud = 115_200 ")
        .refused("baud = ", &["[budget] serial port, to the amplifier: 110.0 of 115.2 bits a tick = 95.5 %"]);
    changed("most_share = 0.8", "most_share = 0.7").refused("bitrate", &["703", "70.3 %, more than 70.0 %"]);
}
