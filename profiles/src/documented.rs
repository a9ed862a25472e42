//! The language's document names every word of it, and its examples are scripts.

use crate::ask::Hands;
use crate::condition::Channel;
use crate::controlled::Controlled;
use crate::fault::{FaultName, InputName, OutputName, RawFault, ValveName};
use crate::raw::{
    AmountName, FixtureName, RawCondition, RawEnvelope, RawRandom, RawRange, RawScript, RawStart, RawStep, RawTarget,
    Valve, WaveName,
};
use crate::script::{Context, Plane, Protocol, Role, Script};
use crate::signal::Sweep;
use crate::table::Interpolation;
use rt_core::OverrunPolicy;
use serde::de::value::Error;
use serde::de::{Deserialize, Deserializer, Error as _, Visitor};

const DOCUMENT: &str = include_str!("../../docs/PROFILES.md");

/// Asked for a struct or an enum, it notes the names and gives nothing.
struct Names<'a>(&'a mut Vec<&'static str>);

impl<'de> Deserializer<'de> for Names<'_> {
    type Error = Error;

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value, Error> {
        Err(Error::custom("neither a struct nor an enum"))
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Error> {
        self.0.extend(fields);
        Err(Error::custom("noted"))
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        variants: &'static [&'static str],
        _: V,
    ) -> Result<V::Value, Error> {
        self.0.extend(variants);
        Err(Error::custom("noted"))
    }

    serde::forward_to_deserialize_any! {
        bool i8 i16 i32 i64 i128 u8 u16 u32 u64 u128 f32 f64 char str string bytes byte_buf option unit unit_struct
        newtype_struct seq tuple tuple_struct map identifier ignored_any
    }
}

pub(crate) fn names<'de, T: Deserialize<'de>>() -> Vec<&'static str> {
    let mut names = Vec::new();
    assert!(T::deserialize(Names(&mut names)).is_err());
    assert!(!names.is_empty());
    names
}

#[test]
fn every_key_and_word_is_documented() {
    let keys = [
        names::<RawScript>(),
        names::<RawStart>(),
        names::<RawEnvelope>(),
        names::<RawRange>(),
        names::<RawStep>(),
        names::<RawTarget>(),
        names::<RawRandom>(),
        names::<RawCondition>(),
        names::<RawFault>(),
    ];
    assert!(keys.concat().contains(&"rate_per_s"));
    let is_name = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    let words: std::collections::HashSet<&str> = DOCUMENT.split(|c| !is_name(c)).collect();
    for key in keys.concat() {
        assert!(words.contains(key), "the key {key} is not documented");
    }
    let values = [
        names::<Protocol>(),
        names::<Role>(),
        names::<Plane>(),
        names::<Valve>(),
        names::<FixtureName>(),
        names::<AmountName>(),
        names::<Channel>(),
        names::<Controlled>(),
        names::<WaveName>(),
        names::<Sweep>(),
        names::<Interpolation>(),
        names::<FaultName>(),
        names::<InputName>(),
        names::<OutputName>(),
        names::<ValveName>(),
        OverrunPolicy::ALL.iter().map(|policy| policy.as_str()).collect(),
    ];
    for value in values.concat() {
        let quoted = [format!("`{value}`"), format!("\"{value}\"")];
        assert!(quoted.iter().any(|quoted| DOCUMENT.contains(quoted)), "the word {value} is not documented");
    }
}

#[test]
fn every_wave_is_documented_with_its_keys_and_an_example() {
    for name in names::<WaveName>() {
        let row = DOCUMENT.lines().find(|line| line.starts_with(&format!("| `{name}` | `"))).unwrap_or_default();
        let wave = WaveName::ALL.into_iter().find(|wave| wave.as_str() == name).expect("all of them");
        let (needed, allowed) = wave.keys();
        for key in needed.iter().chain(allowed) {
            assert!(row.contains(&format!("`{key}`")), "{name}: {key} is not in its row");
        }
        let example = DOCUMENT.contains(&format!("wave = \"{name}\"")) || name == "step";
        assert!(example, "{name} has no example");
    }
}

#[test]
fn every_fault_is_documented_with_its_keys() {
    let named = names::<FaultName>();
    assert_eq!(named.len(), FaultName::ALL.len());
    for (name, fault) in named.into_iter().zip(FaultName::ALL) {
        let row = DOCUMENT.lines().find(|line| line.starts_with(&format!("| `{name}` | "))).unwrap_or_default();
        let (needed, allowed) = fault.keys();
        for key in needed.iter().chain(allowed) {
            assert!(row.contains(&format!("`{key}`")), "{name}: {key} is not in its row");
        }
    }
}

/// The examples of the document, each made a whole script.
pub(crate) fn scripts_of_the_document() -> Vec<String> {
    let head = "name = \"t\"\nprotocol = \"random-steps\"\nrole = \"identify\"\nplane = \"horizontal\"\n\
                [start]\nfixture = \"free\"\nbrake = \"open\"\nbypass = \"closed\"\n";
    let examples = DOCUMENT.split("```toml\n").skip(1).filter_map(|rest| rest.split("```").next());
    examples
        .map(|text| if text.contains("\nprotocol = ") { text.to_owned() } else { format!("{head}{text}") })
        .collect()
}

#[test]
fn every_example_of_the_document_is_a_script() {
    let examples = scripts_of_the_document();
    assert!(examples.len() > 10);
    for example in examples {
        let script = Script::parse(&example, "PROFILES.md").unwrap_or_else(|error| panic!("{error}\n{example}"));
        for hands in [Hands::Rig, Hands::People] {
            let context = Context { u_max_v: 24.0, seed: 1, hands };
            script.compile(&context).unwrap_or_else(|error| panic!("{error}\n{example}"));
        }
    }
}
