//! The schema that editors use describes the language that the parser reads.

use crate::builtin::{BUILTIN, EXAMPLES, SCHEMA};
use crate::condition::Channel;
use crate::controlled::Controlled;
use crate::documented::{names, scripts_of_the_document};
use crate::fault::{FaultName, InputName, OutputName, RawFault, ValveName};
use crate::raw::{
    AmountName, FixtureName, RawCondition, RawEnvelope, RawRandom, RawRange, RawScript, RawStart, RawStep, RawTarget,
    Valve, WaveName,
};
use crate::script::{Plane, Protocol, Role, Script};
use crate::signal::Sweep;
use crate::table::Interpolation;
use rt_core::OverrunPolicy;
use serde_json::Value;
use std::collections::BTreeSet;

fn schema() -> Value {
    serde_json::from_str(SCHEMA).expect("JSON")
}

fn sorted(names: impl IntoIterator<Item = &'static str>) -> BTreeSet<String> {
    names.into_iter().map(str::to_owned).collect()
}

fn object<'a>(schema: &'a Value, name: &str) -> &'a Value {
    if name.is_empty() { schema } else { &schema["definitions"][name] }
}

/// The keys that are named, whatever is said of them.
fn keys(value: &Value) -> BTreeSet<String> {
    value.as_object().expect("an object").keys().cloned().collect()
}

fn words(value: &Value) -> BTreeSet<String> {
    let list = value["enum"].as_array().expect("a list of words");
    list.iter().map(|word| word.as_str().expect("a word").to_owned()).collect()
}

fn strings(value: &Value) -> BTreeSet<String> {
    let list = value.as_array().map(Vec::as_slice).unwrap_or_default();
    list.iter().map(|word| word.as_str().expect("a word").to_owned()).collect()
}

#[test]
fn every_table_has_the_keys_that_are_read() {
    let schema = schema();
    for (name, read) in [
        ("", names::<RawScript>()),
        ("start", names::<RawStart>()),
        ("envelope", names::<RawEnvelope>()),
        ("step", names::<RawStep>()),
        ("condition", names::<RawCondition>()),
        ("range", names::<RawRange>()),
        ("target", names::<RawTarget>()),
        ("random", names::<RawRandom>()),
        ("fault", names::<RawFault>()),
    ] {
        let table = object(&schema, name);
        assert_eq!(keys(&table["properties"]), sorted(read), "{name}");
        assert_eq!(table["additionalProperties"], false, "{name}");
        for (key, value) in table["properties"].as_object().expect("an object") {
            let described = value.get("description").or_else(|| {
                let target = value["$ref"].as_str()?.rsplit('/').next()?;
                schema["definitions"][target].get("description")
            });
            assert!(described.is_some_and(|text| text.as_str().is_some_and(|text| !text.is_empty())), "{name}.{key}");
        }
    }
}

#[test]
fn every_key_has_the_words_that_are_read() {
    let schema = schema();
    let overrun: Vec<&'static str> = OverrunPolicy::ALL.iter().map(|policy| policy.as_str()).collect();
    for (table, key, read) in [
        ("", "protocol", names::<Protocol>()),
        ("", "role", names::<Role>()),
        ("", "plane", names::<Plane>()),
        ("", "overrun", overrun),
        ("start", "brake", names::<Valve>()),
        ("start", "bypass", names::<Valve>()),
        ("step", "brake", names::<Valve>()),
        ("step", "bypass", names::<Valve>()),
        ("step", "fixture", names::<FixtureName>()),
        ("step", "amount", names::<AmountName>()),
        ("condition", "channel", names::<Channel>()),
        ("target", "quantity", names::<Controlled>()),
        ("target", "wave", names::<WaveName>()),
        ("target", "sweep", names::<Sweep>()),
        ("target", "interpolation", names::<Interpolation>()),
        ("fault", "kind", names::<FaultName>()),
        ("fault", "input", names::<InputName>()),
        ("fault", "output", names::<OutputName>()),
        ("fault", "valve", names::<ValveName>()),
        ("fault", "stands", names::<Valve>()),
    ] {
        assert_eq!(words(&object(&schema, table)["properties"][key]), sorted(read), "{table}.{key}");
    }
}

/// The rule of the table for this word of this key: the keys that it requires, and those that it forbids.
fn rule(table: &Value, key: &str, word: &str) -> (BTreeSet<String>, BTreeSet<String>) {
    let rules = table["allOf"].as_array().expect("rules");
    let of = |rule: &&Value| rule["if"]["properties"][key]["const"] == word;
    let (mut required, mut forbidden) = (BTreeSet::new(), BTreeSet::new());
    for rule in rules.iter().filter(of) {
        required.extend(strings(&rule["then"]["required"]));
        if let Some(properties) = rule["then"]["properties"].as_object() {
            forbidden.extend(properties.iter().filter(|(_, value)| **value == false).map(|(key, _)| key.clone()));
        }
    }
    (required, forbidden)
}

#[test]
fn every_wave_and_every_fault_has_the_keys_that_it_needs() {
    let schema = schema();
    for (table, key, common, rules) in [
        (
            "target",
            "wave",
            Vec::from_iter(Controlled::ALL.map(Controlled::as_str).into_iter().chain(["quantity", "wave"])),
            Vec::from_iter(WaveName::ALL.map(|wave| (wave.as_str(), wave.keys()))),
        ),
        (
            "fault",
            "kind",
            vec!["kind", "at_s", "for_s"],
            Vec::from_iter(FaultName::ALL.map(|fault| (fault.as_str(), fault.keys()))),
        ),
    ] {
        let table = object(&schema, table);
        for (word, (needed, allowed)) in rules {
            let (required, forbidden) = rule(table, key, word);
            assert_eq!(required, sorted(needed.iter().copied()), "{word}");
            let all = keys(&table["properties"]);
            let known: BTreeSet<String> = sorted(needed.iter().chain(allowed).chain(&common).copied());
            assert_eq!(forbidden, &all - &known, "{word}");
        }
    }
}

fn value(text: &str) -> Value {
    let table: toml::Table = toml::from_str(text).expect("TOML");
    serde_json::to_value(table).expect("plain values")
}

#[test]
fn the_schema_takes_every_script_that_there_is() {
    let validator = jsonschema::draft7::new(&schema()).expect("a schema");
    let scripts = BUILTIN.iter().chain(EXAMPLES).map(|(file, text)| ((*file).to_owned(), (*text).to_owned()));
    let documented = scripts_of_the_document().into_iter().map(|text| (text.clone(), text));
    for (name, text) in scripts.chain(documented) {
        let errors: Vec<String> =
            validator.iter_errors(&value(&text)).map(|e| format!("{}: {e}", e.instance_path())).collect();
        assert!(errors.is_empty(), "{name}: {errors:?}");
        Script::parse(&text, &name).expect("a script");
    }
}

#[test]
fn every_profile_names_the_schema_in_its_first_line() {
    for (file, text) in BUILTIN.iter().chain(EXAMPLES) {
        assert_eq!(text.lines().next(), Some("#:schema ./profile.schema.json"), "{file}");
    }
}

/// Mistakes that an editor should show and the parser must refuse: what to replace in a good script, and by what.
const WRONG: &[(&str, &str)] = &[
    ("name = \"t\"", "name = \"T t\""),
    ("name = \"t\"\n", ""),
    ("square-wave", "square"),
    ("\"identify\"", "\"fit\""),
    ("\"horizontal\"", "\"tilted\""),
    ("fill_bar = 2.8", "fill_bar = 280"),
    ("fill_bar = 2.8", "fill_psi = 40"),
    ("fixture = \"free\"", "fixture = \"driven\""),
    ("fixture = \"free\"", "fixture = \"clamped\""),
    ("fixture = \"free\"", "fixture = \"free\"\nangle_deg = 3"),
    ("brake = \"open\"", "brake = true"),
    ("pressure_max_bar = 6.0", "pressure_max_bar = 600"),
    ("pressure_max_bar = 6.0", "pressure_max = 6.0"),
    ("voltage_u_max = 0.6", "voltage_u_max = 60"),
    ("voltage_u_max = 0.6", "voltage_u_max = 0.6\nvoltage_v = 3"),
    ("voltage_u_max = 0.6", "voltage_u_max = \"0.6\""),
    ("voltage_u_max = 0.6", "voltage = 12"),
    ("voltage_u_max = 0.6", "amount = \"volume_ml\""),
    ("voltage_u_max = 0.6", "angle_deg = 10"),
    ("voltage_u_max = 0.6", "fixture = \"clamped\""),
    ("voltage_u_max = 0.6", "fixture = \"clamped\"\nangle_deg = 400"),
    ("voltage_u_max = 0.6", "fixture = \"clamped\"\nangle_deg = 4\nrate_deg_s = 3"),
    ("voltage_u_max = 0.6", "fixture = \"driven\"\nangle_deg = 4\nrate_deg_s = 3\nfor_s = 3"),
    ("voltage_u_max = 0.6", "for_s = 2"),
    ("voltage_u_max = 0.6", "stop_when = [{ channel = \"angle_deg\", above = 1 }]"),
    ("above = 30.0", "above = 30.0, below = 20"),
    ("above = 30.0", "steady_within = 0.1"),
    ("above = 30.0", "steady_within = 0, for_s = 1"),
    ("above = 30.0", "steady_within = 0.1, for_s = 1, window_s = 1"),
    ("above = 30.0", "rate_below = 0.1"),
    ("above = 30.0", "over = 30"),
    ("channel = \"angle_deg\"", "channel = \"angle\""),
    ("timeout_s = 11.0", "timeout_s = 0"),
    ("for_s = 1.0", ""),
    ("for_s = 1.0", "for_s = 1.0\ntimeout_s = 2"),
    ("repeat = 2", "repeat = 0"),
    ("repeat = 2", "repeat = 2\nfor_s = 1"),
    ("repeat = 2", "repeat = 2\nfor_each = { a = [1] }"),
    ("from = 1, to = 3, step = 1", "from = 1, to = 3"),
    ("from = 1, to = 3, step = 1", "from = 1, to = 3, step = 1, count = 3"),
    ("from = 1, to = 3, step = 1", "from = 1, to = 3, step = -1"),
    ("from = 1, to = 3, step = 1", "from = 1, to = 3, count = 1"),
    ("a = { from = 1, to = 3, step = 1 }", "a = []"),
    ("a = { from = 1, to = 3, step = 1 }", "a = 3"),
    ("amplitude = 10, frequency_hz = 0.1", "amplitude = 10"),
    ("amplitude = 10, frequency_hz = 0.1", "amplitude = 10, frequency_hz = 0.1, to = 3"),
    ("amplitude = 10, frequency_hz = 0.1", "amplitude = -10, frequency_hz = 0.1"),
    ("amplitude = 10, frequency_hz = 0.1", "amplitude = 10, frequency_hz = 2000"),
    ("quantity = \"angle_deg\", ", ""),
    ("quantity = \"angle_deg\"", "angle_deg = 3"),
    ("quantity = \"angle_deg\"", "quantity = \"angle_rad\""),
    ("kind = \"lost\"", "kind = \"missing\""),
    ("kind = \"lost\"", "kind = \"lost\"\noutput = \"voltage\""),
    ("kind = \"lost\"", "kind = \"lost\"\nvalve = \"brake\""),
    ("probability = 0.2", "probability = 20"),
    ("at_s = 1.0\n", ""),
];

#[test]
fn mistakes_are_refused_by_the_schema_and_by_the_parser() {
    let good = r#"name = "t"
protocol = "square-wave"
role = "identify"
plane = "horizontal"
[start]
fixture = "free"
brake = "open"
bypass = "closed"
fill_bar = 2.8
[envelope]
pressure_max_bar = 6.0
[[step]]
for_s = 1.0
[[step]]
repeat = 2
[[step.step]]
voltage_u_max = 0.6
until = [{ channel = "angle_deg", above = 30.0 }]
timeout_s = 11.0
[[step]]
for_each = { a = { from = 1, to = 3, step = 1 } }
[[step.step]]
target = { quantity = "angle_deg", wave = "sine", amplitude = 10, frequency_hz = 0.1 }
for_s = "$a"
[[fault]]
kind = "lost"
at_s = 1.0
input = "angle_deg"
probability = 0.2
"#;
    let validator = jsonschema::draft7::new(&schema()).expect("a schema");
    assert!(validator.is_valid(&value(good)));
    Script::parse(good, "good.toml").expect("good");
    for (from, to) in WRONG {
        assert_eq!(good.matches(from).count(), 1, "{from}");
        let wrong = good.replace(from, to);
        assert!(Script::parse(&wrong, "wrong.toml").is_err(), "the parser takes {to}");
        assert!(!validator.is_valid(&value(&wrong)), "the schema takes {to}");
    }
}
