//! What is read of a database, and what is refused: every message names file, line and what to do.
#![allow(clippy::unwrap_used, reason = "a test")]

use drivers::can::FrameId;
use drivers::dbc::{Database, DbcError};
use std::path::{Path, PathBuf};

/// Sound, and with a place for everything that can be wrong.
const SOUND: &str = "\
VERSION \"\"

BU_: VALVES SENSORS BENCH

BO_ 416 LOOP: 8 SENSORS
 SG_ Page M : 0|4@1+ (1,0) [0|0] \"\" BENCH
 SG_ Pressure1 m0 : 8|16@1- (0.001,0) [-5|10] \"bar\" BENCH
 SG_ Pressure2 m0 : 31|16@0- (0.001,0) [0|0] \"bar\" BENCH
 SG_ Angle m1 : 8|32@1- (1,0) [0|0] \"deg\" BENCH

BO_ 417 VALVES: 3 BENCH
 SG_ Brake : 0|1@1+ (1,0) [0|1] \"\" VALVES
 SG_ Counter : 8|16@1+ (1,0) [0|0] \"\" VALVES

SIG_VALTYPE_ 416 Angle : 1;
BA_DEF_ BO_ \"GenMsgCycleTime\" INT 0 1000;
BA_DEF_DEF_ \"GenMsgCycleTime\" 5;
BA_ \"GenMsgCycleTime\" BO_ 417 1;
";

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/dbc").join(name)
}

/// The message for the sound database with one piece replaced.
fn refused(from: &str, to: &str) -> String {
    assert_eq!(SOUND.matches(from).count(), 1, "{from:?} is one place of the sound database");
    let text = SOUND.replace(from, to);
    match Database::parse(&text, "rec.dbc") {
        Err(e @ DbcError::File { .. }) => e.to_string(),
        other => panic!("{from:?} -> {to:?}: expected an error of the file, got {other:?}"),
    }
}

#[test]
fn messages_have_their_identifiers_senders_and_cycle_times() {
    let database = Database::parse(SOUND, "rec.dbc").unwrap();
    let told: Vec<_> = database
        .messages()
        .iter()
        .map(|m| (m.name.as_str(), m.id, m.length, m.sender.as_deref(), m.cycle_time_ms, m.signals().len()))
        .collect();
    assert_eq!(
        told,
        [
            ("LOOP", FrameId::Standard(416), 8, Some("SENSORS"), Some(5.0), 4),
            ("VALVES", FrameId::Standard(417), 3, Some("BENCH"), Some(1.0), 2)
        ]
    );
    let pressure = database.signal("LOOP.Pressure1").unwrap().1;
    assert_eq!((pressure.minimum, pressure.maximum), (-5.0, 10.0));
    assert_eq!(pressure.multiplexor.as_deref(), Some("Page"));

    let kinds = Database::read(&file("kinds.dbc")).unwrap();
    let cycle = |name: &str| kinds.message(name).unwrap().cycle_time_ms;
    assert_eq!(
        [cycle("LITTLE"), cycle("BIG"), cycle("FLOATS"), cycle("EXTENDED")],
        [Some(1.0), None, Some(10.0), Some(100.0)]
    );
    let extended = kinds.by_id(FrameId::Extended(0x18FF_0202)).unwrap();
    assert_eq!((extended.name.as_str(), &extended.sender), ("EXTENDED", &None));
    assert!(kinds.by_id(FrameId::Standard(0x202)).is_none());
    assert!(kinds.message("VECTOR__INDEPENDENT_SIG_MSG").is_none(), "no message of the bus");
}

/// One piece that makes the database wrong, the line of the message, and what the message says.
const WRONG: [(&str, &str, usize, &[&str]); 30] = [
    (
        "BO_ 417 VALVES",
        "BO_ 416 VALVES",
        11,
        &["identifier 1A0", "LOOP (sent by SENSORS, line 5)", "VALVES (sent by BENCH, line 11)", "another identifier"],
    ),
    ("417 VALVES:", "417 LOOP:", 11, &["two messages have the name LOOP", "line 5", "rename"]),
    ("BO_ 417 VALVES", "BO_ 2048 VALVES", 11, &["0..=2047 (11 bits)", "got 2048", "add 2147483648"]),
    ("BO_ 417 VALVES", "BO_ 3221225471 VALVES", 11, &["536870911 (29 bits)", "got 3221225471"]),
    ("BO_ 417 1;", "BO_ 65953 1;", 18, &["0..=2047 (11 bits)", "got 65953"]),
    ("SG_ Counter", "SG_ Brake", 13, &["two signals have the name VALVES.Brake", "line 12", "rename"]),
    ("Counter : 8|16", "Counter : 8|0", 13, &["VALVES.Counter", "1..=64 bits, got 0"]),
    ("Counter : 8|16", "Counter : 8|65", 13, &["VALVES.Counter", "1..=64 bits, got 65"]),
    (
        "Counter : 8|16",
        "Counter : 9|16",
        13,
        &["VALVES.Counter", "3 bytes", "start bit 9 and 16 bits (little-endian)", "more bytes"],
    ),
    ("Counter : 8|16@1", "Counter : 14|16@0", 13, &["VALVES.Counter", "start bit 14 and 16 bits (big-endian)"]),
    ("Counter : 8|16", "Counter : 4294967295|16", 13, &["VALVES.Counter", "start bit 4294967295"]),
    (
        "Counter : 8|16",
        "Counter : 0|16",
        13,
        &["VALVES.Brake (line 12)", "VALVES.Counter", "bit 0 of byte 0", "multiplex"],
    ),
    ("Pressure2 m0 : 31", "Pressure2 m0 : 23", 8, &["LOOP.Pressure1 (line 7)", "LOOP.Pressure2", "bit 0 of byte 2"]),
    ("Angle m1 : 8|32", "Angle m1 : 3|32", 9, &["LOOP.Page (line 6)", "LOOP.Angle", "bit 3 of byte 0"]),
    ("Angle m1", "Angle m0", 9, &["LOOP.Pressure1 (line 7)", "LOOP.Angle", "bit 0 of byte 1"]),
    ("Angle m1", "Angle m16", 9, &["LOOP.Angle", "0..=15", "LOOP.Page", "got 16"]),
    ("Angle m1 : 8|32", "Angle m1 : 8|31", 9, &["LOOP.Angle", "expected 32 bits", "got 31", "SIG_VALTYPE_"]),
    ("Page M :", "Page :", 7, &["LOOP.Pressure1", "expected a multiplexor (M)", "none"]),
    (
        "Angle m1 : 8",
        "Angle M : 8",
        7,
        &["LOOP.Pressure1", "expected one multiplexor", "Page and Angle", "SG_MUL_VAL_"],
    ),
    (
        "SIG_VALTYPE_ 416",
        "SG_MUL_VAL_ 416 Angle Pressure1 1-1;\nSIG_VALTYPE_ 416",
        15,
        &["LOOP.Angle", "LOOP.Pressure1", "without M"],
    ),
    ("SIG_VALTYPE_ 416", "SG_MUL_VAL_ 416 Angle Nothing 1-1;\nSIG_VALTYPE_ 416", 15, &["SG_MUL_VAL_", "LOOP.Nothing"]),
    (
        "SIG_VALTYPE_ 416",
        "SG_MUL_VAL_ 417 Brake Counter 1-1;\nSIG_VALTYPE_ 416",
        15,
        &["VALVES.Brake", "m...", "mark it"],
    ),
    ("SIG_VALTYPE_ 416", "SG_MUL_VAL_ 416 Angle Page 5-3;\nSIG_VALTYPE_ 416", 15, &["LOOP.Angle", "got 5-3"]),
    (
        "SIG_VALTYPE_ 416",
        "SG_MUL_VAL_ 416 Angle Page 1-1, 3-3, 5-5, 7-7, 9-9;\nSIG_VALTYPE_ 416",
        9,
        &["LOOP.Angle", "at most 4 ranges", "got 5", "join"],
    ),
    (
        "SIG_VALTYPE_ 416 Angle",
        "SIG_VALTYPE_ 416 Angel",
        15,
        &["SIG_VALTYPE_", "signal Angel of message 416", "correct the name"],
    ),
    ("[-5|10]", "[10|-5]", 7, &["LOOP.Pressure1", "minimum <= maximum", "[10|-5]", "[0|0]"]),
    (
        "Pressure1 m0 : 8|16@1- (0.001,0)",
        "Pressure1 m0 : 8|16@1- (0,0)",
        7,
        &["LOOP.Pressure1", "factor other than 0", "got factor 0"],
    ),
    ("Pressure1 m0 : 8|16@1- (0.001,0)", "Pressure1 m0 : 8|16@1- (1,1e999)", 7, &["LOOP.Pressure1", "offset inf"]),
    ("BO_ 417 1;", "BO_ 417 -1;", 18, &["message VALVES", "GenMsgCycleTime in ms, >= 0", "got -1"]),
    ("BO_ 417 1;", "BO_ 417 \"often\";", 18, &["message VALVES", "got \"often\""]),
];

#[test]
fn each_error_names_line_and_signals_and_what_to_do() {
    for (from, to, line, pieces) in WRONG {
        let message = refused(from, to);
        assert!(message.starts_with(&format!("rec.dbc:{line}: ")), "{to:?}: expected line {line}: {message}");
        for piece in pieces {
            assert!(message.contains(piece), "{to:?}: expected {piece:?} in: {message}");
        }
    }
}

#[test]
fn the_parser_s_own_errors_have_line_column_expected_and_got() {
    for (from, to, place, pieces) in [
        ("(0.001,0) [-5|10]", "(0.001;0) [-5|10]", "7: column 35: ", ["expected \",\" or ", ", got \";0)"]),
        ("VALVES: 3 BENCH", "VALVES 3 BENCH", "11: column 16: ", ["expected \":\", ", "got \"3 BENCH\""]),
        ("VALVES: 3 BENCH", "VALVES: 3", "11: column 18: ", ["expected a name, ", "got the end of the line"]),
        ("Angle : 1;", "Angle : 3;", "15: column 26: ", ["expected \"0\" or \"1\" or \"2\"", "got \"3;\""]),
        ("BO_ 417 1;\n", "BO_ 417 1", "18: column 32: ", ["expected ", "got the end of the file"]),
        ("BU_:", "Hello\nBU_:", "3: column 1: ", ["expected a statement of a DBC file", "got \"Hello\""]),
        ("[-5|10] \"bar\"", "[-5|10] bar", "7: column 47: ", ["expected \"\\\"\"", "got \"bar BENCH\""]),
        ("Angle m1", "Angle m", "9: column 12: ", ["expected m and a value (m0, m1, ...)", "got m"]),
        (
            "Counter : 8|16",
            "Counter : 99999999999999999999|16",
            "13: column 16: ",
            ["whole number", "99999999999999999999"],
        ),
        ("VALVES: 3", "VALVES: -3", "11: column 17: ", ["whole number", "-3"]),
        ("Page M", "Page m99999999999999999999", "5: ", ["Unknown multiplex indicator", "99999999999999999999"]),
    ] {
        let message = refused(from, to);
        assert!(message.starts_with(&format!("rec.dbc:{place}")), "{to:?}: expected {place}: {message}");
        for piece in pieces {
            assert!(message.contains(piece), "{to:?}: expected {piece:?} in: {message}");
        }
    }
}

#[test]
fn multiplexors_that_depend_on_themselves_or_are_floats() {
    let message = |signals: &str, more: &str| {
        let text = format!("BU_: N\n\nBO_ 1 M: 8 N\n{signals}\n{more}");
        Database::parse(&text, "m.dbc").unwrap_err().to_string()
    };
    let a = " SG_ A m0M : 0|8@1+ (1,0) [0|0] \"\" N\n SG_ B m0M : 8|8@1+ (1,0) [0|0] \"\" N\n";
    let told = message(a, "SG_MUL_VAL_ 1 A B 0-0;\nSG_MUL_VAL_ 1 B A 0-0;\n");
    assert!(told.starts_with("m.dbc:4: signal M.A: ") && told.contains("depends on itself: B, A"), "{told}");
    let told = message(a, "SG_MUL_VAL_ 1 A A 0-0;\nSG_MUL_VAL_ 1 B A 0-0;\n");
    assert!(told.contains("depends on itself: A"), "{told}");
    let b = " SG_ A M : 0|32@1- (1,0) [0|0] \"\" N\n SG_ B m0 : 32|8@1+ (1,0) [0|0] \"\" N\n";
    let told = message(b, "SIG_VALTYPE_ 1 A : 1;\n");
    assert!(told.starts_with("m.dbc:5: signal M.B: ") && told.contains("M.A, an IEEE float"), "{told}");
}

#[test]
fn a_name_that_is_not_there_is_told_what_is() {
    let database = Database::parse(SOUND, "rec.dbc").unwrap();
    let told = |path: &str| database.signal(path).map(|_| ()).unwrap_err().to_string();
    assert_eq!(
        told("LOOP.pressure_1"),
        "rec.dbc: expected one of the signals of message LOOP, got \"pressure_1\", did you mean \"Pressure1\"?; it has Page, Pressure1, \
         Pressure2, Angle"
    );
    assert_eq!(
        told("LOPO.Angle"),
        "rec.dbc: expected one of its messages, got \"LOPO\", did you mean \"LOOP\"?; it has LOOP, VALVES"
    );
    assert_eq!(told("Engine.Speed"), "rec.dbc: expected one of its messages, got \"Engine\"; it has LOOP, VALVES");
    assert_eq!(
        told("Angel"),
        "rec.dbc: expected a signal as MESSAGE.Signal, got \"Angel\", did you mean \"LOOP.Angle\"?"
    );
    let empty = Database::parse("", "empty.dbc").unwrap();
    assert_eq!(
        empty.signal("A.B").unwrap_err().to_string(),
        "empty.dbc: expected one of its messages, got \"A\"; it has no messages"
    );
}

#[test]
fn messages_longer_than_a_classic_frame_are_tolerated_and_not_mapped() {
    let text = SOUND.replace("VALVES: 3 BENCH", "VALVES: 64 BENCH").replace("Counter : 8|16", "Counter : 480|16");
    let database = Database::parse(&text, "fd.dbc").unwrap();
    let message = database.message("VALVES").unwrap();
    assert_eq!((message.length, message.signals().len()), (64, 0));
    let told = database.signal("VALVES.Counter").unwrap_err().to_string();
    assert!(
        told.starts_with("fd.dbc: message VALVES: expected a classic frame of at most 8 bytes, got 64 bytes"),
        "{told}"
    );
    let told = database.signal("VALVES.Countre").unwrap_err().to_string();
    assert!(told.contains("did you mean \"Counter\"?"), "{told}");
    assert!(database.signal("LOOP.Angle").is_ok(), "the others can be mapped");
}

#[test]
fn files_are_utf_8_or_windows_1252_with_any_line_ends() {
    let dir = tempfile::tempdir().unwrap();
    let path = dir.path().join("rec.dbc");
    let text = SOUND.replace("\"deg\"", "\"°\"");
    let latin: Vec<u8> = text.chars().map(|c| c as u8).collect();
    let marked = [b"\xEF\xBB\xBF".as_slice(), text.as_bytes()].concat();
    let windows = text.replace('\n', "\r\n").into_bytes();
    for (name, bytes) in
        [("utf-8", text.clone().into_bytes()), ("latin", latin), ("marked", marked), ("windows", windows)]
    {
        std::fs::write(&path, bytes).unwrap();
        let database = Database::read(&path).unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(database.signal("LOOP.Angle").unwrap().1.unit, "°", "{name}");
    }
    std::fs::write(&path, SOUND.replace("[-5|10]", "[10|-5]").replace('\n', "\r\n")).unwrap();
    let told = Database::read(&path).unwrap_err().to_string();
    assert!(told.contains("rec.dbc:7: "), "{told}");

    let told = Database::read(&dir.path().join("none.dbc")).unwrap_err().to_string();
    assert!(told.contains("none.dbc: expected a CAN database") && told.contains("No such file"), "{told}");
    let told = Database::read(dir.path()).unwrap_err().to_string();
    assert!(told.contains("expected a CAN database"), "{told}");
}
