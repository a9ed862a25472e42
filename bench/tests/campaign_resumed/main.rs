//! A campaign that is interrupted and called again: the same bytes in the end as one that was not, nothing lost, nothing overwritten.

#![allow(clippy::unwrap_used, reason = "a test")]

mod folder;

use folder::{Bench, HEAD, assert_same, ended_within, files, pump, said, set_aside};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[test]
fn killed_at_random_moments_it_ends_up_with_the_bytes_of_one_that_was_not() {
    const KILLS: usize = 24;
    let bench = Bench::new();
    let begin = Instant::now();
    bench.done("whole");
    let whole_time = begin.elapsed();
    let expected = files(&bench.path("whole"));
    let names: Vec<&str> = expected.keys().map(String::as_str).collect();
    assert_eq!(names, ["campaign.toml", "flows.mcap", "plan.toml", "pump.mcap", "steps.mcap"]);
    assert!(set_aside(&bench.path("whole")).is_empty());

    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (mut kills, mut campaigns, mut parts) = (0, 0, 0);
    while kills < KILLS {
        campaigns += 1;
        let out = format!("killed_{campaigns}");
        let dir = bench.path(&out);
        // What killed calls were writing: the last one's is still there, or set aside like all before it.
        let mut left: Vec<Vec<u8>> = Vec::new();
        loop {
            let mut child = bench.command(&out).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
            if !ended_within(&mut child, whole_time.mul_f64(rng.random_range(0.0..0.8))) {
                child.kill().unwrap();
            }
            let status = child.wait().unwrap();
            let aside = set_aside(&dir);
            let open: Vec<Vec<u8>> = if dir.exists() {
                let files = files(&dir).into_iter();
                files.filter(|(name, _)| name.ends_with(".mcap.part")).map(|(_, bytes)| bytes).collect()
            } else {
                Vec::new()
            };
            for bytes in &left {
                let kept = aside.values().chain(&open).any(|kept| kept == bytes);
                assert!(kept, "a recording that a killed call left is gone or changed");
            }
            parts += open.iter().filter(|bytes| !left.contains(bytes)).count();
            left.extend(open);
            if status.success() {
                break;
            }
            assert_eq!(status.signal(), Some(9), "nothing but the kill ends it early");
            kills += 1;
        }
        assert_same(&dir, &expected);
        std::fs::remove_dir_all(&dir).unwrap();
    }
    eprintln!("{kills} kills in {campaigns} campaigns, {parts} of them within a recording");
    assert!(parts > 0, "no kill hit a recording");
}

#[test]
fn a_stop_is_130_and_the_next_call_goes_on() {
    let bench = Bench::new();
    bench.done("whole");
    let expected = files(&bench.path("whole"));
    let dir = bench.path("stopped");
    let child = bench.command("stopped").spawn().unwrap();
    // While the first run is recorded; it takes far longer than a look at the folder.
    while !dir.join("pump.mcap.part").exists()
        && !dir.join("pump.mcap").exists()
        && !dir.join("steps.mcap.part").exists()
    {
        std::thread::sleep(Duration::from_millis(1));
    }
    // SAFETY: a signal to a child of this process that has not been waited for.
    unsafe { libc::kill(child.id() as i32, libc::SIGINT) };
    let output = child.wait_with_output().unwrap();
    // It may have been done before the signal came.
    if !output.status.success() {
        assert_eq!(output.status.code(), Some(130), "{}", said(&output));
    }
    bench.done("stopped");
    assert_same(&dir, &expected);
}

#[test]
fn another_plan_on_the_same_folder_is_refused_with_the_difference_named() {
    let bench = Bench::new();
    bench.done("c");
    let dir = bench.path("c");
    let before = files(&dir);
    let refused = |mut command: Command, difference: &str| {
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(2), "{}", said(&output));
        assert!(said(&output).contains(difference), "{:?} does not name {difference}", said(&output));
        assert_same(&dir, &before);
    };
    let mut seed = bench.command("c");
    seed.args(["--seed", "2"]);
    refused(seed, "seed: 1 in the plan, 2 now");
    let rig = bench.path("rig.toml");
    std::fs::write(&rig, "name = \"another\"\n[limits]\npressure_max_bar = 7.5\n").unwrap();
    let mut other_rig = bench.command("c");
    other_rig.arg("--rig").arg(&rig);
    refused(other_rig, "limits.pressure_max_bar: ");
    refused(
        bench.command_of("c", &["steps", "pump"]),
        "order of the runs: steps, pump, flows in the plan, steps, pump now",
    );
    refused(bench.command_of("c", &["pump", "steps", "flows"]), "order of the runs: ");
    std::fs::write(bench.path("pump.toml"), pump().replace("for_s = 4.0", "for_s = 5.0")).unwrap();
    refused(bench.command("c"), "profile pump: line ");
    std::fs::write(bench.path("pump.toml"), pump()).unwrap();

    // A folder whose campaign has no plan is nobody's to go on with.
    std::fs::remove_file(dir.join("plan.toml")).unwrap();
    let output = bench.command("c").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("never overwritten"), "{}", said(&output));
}

#[test]
fn a_damaged_recording_is_set_aside_and_recorded_again() {
    let bench = Bench::new();
    bench.done("c");
    let dir = bench.path("c");
    let whole = files(&dir);
    let mut damaged = whole["pump.mcap"].clone();
    let middle = damaged.len() / 2;
    damaged[middle] ^= 0x10;
    std::fs::write(dir.join("pump.mcap"), &damaged).unwrap();
    std::fs::remove_file(dir.join("steps.mcap")).unwrap();
    bench.done("c");
    assert_same(&dir, &whole);
    let aside = set_aside(&dir);
    assert!(aside["pump-1.mcap"] == damaged);
    assert_eq!(aside.keys().collect::<Vec<_>>(), ["pump-1.mcap", "pump-1.txt"]);
    // Nothing to do is no reason to touch anything.
    bench.done("c");
    assert_same(&dir, &whole);
    assert_eq!(set_aside(&dir).len(), 2);
}

#[test]
fn runs_that_people_added_to_the_campaign_stay_in_it() {
    let bench = Bench::new();
    let call = || bench.command_of("c", &["pump"]).output().unwrap();
    let output = call();
    assert!(output.status.success(), "{}", said(&output));
    let dir = bench.path("c");
    let of_plan = std::fs::read_to_string(dir.join("campaign.toml")).unwrap();
    let entry = |file: &str| {
        format!("\n[[run]]\nfile = \"{file}\"\nprotocol = \"pump-map\"\nrole = \"identify\"\nplane = \"horizontal\"\n")
    };
    for file in ["next_2.mcap", "next_1.mcap"] {
        std::fs::copy(dir.join("pump.mcap"), dir.join(file)).unwrap();
    }
    let own = entry("next_2.mcap") + &entry("next_1.mcap");
    std::fs::write(dir.join("campaign.toml"), of_plan.clone() + &own + &entry("gone.mcap")).unwrap();
    let kept = of_plan.clone() + &own;
    // Where nothing is to be done, and where the plan's run is to be recorded again.
    for whole in [true, false] {
        if !whole {
            std::fs::remove_file(dir.join("pump.mcap")).unwrap();
        }
        let output = call();
        assert!(output.status.success(), "{}", said(&output));
        assert_eq!(std::fs::read_to_string(dir.join("campaign.toml")).unwrap(), kept);
        assert!(said(&output).contains("kept: next_2.mcap, next_1.mcap"), "{}", said(&output));
        assert_eq!(said(&output).contains("gone: gone.mcap"), whole, "{}", said(&output));
    }
    // The plan's run by another name of the same file is no other run.
    std::fs::write(dir.join("campaign.toml"), of_plan.replace("\"pump.mcap", "\"./pump.mcap")).unwrap();
    let output = call();
    assert!(output.status.success(), "{}", said(&output));
    assert_eq!(std::fs::read_to_string(dir.join("campaign.toml")).unwrap(), of_plan);
    // What can't be read is not written over.
    std::fs::write(dir.join("campaign.toml"), "format = 1\nname = ").unwrap();
    let output = call();
    assert_eq!(output.status.code(), Some(2), "{}", said(&output));
    assert_eq!(std::fs::read_to_string(dir.join("campaign.toml")).unwrap(), "format = 1\nname = ");
}

#[test]
fn a_tripped_run_stops_the_campaign_and_is_repeated_by_the_next_call() {
    let bench = Bench::new();
    let rig = bench.path("rig.toml");
    // The pump's bench asks for 4.5 bar, which these limits do not allow; random steps stay below.
    std::fs::write(&rig, "name = \"narrow\"\n[limits]\npressure_max_bar = 4.2\n").unwrap();
    let command = || {
        let mut command = bench.command_of("c", &["steps", "pump", "flows"]);
        command.arg("--rig").arg(&rig);
        command
    };
    let dir = bench.path("c");
    for call in 1..=2 {
        let output = command().output().unwrap();
        assert_eq!(output.status.code(), Some(5), "{}", said(&output));
        assert!(said(&output).contains(&format!("pump-{call}.mcap")), "{}", said(&output));
        let names: Vec<String> = files(&dir).into_keys().collect();
        assert_eq!(names, ["campaign.toml", "plan.toml", "steps.mcap"]);
        let aside: Vec<String> = set_aside(&dir).into_keys().collect();
        assert_eq!(aside.len(), 3 * call, "recording, incident and reason: {aside:?}");
        assert!(aside.iter().any(|name| name.starts_with(&format!("pump-{call}.")) && name.ends_with("-trip.json")));
    }
    let listed = std::fs::read_to_string(dir.join("campaign.toml")).unwrap();
    assert!(listed.contains("steps.mcap") && !listed.contains("pump.mcap"), "{listed}");
}

#[test]
fn a_folder_is_recorded_into_by_one_process_at_a_time() {
    let bench = Bench::new();
    std::fs::create_dir(bench.path("c")).unwrap();
    let folder = std::fs::File::open(bench.path("c")).unwrap();
    folder.lock().unwrap();
    let output = bench.command("c").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("another process records into this folder"), "{}", said(&output));
    drop(folder);
    bench.done("c");
}

#[test]
fn a_need_that_nothing_serves_is_refused_before_anything_is_made() {
    let bench = Bench::new();
    let output = bench.command_of("c", &["flows", "steps"]).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    for part in ["flows", "pump-map", "[controller] model"] {
        assert!(said(&output).contains(part), "{}", said(&output));
    }
    assert!(!bench.path("c").exists());
    // A rig file that names a model serves it.
    let model = model::ModelFile::plain(model::Parameters::example()).to_toml();
    std::fs::write(bench.path("model.toml"), model).unwrap();
    std::fs::write(bench.path("rig.toml"), "name = \"known\"\n[controller]\nmodel = \"model.toml\"\n").unwrap();
    let mut command = bench.command_of("c", &["flows"]);
    let output = command.arg("--rig").arg(bench.path("rig.toml")).output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
}

#[test]
fn a_recording_of_another_profile_stays_where_it_is() {
    let bench = Bench::new();
    bench.done("c");
    let dir = bench.path("c");
    std::fs::copy(dir.join("steps.mcap"), dir.join("pump.mcap")).unwrap();
    let before = files(&dir);
    let output = bench.command("c").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert!(said(&output).contains("pump.mcap: expected the recording of profile pump"), "{}", said(&output));
    assert_same(&dir, &before);
    // The same in a folder without a plan.
    std::fs::create_dir(bench.path("d")).unwrap();
    std::fs::copy(dir.join("steps.mcap"), bench.path("d/steps.mcap")).unwrap();
    let output = bench.command("d").output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    assert_eq!(files(&bench.path("d")).len(), 1, "not even a plan is written");
}

#[test]
fn the_plan_alone_touches_nothing() {
    let bench = Bench::new();
    let output = bench.command("c").arg("--plan-only").output().unwrap();
    assert!(output.status.success(), "{}", said(&output));
    let text = String::from_utf8(output.stdout).unwrap();
    let line = |name: &str| text.lines().position(|line| line.contains(name)).unwrap();
    assert!(line("steps") < line("pump") && line("pump") < line("flows"), "{text}");
    assert!(text.contains("at most"), "{text}");
    assert!(!bench.path("c").exists());
    // Without profiles and folder: the experiments of the paper.
    let output = Command::new(env!("CARGO_BIN_EXE_bench")).args(["campaign", "--plan-only"]).output().unwrap();
    assert!(output.status.success() && said(&output).contains("11 runs"), "{}", said(&output));
}

#[test]
fn targets_of_angle_use_the_model_of_the_campaign_and_the_same_one_when_resumed() {
    let bench = Bench::new();
    std::fs::write(
        bench.path("angle.toml"),
        format!(
            "name = \"angle\"\nprotocol = \"random-steps\"\n{HEAD}fixture = \"free\"\nfill_bar = 2.8\n[[step]]\nfor_s = 1.0\n\
             [[step]]\ntarget = {{ angle_deg = 10.0 }}\nfor_s = 8.0\n"
        ),
    )
    .unwrap();
    let maps = ["torque_map", "volume_map", "pump_map", "clamp_steps", "constant_flow"];
    let call = || {
        let mut command = bench.command_of("c", &["angle"]);
        command.args(maps);
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", said(&output));
    };
    call();
    let dir = bench.path("c");
    let whole = files(&dir);
    let model = String::from_utf8(whole["model_for_control.toml"].clone()).unwrap();
    for map in maps {
        assert!(model.contains(&format!("{map}.mcap ")), "{map} is not in its source: {model}");
    }
    let identified = model::ModelFile::parse(&model, "model_for_control.toml").unwrap();
    let (m3, example) = (identified.parameters.torque.m3, model::Parameters::example().torque.m3);
    assert!(m3 != example && (m3 / example - 1.0).abs() < 0.01, "identified, and well: {m3}");

    let campaign = recordings::Campaign::open(&dir).unwrap();
    let entry = campaign.runs.iter().find(|run| run.file == "angle.mcap").unwrap();
    let run = campaign.read(entry).unwrap();
    let reached = run.angle_deg.last().unwrap();
    assert!((reached - 10.0).abs() < 0.5, "the controlled angle is {reached}");

    // The run alone is repeated, with the model that is there; then the model is identified anew.
    std::fs::remove_file(dir.join("angle.mcap")).unwrap();
    call();
    assert_same(&dir, &whole);
    for file in ["angle.mcap", "model_for_control.toml"] {
        std::fs::remove_file(dir.join(file)).unwrap();
    }
    call();
    assert_same(&dir, &whole);
}
