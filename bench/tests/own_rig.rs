//! docs/OWN_RIG.md: the rig file, the database and the profiles in it are what the program takes.
#![allow(clippy::unwrap_used, reason = "a test")]

mod ends;
mod guides;

use ends::{Running, read};
use std::path::Path;
use std::process::Command;

const OWN_RIG: &str = include_str!("../../docs/OWN_RIG.md");

#[test]
fn what_can_be_followed_without_hardware_does_what_it_says() {
    let dir = tempfile::tempdir().unwrap();
    guides::follow(OWN_RIG, "docs/OWN_RIG.md", dir.path());
    // What is wired in the text is what the program reads: calibration and limits, not some default.
    let rig = bench::rig_file::Rig::read(Some(&dir.path().join("my_rig.toml"))).unwrap();
    assert_eq!((rig.limits.pressure_max_bar, rig.limits.angle_max_deg, rig.facts.u_max_v), (4.0, 40.0, 12.0));
    let understood = bench::rig_file::Understood::of(&rig).unwrap();
    let pressure = understood.mapping.iter().find(|m| m.key.contains("pressure1_bar")).unwrap();
    assert_eq!((pressure.gain, pressure.signal.as_str()), (Some(0.01), "Pressure1KPa"));
    rehearse(dir.path());
}

/// The lines of the document that need terminals of their own, in its words.
fn rehearse(dir: &Path) {
    let line = |begin: &str| {
        let line = OWN_RIG.lines().find_map(|line| line.strip_prefix("$ ").filter(|line| line.starts_with(begin)));
        let words = line.unwrap_or_else(|| panic!("{begin} is not in the document")).split(' ').skip(1);
        words.collect::<Vec<_>>()
    };
    let start = |arguments: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_bench"));
        command.current_dir(dir);
        Running::start(command, arguments)
    };
    let instance = format!("rehearsal-{}", std::process::id());
    let mut emulator = start(&line("bench emulate"));
    emulator.wait_for("amplifier: ");
    let mut run = start(
        &[line("bench run first_motion.toml --realtime --rig rehearsal.toml"), vec!["--instance", &instance]].concat(),
    );
    run.wait_for("ASKED: prepare the rig for first_motion");
    // Who asks may listen a moment later than it asks.
    let confirmed = (0..50).any(|_| start(&["confirm", "--instance", &instance]).end().0 == 0);
    assert!(confirmed, "{}", run.end().1);
    let (code, said) = run.end();
    assert_eq!(code, 0, "{said}");
    let (samples, certificate) = read(&dir.join("rehearsal.mcap"));
    assert!(certificate.is_lossless(), "{certificate}");
    // With the bypass open the lever hardly moves; then it goes to positive angles first, and comes back.
    let mean = |from_s: f64, to_s: f64| {
        let within = samples.values().filter(|s| (from_s..to_s).contains(&s.time_s()) && !s.angle_deg.is_nan());
        let (count, sum) = within.fold((0.0, 0.0), |(count, sum), s| (count + 1.0, sum + s.angle_deg));
        sum / count
    };
    let (before, bypassed) = (mean(0.0, 1.0), mean(2.5, 3.0));
    let (there, back) = (mean(3.8, 4.2), mean(5.1, 5.5));
    let told = format!("at rest {before}, with the bypass open {bypassed}, pushed {there}, pulled {back}");
    assert!((bypassed - before).abs() < 0.2, "{told}");
    assert!(there - bypassed > 0.25 && there - back > 0.25, "{told}");
    emulator.interrupt();
    assert_eq!(emulator.end().0, 0);
}
