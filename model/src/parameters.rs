//! Parameters of the reference model (docs/CAMPAIGN.md) and their file, `model.toml`.

use std::collections::BTreeMap;
use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::scalar::Scalar;

/// Names of the plant's parameters in the order of the parameter vector.
pub const NAMES: [&str; COUNT] = [
    "m1", "m2", "m3", "h1", "h2", "h3", "a1", "a2", "v1", "v2", "f1", "f2", "f3", "f4", "l1", "l2", "l3", "l4", "a",
    "J", "G", "k_b",
];
/// Units, in the same order.
pub const UNITS: [&str; COUNT] = [
    "Nm/(bar rad)",
    "Nm/rad",
    "Nm/bar",
    "ml/bar^(1+h2)",
    "1",
    "ml/bar",
    "1/deg",
    "1",
    "ml/rad2",
    "ml/rad",
    "ml/(s V)",
    "ml/(s V bar)",
    "ml/(s bar)",
    "ml/s",
    "Nm s2/rad2",
    "Nm s/rad",
    "Nm",
    "Nm s/rad",
    "rad/s",
    "kg m2",
    "Nm",
    "ml/(s bar)",
];
/// Length of the parameter vector.
pub const COUNT: usize = 22;

/// Positions in the parameter vector.
#[allow(missing_docs)]
pub mod index {
    pub const M1: usize = 0;
    pub const M2: usize = 1;
    pub const M3: usize = 2;
    pub const H1: usize = 3;
    pub const H2: usize = 4;
    pub const H3: usize = 5;
    pub const A1: usize = 6;
    pub const A2: usize = 7;
    pub const V1: usize = 8;
    pub const V2: usize = 9;
    pub const F1: usize = 10;
    pub const F2: usize = 11;
    pub const F3: usize = 12;
    pub const F4: usize = 13;
    pub const L1: usize = 14;
    pub const L2: usize = 15;
    pub const L3: usize = 16;
    pub const L4: usize = 17;
    pub const A: usize = 18;
    pub const J: usize = 19;
    pub const G: usize = 20;
    pub const K_B: usize = 21;
}

/// Torque, eq. (2).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Torque {
    pub m1: f64,
    pub m2: f64,
    pub m3: f64,
}
/// Capacity, eq. (13).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Capacity {
    pub h1: f64,
    pub h2: f64,
    pub h3: f64,
    pub a1: f64,
    pub a2: f64,
}
/// Displacement, eq. (14).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Displacement {
    pub v1: f64,
    pub v2: f64,
}
/// Pump, eq. (10).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Pump {
    pub f1: f64,
    pub f2: f64,
    pub f3: f64,
    pub f4: f64,
    pub u_max: f64,
}
/// Losses, eq. (16).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Losses {
    pub l1: f64,
    pub l2: f64,
    pub l3: f64,
    pub l4: f64,
    pub a: f64,
}
/// Load.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs, non_snake_case)]
pub struct Load {
    pub J: f64,
    pub G: f64,
}
/// Valves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Valves {
    pub k_b: f64,
}

/// The reference model's parameters, grouped as in `model.toml`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[allow(missing_docs)]
pub struct Parameters {
    pub torque: Torque,
    pub capacity: Capacity,
    pub displacement: Displacement,
    pub pump: Pump,
    pub losses: Losses,
    pub load: Load,
    pub valves: Valves,
}

impl Parameters {
    /// The example of the contract: sizes as in the paper's figures.
    pub fn example() -> Self {
        Parameters {
            torque: Torque { m1: -1.6, m2: -4.0, m3: 6.8 },
            capacity: Capacity { h1: 7.6, h2: -1.5, h3: 0.9, a1: 0.008, a2: 0.0 },
            displacement: Displacement { v1: -9.0, v2: 68.0 },
            pump: Pump { f1: 0.61, f2: 0.005, f3: -0.25, f4: -0.60, u_max: 24.0 },
            losses: Losses { l1: 1.2, l2: 2.4, l3: 1.1, l4: 57.424, a: 0.02 },
            load: Load { J: 0.085, G: 4.0 },
            valves: Valves { k_b: 40.0 },
        }
    }

    /// The parameter vector, in the order of [`NAMES`].
    pub fn to_vector(&self) -> [f64; COUNT] {
        let Parameters { torque: t, capacity: c, displacement: d, pump: f, losses: l, load, valves } = self;
        [
            t.m1, t.m2, t.m3, c.h1, c.h2, c.h3, c.a1, c.a2, d.v1, d.v2, f.f1, f.f2, f.f3, f.f4, l.l1, l.l2, l.l3, l.l4,
            l.a, load.J, load.G, valves.k_b,
        ]
    }

    /// The inverse of [`Self::to_vector`]; `u_max` in V is not part of the vector.
    pub fn from_vector(v: &[f64; COUNT], u_max: f64) -> Self {
        Parameters {
            torque: Torque { m1: v[0], m2: v[1], m3: v[2] },
            capacity: Capacity { h1: v[3], h2: v[4], h3: v[5], a1: v[6], a2: v[7] },
            displacement: Displacement { v1: v[8], v2: v[9] },
            pump: Pump { f1: v[10], f2: v[11], f3: v[12], f4: v[13], u_max },
            losses: Losses { l1: v[14], l2: v[15], l3: v[16], l4: v[17], a: v[18] },
            load: Load { J: v[19], G: v[20] },
            valves: Valves { k_b: v[21] },
        }
    }
}

/// Sets l4 so that the losses, eq. (16), are continuous at |w| = a. `k`: a parameter vector in the order of [`NAMES`].
pub fn close_losses<S: Scalar>(k: &mut [S]) {
    use index::{A, L1, L2, L3, L4};
    k[L4] = ((k[L1] * k[A] + k[L2]) * k[A] + k[L3]) / k[A];
}

/// An effect that was added to the model, as in `[[effect]]` of `model.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AddedEffect {
    /// Id out of the library.
    pub id: String,
    /// Values by name, in the units of the library.
    pub parameters: BTreeMap<String, f64>,
}

/// `model.toml`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "Tables")]
pub struct ModelFile {
    /// 1.
    pub format: u32,
    /// Where it came from. What another tool wrote there and is no text is passed over.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub source: BTreeMap<String, String>,
    /// The parameters.
    #[serde(flatten)]
    pub parameters: Parameters,
    /// Standard errors by parameter name; a parameter that the data did not determine is missing here. What is no number is passed over.
    #[serde(skip_serializing_if = "BTreeMap::is_empty")]
    pub std: BTreeMap<String, f64>,
    /// Effects beyond the reference model. One in another tool's form is here with what could be read of it, and refused where effects are asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub effect: Vec<AddedEffect>,
}

/// The file as it is read: the parameters by name and not flattened, so that an error knows its line, and whatever a tool added beside them.
#[derive(Deserialize)]
struct Tables {
    format: u32,
    torque: Torque,
    capacity: Capacity,
    displacement: Displacement,
    pump: Pump,
    losses: Losses,
    load: Load,
    valves: Valves,
    source: Option<toml::Value>,
    std: Option<toml::Value>,
    effect: Option<toml::Value>,
}

impl From<Tables> for ModelFile {
    fn from(file: Tables) -> Self {
        let Tables { format, torque, capacity, displacement, pump, losses, load, valves, source, std, effect } = file;
        let text = |value: &toml::Value| value.as_str().map(str::to_owned);
        let effects = match effect {
            Some(toml::Value::Array(all)) => all.iter().map(AddedEffect::of).collect(),
            Some(other) => vec![AddedEffect::of(&other)],
            None => Vec::new(),
        };
        ModelFile {
            format,
            source: entries(source.as_ref(), text),
            parameters: Parameters { torque, capacity, displacement, pump, losses, load, valves },
            std: entries(std.as_ref(), number),
            effect: effects,
        }
    }
}

impl AddedEffect {
    /// What can be read of an `[[effect]]`, of whatever tool: no id that is known where there is none that is a text, and no parameters where one of
    /// them is no number, lest the others be taken for all.
    fn of(value: &toml::Value) -> Self {
        let id = value.get("id").and_then(toml::Value::as_str).unwrap_or_default().to_owned();
        let given = value.get("parameters");
        let parameters = entries(given, number);
        let whole = given.and_then(toml::Value::as_table).is_some_and(|table| table.len() == parameters.len());
        AddedEffect { id, parameters: if whole { parameters } else { BTreeMap::new() } }
    }
}

/// A table's entries that can be read so.
fn entries<T>(table: Option<&toml::Value>, read: impl Fn(&toml::Value) -> Option<T>) -> BTreeMap<String, T> {
    let all = table.and_then(toml::Value::as_table).into_iter().flatten();
    all.filter_map(|(name, value)| Some((name.clone(), read(value)?))).collect()
}

fn number(value: &toml::Value) -> Option<f64> {
    value.as_float().or_else(|| value.as_integer().map(|whole| whole as f64))
}

/// Why a model file could not be used.
#[derive(Debug, thiserror::Error)]
pub enum ModelError {
    /// Not readable.
    #[error("{file}: cannot be read: {why}")]
    Unreadable {
        /// The file.
        file: String,
        /// The system's reason.
        why: String,
    },
    /// Not a model.
    #[error("{file}: {why}")]
    Invalid {
        /// The file.
        file: String,
        /// Expected and got, with the line where there is one.
        why: String,
    },
}

impl ModelFile {
    /// A plain model.
    pub fn plain(parameters: Parameters) -> Self {
        ModelFile { format: 1, source: Default::default(), parameters, std: Default::default(), effect: Vec::new() }
    }

    /// Reads and checks a file. Errors name file and line.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path)
            .map_err(|e| ModelError::Unreadable { file: file.clone(), why: e.to_string() })?;
        Self::parse(&text, &file)
    }

    /// Parses the text of a `model.toml`; `file` is for the messages.
    pub fn parse(text: &str, file: &str) -> Result<Self, ModelError> {
        let invalid = |why: String| ModelError::Invalid { file: file.to_string(), why };
        let model: ModelFile = toml::from_str(text).map_err(|e| {
            let line = e.span().map_or(0, |s| text[..s.start.min(text.len())].matches('\n').count() + 1);
            invalid(format!("line {line}: {}", e.message()))
        })?;
        if model.format != 1 {
            return Err(invalid(format!("format: expected 1, got {}; this program reads format 1", model.format)));
        }
        for (name, value) in NAMES.iter().zip(model.parameters.to_vector()) {
            if !value.is_finite() {
                return Err(invalid(format!("{name}: expected a finite number, got {value}")));
            }
        }
        let p = &model.parameters;
        for (name, value) in [("J", p.load.J), ("u_max", p.pump.u_max), ("a", p.losses.a), ("k_b", p.valves.k_b)] {
            if value <= 0.0 {
                return Err(invalid(format!("{name}: expected a positive number, got {value}")));
            }
        }
        Ok(model)
    }

    /// The file's text. Numbers are written so that reading them back gives the same bits.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("a model of plain numbers and strings always has a TOML form")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vector_and_file_give_the_same_bits_back() {
        let mut p = Parameters::example();
        p.torque.m1 = -1.6 / 3.0;
        assert_eq!(Parameters::from_vector(&p.to_vector(), p.pump.u_max), p);
        let mut file = ModelFile::plain(p);
        file.std.insert("m1".into(), 0.1);
        file.effect.push(AddedEffect { id: "pump_lag".into(), parameters: [("tau".to_string(), 1.0 / 3.0)].into() });
        assert_eq!(ModelFile::parse(&file.to_toml(), "model.toml").unwrap(), file);
    }

    #[test]
    fn a_bad_file_is_named_with_its_line() {
        let text = ModelFile::plain(Parameters::example()).to_toml();
        for (value, wrong) in [("m3 = 6.8", "m3 = \"6.8\""), ("k_b = 40.0", "k_b = []")] {
            let line = text.lines().position(|l| l == value).unwrap() + 1;
            let error = ModelFile::parse(&text.replace(value, wrong), "m.toml").unwrap_err().to_string();
            assert!(error.starts_with(&format!("m.toml: line {line}: ")), "line {line}: {error}");
        }
        assert!(ModelFile::parse(&text.replace("h3 = 0.9\n", ""), "m").unwrap_err().to_string().contains("h3"));
        let bad = text.replace("h2 = -1.5", "h2 = \"x\"");
        let error = ModelFile::parse(&bad, "m.toml").unwrap_err().to_string();
        assert!(error.contains("m.toml: line"), "{error}");
        assert!(ModelFile::parse(&text.replace("format = 1", "format = 2"), "m").is_err());
        assert!(ModelFile::parse(&text.replace("J = 0.085", "J = 0.0"), "m").is_err());
        assert!(ModelFile::parse("format = 1", "m").is_err());
    }

    #[test]
    fn what_another_tool_added_is_passed_over() {
        let plain = ModelFile::plain(Parameters::example());
        let added = "
[source]
campaign = \"rig 7\"
runs = [\"a.csv\", 2, { tool = 1.0 }]
[std]
m1 = 0.1
m2 = 1
correlated = [[1.0, 0.2], [0.2, 1.0]]
[[effect]]
id = \"pump_lag\"
parameters = { tau = 0.02 }
[[effect]]
id = \"pump_lag\"
parameters = { tau = 0.02, shape = \"ramp\" }
[[effect]]
name = \"something else\"
parameters = [1.0, 2.0]
";
        let read = ModelFile::parse(&(plain.to_toml() + added), "m.toml").unwrap();
        assert_eq!(read.parameters, plain.parameters);
        assert_eq!(read.source, BTreeMap::from([("campaign".to_owned(), "rig 7".to_owned())]));
        assert_eq!(read.std, BTreeMap::from([("m1".to_owned(), 0.1), ("m2".to_owned(), 1.0)]));
        let known = AddedEffect { id: "pump_lag".into(), parameters: [("tau".to_owned(), 0.02)].into() };
        let unread = ["pump_lag", ""].map(|id| AddedEffect { id: id.into(), parameters: BTreeMap::new() });
        assert_eq!((&read.effect[0], &read.effect[1..]), (&known, &unread[..]));
        let odd = format!("source = \"rig 7\"\nstd = 0.1\neffect = \"none\"\n{}", plain.to_toml());
        assert_eq!(ModelFile::parse(&odd, "m.toml").unwrap().parameters, plain.parameters);
    }
}
