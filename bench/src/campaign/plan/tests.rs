use super::*;
use crate::recorder::OnFull;
use profiles::BUILTIN;
use rt_core::Limits;

fn settings() -> Settings {
    Settings {
        dir: "campaign".into(),
        name: "rig \"7\"".into(),
        rig: RigFacts { inertia_kg_m2: 0.085, gravity_nm: 4.0, u_max_v: 24.0 / 7.0 },
        limits: Limits { pressure_max_bar: 1.0 / 3.0 + 7.0, ..Limits::default() },
        seed: u64::MAX,
        notes: BTreeMap::new(),
        mode: Mode::Lockstep,
        on_full: OnFull::Stop,
    }
}

fn builtin() -> Vec<Script> {
    BUILTIN.iter().map(|(file, text)| Script::parse(text, file).expect("built in")).collect()
}

fn plan(settings: &Settings, mut scripts: Vec<Script>) -> Plan {
    let files = BTreeMap::from([("rig.toml".to_owned(), "name = \"rig\"".to_owned())]);
    Plan::of(settings, &files, &Knowledge::Nothing, &mut scripts).expect("a possible campaign")
}

#[test]
fn what_is_written_is_read_back_bit_for_bit() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    assert_eq!(Plan::read(dir.path()), Ok(None));
    let written = plan(&settings(), builtin());
    written.write(dir.path()).expect("a writable folder");
    let read = Plan::read(dir.path()).expect("readable").expect("it is there");
    assert_eq!(read, written);
    assert_eq!(written.differences(&read), Vec::<String>::new());
    for (run, script) in read.runs.iter().zip(builtin()) {
        let again = Script::parse(&run.profile, &run.name).expect("the text is whole");
        assert_eq!((again.name, again.text), (script.name, script.text));
    }
}

#[test]
fn every_difference_is_named() {
    let planned = plan(&settings(), builtin());
    let said = |now: Plan| planned.differences(&now).join("; ");
    let seed = said(plan(&Settings { seed: 2, ..settings() }, builtin()));
    assert_eq!(seed, format!("seed: {} in the plan, 2 now", u64::MAX));
    let limits = Limits { pressure_max_bar: 6.0, ..settings().limits };
    let limits = said(plan(&Settings { limits, ..settings() }, builtin()));
    assert!(limits.starts_with("limits.pressure_max_bar: 7.33") && limits.ends_with("6.0 now"), "{limits}");
    let mut other = planned.clone();
    other.rig.files.insert("rig.toml".into(), crc32("name = \"another\""));
    assert!(said(other).starts_with("file rig.toml: CRC-32 "));
    let reversed: Vec<Script> = builtin().into_iter().rev().collect();
    assert!(said(plan(&settings(), reversed)).starts_with("order of the runs: torque_map, "));
    let fewer = builtin().into_iter().take(3).collect();
    assert!(said(plan(&settings(), fewer)).ends_with("torque_map, volume_map, pump_map now"));
    let mut scripts = builtin();
    let text = scripts[2].text.replace("for_s = 3.0", "for_s = 4.0");
    scripts[2] = Script::parse(&text, "pump_map").expect("as good as before");
    let script = said(plan(&settings(), scripts));
    assert!(script.contains("profile pump_map: line ") && script.contains("for_s = 4.0"), "{script}");
}

#[test]
fn an_edited_plan_and_one_of_another_format_are_refused() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    plan(&settings(), builtin()).write(dir.path()).expect("a writable folder");
    let text = std::fs::read_to_string(dir.path().join(PLAN_FILE)).expect("it was written");
    for (from, to, expected) in [
        ("for_s = 3.0", "for_s = 4.0", "pump_map: expected a profile with CRC-32"),
        ("format = 1", "format = 7", "expected format 1, got 7"),
        ("format = 1", "", "expected the key \"format\""),
        ("needs = ", "kneads = ", "unknown field `kneads`"),
        ("[rig]", "[rig", "line "),
    ] {
        let edited = text.replacen(from, to, 1);
        assert_ne!(edited, text, "{from} is not in the plan");
        std::fs::write(dir.path().join(PLAN_FILE), edited).expect("a writable folder");
        let failure = Plan::read(dir.path()).expect_err("it was edited");
        assert_eq!(failure.exit_code(), 2);
        assert!(failure.message.contains(expected), "{failure}");
    }
}

#[test]
fn two_runs_of_one_name_are_refused() {
    let mut scripts = builtin();
    scripts.push(scripts[3].clone());
    let failure = Plan::of(&settings(), &BTreeMap::new(), &Knowledge::Nothing, &mut scripts).expect_err("twice");
    assert!(failure.message.contains("clamp_steps") && failure.exit_code() == 2, "{failure}");
}
