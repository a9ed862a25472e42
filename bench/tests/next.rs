//! The runs on offer for what a diagnosis leaves open, and `bench diagnose --auto` from end to end.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

use bench::next::candidates::{Room, candidates};
use profiles::{Context, Hands, Script};
use std::process::{Command, Output};

fn bench(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_bench")).args(arguments).env_remove("RUST_LOG").output().unwrap()
}

#[test]
fn every_candidate_is_a_script_that_a_rig_can_play() {
    for turn_deg in [12.0, 30.0] {
        let all = candidates(&Room { turn_deg, fill_bar: 2.8, fills_bar: (1.9, 3.9) });
        assert!(all.len() > 35, "{}", all.len());
        for c in &all {
            for passes in [c.passes, 3 * c.passes] {
                let text = c.script("next_1", passes);
                let script = Script::parse(&text, "next.toml").unwrap_or_else(|e| panic!("{e}\n{text}"));
                let context = Context { u_max_v: 24.0, seed: 1, hands: Hands::Rig };
                script.compile(&context).unwrap_or_else(|e| panic!("{e}\n{text}"));
                assert_eq!(script.role, profiles::Role::Identify);
            }
        }
        let bench: Vec<String> = all.iter().filter(|c| !c.grows).map(|c| c.script("next_1", 1)).collect();
        assert_eq!(bench.len(), 4, "the bench experiments, cut down");
        assert!(bench[0].contains("[-40, 0, 40]") && !bench[0].contains("-30"), "{}", bench[0]);
        assert!(bench[3].contains("[1.5, 4.5]") && !bench[3].contains("0.78"), "{}", bench[3]);
    }
}

#[test]
fn auto_needs_an_emulated_rig_and_a_budget() {
    let dir = tempfile::tempdir().unwrap();
    let text = "format = 1\nname = \"n\"\n[rig]\nJ = 0.085\nG = 4.0\nu_max = 24.0\n[[run]]\nfile = \"a.csv\"\n\
                protocol = \"random-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n";
    std::fs::write(dir.path().join("campaign.toml"), text).unwrap();
    std::fs::write(dir.path().join("a.csv"), "").unwrap();
    let folder = dir.path().to_str().unwrap();
    for (arguments, word) in [
        (&["diagnose", folder, "--auto"][..], "--rig"),
        (&["diagnose", folder, "--auto", "--budget-min", "0"], "--budget-min"),
        (&["diagnose", folder, "--most-runs", "2"], "--auto"),
    ] {
        let output = bench(arguments);
        let said = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(said.contains(word), "{word} is missing in: {said}");
    }
    std::fs::create_dir_all(dir.path().join("analysis/auto")).unwrap();
    let output = bench(&["diagnose", folder, "--auto"]);
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(2) && said.contains("nothing is overwritten"), "{said}");
}
