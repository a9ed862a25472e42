//! The runs on offer for what a diagnosis leaves open, and `bench diagnose --auto` from end to end.

#![allow(clippy::unwrap_used, reason = "a test that can't go on fails")]

use bench::blind::rig::{Truth, draw};
use bench::blind::runs::record;
use bench::next::auto::Extended;
use bench::next::candidates::{Room, candidates};
use bench::next::{design_for, play};
use bench::progress::Progress;
use bench::rig_file::Rig;
use identify::design::{Question, Rival};
use identify::fit::{Effort, fit};
use identify::identification::identify;
use model::effects::find;
use profiles::{Context, Hands, Script};
use recordings::{Campaign, Role};
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

#[test]
fn the_run_that_is_proposed_separates_the_rivals_and_trips_on_neither() {
    // one horizontal run with a tilted plane: an encoder whose zero is off does nearly the same there
    let drawn = draw(11, 5, 0);
    let effects = vec![(find("tilt").unwrap(), vec![0.0, 0.1])];
    let recorded = record(&Truth { parameters: drawn.parameters, effects }, &drawn, 11, 5).unwrap();
    let mut loaded = recorded.loaded;
    loaded.runs.retain(|r| r.entry.file.starts_with("random_a") || r.entry.file.starts_with("pump_map"));
    loaded.campaign.runs = loaded.runs.iter().map(|r| r.entry.clone()).collect();
    let identified = identify(&loaded, &|_| {}).unwrap();
    let problem = identified.problem.shortened(20.0);
    let rivals: Vec<Rival> = [("tilt", vec![0.0, 0.05]), ("angle_offset", vec![0.3])]
        .into_iter()
        .map(|(id, values)| {
            let layout = identified.fit.layout.with(find(id).unwrap());
            let mut point = identified.fit.point.clone();
            point.theta.extend(values);
            let fit = fit(&problem, &layout, point, Effort { iterations: 6, ..Effort::default() }).unwrap();
            Rival { ids: vec![find(id).unwrap().header().id], probability: 0.5, fit }
        })
        .collect();
    let mut rig = Rig::read(None).unwrap();
    rig.facts = loaded.campaign.rig;
    rig.limits.voltage_max_v = rig.facts.u_max_v * (1.0 + 1e-9);
    let sets = rivals.iter().map(|r| (r.ids.clone(), 0.5)).collect();
    let room = Room::of(&loaded, &rig.limits);
    let progress = Progress::for_stderr();
    let designed = design_for(&problem, &rivals, &Question::Which(sets), &room, &rig, "next_1", &progress).unwrap();
    let text = designed.script.unwrap_or_else(|| panic!("{}", designed.said));
    let run = designed.run.unwrap();
    println!("{}", designed.said);
    assert!(run.separates.len() == 1 && run.separates[0].standard_errors > 1.0, "{run:?}");
    assert!(run.separates[0].between == ["tilt", "angle_offset"] && run.seconds < 400.0, "{run:?}");
    let script = Script::parse(&text, "next.toml").unwrap();
    for rival in &rivals {
        let (prediction, recording) = play::play(&script, &rig, &play::as_plant(rival), 1).unwrap();
        prediction.judge(&script).unwrap();
        assert!(recording.len() > 1000);
    }
}

#[test]
fn a_further_run_is_added_to_a_copy_and_the_campaign_is_not_touched() {
    let dir = tempfile::tempdir().unwrap();
    let (own, copy) = (dir.path().join("own"), dir.path().join("copy"));
    std::fs::create_dir(&own).unwrap();
    let text = "format = 1\nname = \"n\"\n[rig]\nJ = 0.085\nG = 4.0\nu_max = 24.0\n[[run]]\nfile = \"a.csv\"\n\
                protocol = \"random-steps\"\nrole = \"validate\"\nplane = \"horizontal\"\n";
    std::fs::write(own.join("campaign.toml"), text).unwrap();
    std::fs::write(own.join("a.csv"), "as it was").unwrap();
    let begun = Campaign::open(&own).unwrap();
    let rig = Rig::read(None).unwrap();
    let room = Room { turn_deg: 20.0, fill_bar: 2.8, fills_bar: (2.0, 3.5) };
    let script = candidates(&room)[0].script("next_1", 1);
    let mut extended = Extended::begin(&begun, &copy).unwrap();
    let seconds = extended.record(&script, &rig, 1, &Progress::for_stderr()).unwrap();
    assert!((2.0..60.0).contains(&seconds), "{seconds}");
    let grown = Campaign::open(&copy).unwrap();
    assert_eq!(
        grown.runs.iter().map(|r| (r.file.as_str(), r.role)).collect::<Vec<_>>(),
        [("a.csv", Role::Validate), ("next_1.mcap", Role::Identify)]
    );
    let recording = grown.read(&grown.runs[1]).unwrap();
    assert!((recording.len() as f64 - 1000.0 * seconds).abs() < 1.5, "{} rows", recording.len());
    assert_eq!(std::fs::read_to_string(own.join("campaign.toml")).unwrap(), text);
    assert_eq!(std::fs::read_to_string(copy.join("a.csv")).unwrap(), "as it was");
    assert_eq!(std::fs::read_dir(&own).unwrap().count(), 2);
}
