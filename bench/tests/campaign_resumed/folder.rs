//! A folder with three profiles that need each other, and what is recorded in it.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

pub const HEAD: &str = "role = \"identify\"\nplane = \"horizontal\"\n[start]\nbrake = \"open\"\nbypass = \"closed\"\n";

/// The pump at two voltages and two loads: enough for eq. (10).
pub fn pump() -> String {
    let mut text = format!("name = \"pump\"\nprotocol = \"pump-map\"\n{HEAD}");
    text.push_str("fixture = \"pump-bench\"\npressure1_bar = 1.5\npressure2_bar = 1.5\n");
    text.push_str("[[step]]\nfor_each = { load_bar = [1.5, 3.0, 4.5] }\n");
    text.push_str("[[step.step]]\nvoltage_v = 0.0\nfixture = \"pump-bench\"\npressure1_bar = \"$load_bar\"\n");
    text.push_str("pressure2_bar = 1.5\nfor_s = 0.2\n");
    text.push_str("[[step.step]]\nfor_each = { share = [0.3, 0.6, 0.9] }\n");
    text.push_str("[[step.step.step]]\nvoltage_u_max = \"$share\"\nfor_s = 4.0\n");
    text
}

/// Strokes at flows that only the pump's map makes possible.
fn flows() -> String {
    format!(
        "name = \"flows\"\nprotocol = \"constant-flow\"\n{HEAD}fixture = \"free\"\nfill_bar = 3.0\n[[step]]\nfor_s = 1.0\n\
         [[step]]\nfor_each = {{ flow_ml_s = [4, -4, 8, -8] }}\n[[step.step]]\nflow_ml_s = \"$flow_ml_s\"\nfor_s = 3.0\n\
         [[step.step]]\nvoltage_v = 0.0\nfor_s = 6.0\n"
    )
}

fn steps() -> String {
    format!(
        "name = \"steps\"\nprotocol = \"random-steps\"\n{HEAD}fixture = \"free\"\nfill_bar = 2.8\n[[step]]\nfor_s = 1.0\n\
         [[step]]\n[step.random]\ntotal_s = 50.0\nlength_s = [0.2, 2.5]\nvoltage_u_max = [0.04, 0.9]\nzero_share = 0.1\n\
         brake_closed_share = 0.12\nbypass_open_share = 0.12\nguard_deg = 25.0\n"
    )
}

/// A folder with the three profiles, and what is recorded in it.
pub struct Bench {
    pub folder: tempfile::TempDir,
}

impl Bench {
    pub fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        for (name, text) in [("pump", pump()), ("flows", flows()), ("steps", steps())] {
            std::fs::write(folder.path().join(format!("{name}.toml")), text).unwrap();
        }
        Bench { folder }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The campaign, with its profiles in an order that is not the one by need.
    pub fn command(&self, out: &str) -> Command {
        self.command_of(out, &["flows", "steps", "pump"])
    }

    pub fn command_of(&self, out: &str, profiles: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        command.arg("campaign").arg("--out").arg(self.path(out));
        command.args(profiles.iter().map(|name| self.path(&format!("{name}.toml"))));
        command.stdout(Stdio::piped()).stderr(Stdio::piped());
        command
    }

    pub fn done(&self, out: &str) {
        let output = self.command(out).output().unwrap();
        assert!(output.status.success(), "{}", said(&output));
    }
}

pub fn said(output: &Output) -> String {
    String::from_utf8_lossy(&output.stderr).into_owned() + &String::from_utf8_lossy(&output.stdout)
}

/// All files of a campaign but those that were set aside.
pub fn files(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let entries = std::fs::read_dir(dir).unwrap().map(|entry| entry.unwrap().path());
    entries
        .filter(|path| path.is_file())
        .map(|path| (path.file_name().unwrap().to_string_lossy().into_owned(), std::fs::read(path).unwrap()))
        .collect()
}

pub fn set_aside(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let aside = dir.join("set_aside");
    if aside.exists() { files(&aside) } else { BTreeMap::new() }
}

pub fn assert_same(dir: &Path, expected: &BTreeMap<String, Vec<u8>>) {
    let got = files(dir);
    assert_eq!(got.keys().collect::<Vec<_>>(), expected.keys().collect::<Vec<_>>());
    for (name, bytes) in expected {
        assert!(got[name] == *bytes, "{name} is another");
    }
}

/// Waits until the child has ended or the time is over; whether it has ended.
pub fn ended_within(child: &mut Child, wait: Duration) -> bool {
    let begin = Instant::now();
    while begin.elapsed() < wait {
        if child.try_wait().unwrap().is_some() {
            return true;
        }
        std::thread::sleep(Duration::from_millis(1));
    }
    child.try_wait().unwrap().is_some()
}
