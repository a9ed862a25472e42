use super::*;

fn parse(text: &str) -> Result<Rig, Failure> {
    Rig::parse(text, "rig.toml", Path::new(""))
}

#[test]
fn the_built_in_file_says_what_is_the_case_without_it() {
    let documented = Rig::read(None).expect("the built-in file is sound");
    let mut bare = parse("name = \"emulated rig\"").expect("every key is optional");
    // The one key that depends on another: left out, it is u_max.
    assert!((bare.limits.voltage_max_v - bare.facts.u_max_v).abs() < 1e-6);
    bare.limits.voltage_max_v = documented.limits.voltage_max_v;
    bare.text.clone_from(&documented.text);
    assert_eq!(documented, bare);
}

#[test]
fn the_built_in_file_names_every_limit() {
    let all = toml::to_string(&RawLimits::of(&Limits::default())).expect("plain numbers");
    for line in all.lines() {
        let key = line.split(' ').next().unwrap_or_default();
        assert!(EMULATED.contains(&format!("\n{key} = ")), "{key}");
    }
}

#[test]
fn limits_survive_being_written_and_read() {
    let limits = Limits { slew_max_v_s: f64::INFINITY, pressure_max_bar: 1.0 / 3.0 + 5.0, ..Limits::default() };
    let text = toml::to_string(&RawLimits::of(&limits)).expect("plain numbers");
    let read: RawLimits = toml::from_str(&text).expect("as written");
    assert_eq!(read.over(Limits::default()), limits);
}

#[test]
fn a_bad_file_is_named_with_line_and_reason() {
    for (text, expected) in [
        ("name = \"a\"\n[limits]\npresure_max_bar = 3.0\n", "rig.toml: line 3"),
        ("[limits]\npressure_max_bar = 0.1\n", "above pressure_min_bar"),
        ("[safe_state]\nbrake = \"ajar\"\n", "line 2"),
        ("[rig]\ninertia_kg_m2 = 0.0\ngravity_nm = 1\nu_max_v = 24\n", "inertia_kg_m2"),
        ("[device]\nkind = \"can\"\n", "line 2"),
        ("[device]\nmodel = \"nowhere.toml\"\n", "nowhere.toml"),
    ] {
        let failure = parse(text).expect_err(text);
        assert_eq!(failure.exit_code(), 2);
        assert!(failure.message.contains(expected), "{text}: {failure}");
    }
}

#[test]
fn a_plant_whose_effect_lacks_a_parameter_is_refused_when_the_file_is_read() {
    let dir = tempfile::tempdir().expect("a temporary folder");
    let mut plant = ModelFile::plain(Parameters::example()).to_toml();
    plant.push_str("\n[[effect]]\nid = \"cross_leakage\"\nparameters = { k = 0.15 }\n");
    std::fs::write(dir.path().join("plant.toml"), plant).expect("writable");
    let text = "[device]\nkind = \"emulated\"\nmodel = \"plant.toml\"\n";
    let failure = Rig::parse(text, "rig.toml", dir.path()).expect_err("d is missing");
    for word in ["rig.toml: line 3", "plant.toml", "\"d\"", "k (ml/(s sqrt(bar))), d (bar)"] {
        assert!(failure.message.contains(word), "{word} in {failure}");
    }
    assert_eq!(failure.exit_code(), 2);
}
