//! Tables of a wave: found beside the script, refused with file, line and column, and carried along by the script's text.

use profiles::{Context, LoadError, Script};
use rt_core::{Measurement, Reference, Target, Tick};
use std::path::PathBuf;

const SCRIPT: &str = r#"name = "t"
protocol = "square-wave"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
[[step]]
target = { quantity = "angle_deg", wave = "file", file = "waves/a.csv" }
for_s = 0.1
"#;

/// A folder of its own for each test, removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(test: &str) -> Self {
        let path = std::env::temp_dir().join(format!("profiles-{test}-{}", std::process::id()));
        std::fs::create_dir_all(path.join("waves")).expect("temporary folder");
        Folder(path)
    }

    fn write(&self, file: &str, text: &str) {
        std::fs::write(self.0.join(file), text).expect("temporary file");
    }

    fn read(&self) -> Result<Script, LoadError> {
        Script::read(&self.0.join("t.toml"))
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = std::fs::remove_dir_all(&self.0);
    }
}

fn targets(script: &Script) -> Vec<Target> {
    let mut playback =
        script.compile(&Context { u_max_v: 20.0, seed: 0, hands: profiles::Hands::Rig }).expect("compiles");
    (0..100).map(|k| playback.step(Tick::at(k), &Measurement::NONE).target).collect()
}

#[test]
fn a_table_lies_beside_the_script_and_goes_with_its_text() {
    let folder = Folder::new("beside");
    folder.write("t.toml", SCRIPT);
    folder.write("waves/a.csv", "time_s,value\r\n0,1.1\r\n\r\n0.0333333331, 0.30000000000000004\r\n1e0,-7e0\r\n");
    let script = folder.read().expect("script and table");
    let Target::AngleDeg { angle_deg, .. } = targets(&script)[0] else { panic!("no angle") };
    assert_eq!(angle_deg, 1.1);
    // As a recording keeps it, far from its folder.
    let kept = Script::parse(&script.text, "kept.toml").expect("the text is enough");
    assert_eq!(targets(&kept), targets(&script));
    assert_eq!(kept.text, script.text);
}

#[test]
fn a_bad_table_is_refused_with_file_line_and_column() {
    let folder = Folder::new("bad");
    folder.write("t.toml", SCRIPT);
    let at = |file: &str, line: usize| format!("{}:{line}: ", folder.0.join(file).display());
    let missing = folder.read().expect_err("no table").to_string();
    assert!(missing.starts_with(&at("t.toml", 10)) && missing.contains("a.csv"), "{missing}");
    for (table, line, reason) in [
        ("", 1, "header `time_s,value`, got ``"),
        ("time,value\n0,1\n", 1, "got `time,value`"),
        ("time_s,value\n", 1, "at least one row"),
        ("time_s,value\n0,1\n0.1\n", 3, "expected 2 columns, time_s and value, got 1"),
        ("time_s,value\r\n\r\n0,1\r\n\r\n\r\n0.1,2,3\r\n", 6, "expected 2 columns"),
        ("time_s,value\n0,1\n0.1,x\n", 3, "column 2 (value): expected a finite number, got \"x\""),
        ("time_s,value\n0,1\n0.1,\n", 3, "column 2 (value): expected a finite number, got \"\""),
        ("time_s,value\n0,1\n\n0.1,inf\n", 4, "column 2 (value): expected a finite number"),
        ("time_s,value\nnan,1\n", 2, "column 1 (time_s): expected a finite number"),
        ("time_s,value\n-1,1\n", 2, "column 1 (time_s): expected a time within"),
        ("time_s,value\n0.1,1\n", 2, "the first row must be at 0 s, got 0.1"),
        ("time_s,value\n0,1\n0.2,1\n0.2,1\n", 4, "times must increase, got 0.2 after 0.2"),
        ("time_s,value\n0,1\n0.2,44\n0.3,45.5\n0.4,50\n", 4, "got 45.5"),
    ] {
        folder.write("waves/a.csv", table);
        let error = folder.read().expect_err(table).to_string();
        assert!(error.starts_with(&at("waves/a.csv", line)), "{error}\n{table}");
        assert!(error.contains(reason), "{error}\nexpected: {reason}");
    }
}

#[test]
fn a_table_comes_from_nowhere_but_the_folder_or_the_script() {
    let folder = Folder::new("where");
    for path in ["../a.csv", "/etc/passwd", "", "./a\\\"b"] {
        folder.write("t.toml", &SCRIPT.replacen("waves/a.csv", path, 1));
        let error = folder.read().expect_err(path).to_string();
        assert!(error.contains("t.toml:10: "), "{error}");
    }
    // A script with [files] is complete: its folder is not looked into.
    folder.write("t.toml", &format!("{SCRIPT}[files]\n\"b.csv\" = \"time_s,value\\n0,1\\n\"\n"));
    folder.write("waves/a.csv", "time_s,value\n0,1\n");
    let error = folder.read().expect_err("not in [files]").to_string();
    assert!(error.contains("t.toml:10: ") && error.contains("[files]"), "{error}");
    assert!(matches!(Script::read(&folder.0.join("none.toml")), Err(LoadError::Read { .. })));
}

#[test]
fn a_voltage_beyond_the_rig_is_found_in_the_table() {
    let folder = Folder::new("volts");
    folder.write("t.toml", &SCRIPT.replacen("angle_deg", "voltage_v", 1));
    folder.write("waves/a.csv", "time_s,value\n0,1\n0.5,-21\n");
    let script = folder.read().expect("no rig yet");
    let error = script
        .compile(&Context { u_max_v: 20.0, seed: 0, hands: profiles::Hands::Rig })
        .expect_err("21 V on a rig of 20 V");
    assert!(error.line == 9 && error.what.contains("-21 V (line 3 of its file)"), "{error}");
}
